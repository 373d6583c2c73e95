"""Builtins: what machine code takes, what it leaves to the fallback, and that nothing leaks or outlives its memory."""

import array
import ctypes
import functools
import gc
import inspect
import sys
import weakref

import numpy as np
import pytest

from holdfast.compiler.targets import Builtin, cpu, no_argument_call
from holdfast.compiler.targets.llvm import builtin

# out[0] = sum of a (3), out[1] = sum of b (2); not well if the first sum is negative
RUN = """
define i64 @run(ptr %table) {
  %a = load ptr, ptr %table
  %b.at = getelementptr ptr, ptr %table, i64 1
  %b = load ptr, ptr %b.at
  %out.at = getelementptr ptr, ptr %table, i64 2
  %out = load ptr, ptr %out.at
  %a0 = load double, ptr %a
  %a1.at = getelementptr double, ptr %a, i64 1
  %a1 = load double, ptr %a1.at
  %a2.at = getelementptr double, ptr %a, i64 2
  %a2 = load double, ptr %a2.at
  %b0 = load double, ptr %b
  %b1.at = getelementptr double, ptr %b, i64 1
  %b1 = load double, ptr %b1.at
  %a01 = fadd double %a0, %a1
  %first = fadd double %a01, %a2
  %second = fadd double %b0, %b1
  store double %first, ptr %out
  %next = getelementptr double, ptr %out, i64 1
  store double %second, ptr %next
  %bad = fcmp olt double %first, 0.0
  %status = zext i1 %bad to i64
  ret i64 %status
}
"""
# counts its calls in table[0]
COUNT = """
define i64 @run(ptr %table) {
  %old = load i64, ptr %table
  %new = add i64 %old, 1
  store i64 %new, ptr %table
  ret i64 %new
}
"""


class Result:
    """What is passed as `out`."""

    def __init__(self):
        self.memory = np.zeros(2)


@functools.cache
def sums():
    return cpu.Code(RUN, "run")


class Owner:
    """A kernel as the library has it: the builtin's fallback is its own method."""

    def __init__(self, shapes=((3,), (2,)), code=None, **names):
        self.calls, self.out = [], Result()
        table = np.zeros(3, dtype=np.int64)
        self.entry = Builtin(
            (code or sums()).address, table, shapes, self.fallback, "sums", "(a, b, *, out=None)", "Sum.", **names
        )
        self.function = self.entry.function
        self.expect(self.out)

    def expect(self, out):
        self.entry.expect(out, out.memory, [out.memory.ctypes.data])

    def fallback(self, *args, **keywords):
        self.calls.append((args, keywords))
        if args and isinstance(args[0], Exception):
            raise args[0]
        return "fallback"


@pytest.fixture
def owner():
    return Owner()


A, B = np.array([1.0, 2.0, 4.0]), np.array([8.0, 16.0])


def read_only(x):
    x = x.copy()
    x.flags.writeable = False
    return x


@pytest.mark.parametrize("wrap", [np.copy, read_only, memoryview, lambda x: array.array("d", x)])
def test_machine_code(owner, wrap):
    """Whatever shows a flat block of doubles is computed at once."""
    assert owner.function(wrap(A), wrap(B), out=owner.out) is owner.out
    assert np.array_equal(owner.out.memory, [7.0, 24.0]) and owner.calls == []


def test_new_inputs_each_time(owner):
    for k in range(100):
        assert owner.function(A + k, B - k, out=owner.out) is owner.out
        assert np.array_equal(owner.out.memory, [7.0 + 3 * k, 24.0 - 2 * k])


def test_inputs_by_name():
    """In any order; a name missing, unknown, or given by place, is the fallback's."""
    owner = Owner(names=["b"])
    for call in ({"b": B, "out": owner.out}, {"out": owner.out, "b": B}):
        owner.out.memory[...] = 0.0
        assert owner.function(A, **call) is owner.out
        assert np.array_equal(owner.out.memory, [7.0, 24.0]) and owner.calls == []
    others = [((A, B), {"out": owner.out}), ((A,), {"out": owner.out}), ((A,), {"b": B}), ((A,), {"c": B, "b": B})]
    others += [((A,), {"b": B, "out": owner.out, "c": B}), ((A,), {"b": B, "out": Result()}), ((), {"b": B, "a": A})]
    others += [((A,), {"b": x, "out": owner.out}) for kind, x in REFUSED.items() if kind != "short"]
    for args, names in others:
        assert owner.function(*args, **names) == "fallback"
        assert owner.calls.pop() == (args, names)


def test_every_input_by_name():
    """Those that may be given by place too are found by either; what is given twice is the fallback's."""
    owner = Owner(names=("a", "b"), by_name=0)
    for args, names in (((A, B), {}), ((A,), {"b": B}), ((), {"b": B, "a": A})):
        owner.out.memory[...] = 0.0
        assert owner.function(*args, **names, out=owner.out) is owner.out
        assert np.array_equal(owner.out.memory, [7.0, 24.0]) and owner.calls == []
    for args, names in (((A,), {"a": A}), ((A, B), {"b": B}), ((), {"a": A}), ((), {"b": B, "c": A}), ((A, B, B), {})):
        assert owner.function(*args, **names, out=owner.out) == "fallback"


def test_inputs_of_two_axes():
    """The shape counts, not only the number of entries."""
    owner = Owner(shapes=((3, 1), (2,)))
    assert owner.function(A[:, None], B, out=owner.out) is owner.out
    assert np.array_equal(owner.out.memory, [7.0, 24.0]) and owner.calls == []
    for x in (A, A[None], A[:, None, None], A[:2, None], np.array(7.0)):
        assert owner.function(x, B, out=owner.out) == "fallback"


def test_names_given_twice():
    """No call from Python does so; one from C may, and finds no input that is not there."""
    owner = Owner(names=["b"])
    call = ctypes.pythonapi.PyObject_Vectorcall
    call.argtypes = [ctypes.py_object, ctypes.c_void_p, ctypes.c_size_t, ctypes.py_object]
    call.restype = ctypes.py_object
    for names in (("b", "b"), ("out", "out")):
        args = (ctypes.py_object * 3)(A, B if names[0] == "b" else owner.out, B if names[0] == "b" else owner.out)
        assert call(owner.function, ctypes.addressof(args), 1, names) == "fallback"


REFUSED = {
    "int": np.array([1, 2, 4]),
    "float32": A.astype(np.float32),
    "as long as 3 doubles": np.zeros(6, dtype=np.float32),
    "int64": np.zeros(3, dtype=np.int64),
    "complex": np.zeros(3, dtype=complex),
    "record": np.zeros(3, dtype=[("d", float)]),
    "swapped": A.astype(">f8"),
    "batch": np.ones((4, 3)),
    "row": A[None],
    "number": np.array(1.0),
    "short": A[:2].copy(),
    "long": np.ones(4),
    "strided": np.ones(6)[::2],
    "reversed": A[::-1],
    "unaligned": np.zeros(25, dtype=np.uint8)[1:].view(np.float64),
    "unaligned d": memoryview(bytearray(25))[1:].cast("d"),
    "bytes": bytes(24),
    "list": [1.0, 2.0, 4.0],
    "none": None,
    "dates": np.zeros(3, dtype="M8[s]"),  # NumPy cannot show them, and raises
}


@pytest.mark.parametrize("kind", REFUSED)
@pytest.mark.parametrize("place", [0, 1])
def test_refused_inputs(owner, kind, place):
    """The fallback gets the arguments as they were given, with no exception pending."""
    owner = owner if place == 0 else Owner(shapes=((2,), (3,)))
    args = (REFUSED[kind], B) if place == 0 else (B, REFUSED[kind])
    assert owner.function(*args, out=owner.out) == "fallback"
    ((found, keywords),) = owner.calls
    assert all(x is y for x, y in zip(found, args, strict=True)) and keywords == {"out": owner.out}
    assert np.array_equal(owner.out.memory, [0.0, 0.0])


def test_other_format(owner):
    """Each entry two doubles."""
    exporter = pytest.importorskip("_testbuffer")
    pair = exporter.ndarray([(1.0, 2.0)], shape=[1], format="dd")
    assert owner.function(A, pair, out=owner.out) == "fallback"


def test_refused_calls(owner):
    """Wrong counts, other keywords, another out or none."""
    out = owner.out
    calls = [
        ((), {}), ((A,), {}), ((A, B), {}), ((A, B, out), {}), ((A,), {"out": out}),
        ((A, B, B), {"out": out}), ((A, B, out), {"out": out}),
        ((A, B), {"out": None}), ((A, B), {"out": Result()}), ((A, B), {"oui": out}), ((A,), {"b": B, "out": out}),
        ((A, B), {"out": out, "threads": 1}), ((A, B), {"threads": 1, "out": out}),
    ]  # fmt: skip
    for args, keywords in calls:
        assert owner.function(*args, **keywords) == "fallback"
    assert [str(c) for c in owner.calls] == [str(c) for c in calls]
    assert np.array_equal(out.memory, [0.0, 0.0])


def test_computed_keyword(owner):
    """A keyword that is not the very string `out` is never wrong, at most slow."""
    assert owner.function(A, B, **{"".join(["o", "ut"]): owner.out}) in (owner.out, "fallback")


def test_not_well(owner):
    """A kernel that reports a failure leaves the call to the fallback."""
    assert owner.function(-A, B, out=owner.out) == "fallback"
    assert len(owner.calls) == 1


def test_overlap(owner):
    """Inputs beside the results are fine, inputs among them are not."""
    block = np.arange(9.0)
    owner.out.memory = block[3:5]
    owner.expect(owner.out)
    for start, refused in ((0, False), (1, True), (2, True), (4, True), (5, False)):
        owner.calls.clear()
        found = owner.function(block[start : start + 3], B, out=owner.out)
        assert found == "fallback" if refused else found is owner.out
    assert owner.function(A, owner.out.memory, out=owner.out) == "fallback"


def test_expect(owner):
    """Before, nothing is expected; then only the last object, whose memory lives on."""
    entry = Builtin(sums().address, np.zeros(3, dtype=np.int64), ((3,), (2,)), owner.fallback)
    assert entry.function(A, B, out=owner.out) == "fallback"
    first, second = owner.out, Result()
    owner.expect(second)
    assert owner.function(A, B, out=first) == "fallback"
    assert owner.function(A, B, out=second) is second
    assert np.array_equal(second.memory, [7.0, 24.0]) and np.array_equal(first.memory, [0.0, 0.0])
    gone = weakref.ref(second)
    del second
    assert gone() is not None
    owner.expect(first)
    assert gone() is None


def test_errors(owner):
    with pytest.raises(ZeroDivisionError, match="from the fallback"):
        owner.function(ZeroDivisionError("from the fallback"), B, out=owner.out)


def test_empty_inputs():
    """Inputs of size zero, and none at all."""
    status = cpu.Code("define i64 @run(ptr %table) { ret i64 0 }", "run")
    owner = Owner(shapes=((0,), (0,)), code=status)
    assert owner.function(np.zeros(0), np.zeros(0), out=owner.out) is owner.out
    assert owner.function(np.zeros(0), np.zeros((0, 3)), out=owner.out) == "fallback"
    none = Owner(shapes=(), code=status)
    assert none.function(out=none.out) is none.out
    many = Owner(shapes=((1,),) * 300, code=status)
    assert many.function(*[np.zeros(1)] * 300, out=many.out) == "fallback"


@pytest.mark.parametrize("other", [A, -A, REFUSED["list"], REFUSED["float32"], REFUSED["batch"], None])
def test_references(owner, other):
    """No path keeps or loses a reference."""
    owner.calls = type("Nowhere", (), {"append": lambda self, x: None})()
    b, out, function = B.copy(), owner.out, owner.function
    watched = (b, out, other, function, owner, "fallback")

    def many():
        for _ in range(10_000):
            function(other, b, out=out)
            function(b, other, out=out)

    many()
    before = [sys.getrefcount(x) for x in watched]
    many()
    after = [sys.getrefcount(x) for x in watched]
    assert before[:-2] == after[:-2]
    assert all(abs(x - y) < 10 for x, y in zip(before, after, strict=True))


def test_buffers_are_released(owner):
    """Whatever becomes of the call, its inputs' memory is free again."""
    out, block = owner.out, np.zeros(5)
    for good, bad, given in (
        (A, B, out),
        (-A, B, out),  # not well
        (A, np.ones(3), out),
        (A, np.zeros(2, dtype=np.int64), out),
        (A, [1.0, 2.0], out),
        ([1.0], B, out),
        (A, B, None),
        (A, out.memory, out),
        (block[:3], block[3:], Result()),
    ):
        held = [memoryview(x) if isinstance(x, np.ndarray) else x for x in (good, bad)]
        owner.function(*held, out=given)
        for x in held:
            if isinstance(x, memoryview):
                x.release()  # BufferError if the builtin still has it
    own = np.ones(3)
    owner.function(own, B, out=out)
    own.resize(5)


@pytest.mark.skipif(sys.version_info < (3, 12), reason="no __buffer__ in Python")
def test_call_within_a_call(owner):
    """An input whose buffer is made by Python code may call the same builtin."""

    class Evil:
        def __buffer__(self, flags):
            owner.function(np.full(3, 100.0), B, out=owner.out)
            return memoryview(B)

    assert owner.function(A, Evil(), out=owner.out) is owner.out
    assert np.array_equal(owner.out.memory, [7.0, 24.0])


def test_description(owner):
    assert str(inspect.signature(owner.function)) == "(a, b, *, out=None)"
    assert (owner.function.__name__, owner.function.__doc__) == ("sums", "Sum.")
    assert owner.function.__module__ == "holdfast.compiler.targets.llvm.builtin"
    assert inspect.isbuiltin(owner.function)


def test_everything_goes():
    """The builtin, its owner and the result are a cycle that the garbage collector takes apart."""
    owner = Owner()
    owner.out.owner = owner
    assert owner.function(A, B, out=owner.out) is owner.out
    watched = [weakref.ref(x) for x in (owner, owner.entry, owner.out, owner.out.memory, owner.function)]
    del owner
    gc.collect()
    assert [w() for w in watched] == [None] * 5


def test_function_outlives_entry():
    """The builtin alone keeps all it needs."""
    out, table = Result(), np.zeros(3, dtype=np.int64)
    entry = Builtin(sums().address, table, ((3,), (2,)), fallback := functools.partial(list))
    entry.expect(out, out.memory, [out.memory.ctypes.data])
    function = entry.function
    watched = [weakref.ref(x) for x in (out, out.memory, table, fallback)]
    del entry, table, fallback
    gc.collect()
    assert function(A, B, out=out) is out and np.array_equal(out.memory, [7.0, 24.0])
    del out.memory, out
    gc.collect()
    assert all(w() is not None for w in watched)
    del function
    gc.collect()
    assert all(w() is None for w in watched)


def test_finalizer_calls():
    """A finalizer may call the builtin while the cycle is taken apart, and bring it back to life."""
    saved = []

    class Last(Owner):
        def __del__(self):
            found = self.function(A, B, out=self.out)
            saved.append((self, found is self.out))

    Last()
    gc.collect()
    ((owner, well),) = saved
    assert well and owner.function(A, B, out=owner.out) is owner.out
    saved.clear()


def test_many():
    """Made, called and dropped many times, alive no longer than used."""
    alive = []
    for k in range(10_000):
        owner = Owner()
        alive.append(weakref.ref(owner))
        assert owner.function(A, B, out=owner.out) is owner.out
        if k % 3 == 0:
            owner.entry = None
    del owner
    gc.collect()
    assert all(w() is None for w in alive)


def test_no_argument_call():
    code = cpu.Code(COUNT, "run")
    table = np.zeros(1, dtype=np.int64)
    keep = Result()
    step = no_argument_call(code.address, table, (code, keep), "step", "Count.")
    assert [step() for _ in range(1000)] == [*range(1, 1001)] and table[0] == 1000
    table[0] = -(2**62)
    assert step() == 1 - 2**62
    with pytest.raises(TypeError, match="takes no arguments"):
        step(1)
    assert str(inspect.signature(step)) == "()" and step.__name__ == "step" and step.__doc__ == "Count."
    gone = weakref.ref(keep)
    keep.step = step  # a cycle
    del keep, step, code, table
    gc.collect()
    assert gone() is None


def test_elsewhere(monkeypatch):
    """On other Pythons the results are the same."""
    monkeypatch.setattr(builtin, "_POSSIBLE", False)
    owner = Owner()
    assert owner.function == owner.fallback
    assert owner.function(A, B, out=owner.out) == "fallback"
    table = np.zeros(1, dtype=np.int64)
    code = cpu.Code(COUNT, "run")
    step = no_argument_call(code.address, table, code)
    del code
    gc.collect()
    assert [step(), step()] == [1, 2] and table[0] == 2


def test_from_the_cache(monkeypatch, tmp_path):
    """Code from the disk finds Python's functions too."""
    sums()
    monkeypatch.setenv("HOLDFAST_CACHE", str(tmp_path / "cache"))
    for _ in range(2):
        builtin._code.cache_clear()
        builtin._definition.cache_clear()
        owner = Owner()
        assert owner.function(A, B, out=owner.out) is owner.out
        assert len(list((tmp_path / "cache").iterdir())) == 1
