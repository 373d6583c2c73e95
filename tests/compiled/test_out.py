"""`out=`: written over when it fits, refused when not; nobody else's numbers change."""

import gc
import pickle
import weakref

import numpy as np
import pytest

import holdfast
from holdfast import StateError
from holdfast.compiled import arrays
from holdfast.questions.question import QUESTIONS
from tests.compiled.problems import STATE, chain_named, compiled, numbers, one, outputs
from tests.compiler.programs import all_same_bits
from tests.questions.every import direct, inputs_of

NAME = "nine"


@pytest.fixture
def fast():
    """A compiled chain that has not been called."""
    compiled(NAME)  # keeps the code
    return holdfast.compile(chain_named(NAME), parameters=("link_inertia", "link_wrench"))


@pytest.fixture
def given():
    """States of seven systems."""
    return numbers(chain_named(NAME), 7)


def test_single(fast, given):
    """The same object, the same arrays, another call's numbers, by the checked way and by the builtin's."""
    expected = [outputs(fast.forward_dynamics(**one(given, i))) for i in range(7)]
    out = fast.forward_dynamics(**one(given, 0))
    first = out.qdd
    for i in (1, 2, 3, 4):
        assert fast.forward_dynamics(*one(given, i).values(), out=out) is out
        assert all_same_bits(outputs(out), expected[i])
        assert out.qdd is first


def test_single_by_the_builtin(fast, given, monkeypatch):
    """From the second call on the Python code is left out, and the bits are the same."""
    expected = [outputs(fast.forward_dynamics(**one(given, i))) for i in range(7)]
    out = fast.forward_dynamics(**one(given, 0))
    fast.forward_dynamics(*one(given, 1).values(), out=out)
    monkeypatch.setattr(arrays, "floats", None)
    for i in range(7):
        fast.forward_dynamics(*one(given, i).values(), out=out)
        assert all_same_bits(outputs(out), expected[i])
        assert all_same_bits(outputs(fast.forward_dynamics(*one(given, i).values())), expected[i])
    with pytest.raises(TypeError, match="not callable"):  # otherwise the checks are not left out
        fast.forward_dynamics(*(x.tolist() for x in one(given, 0).values()))


def test_batch(fast, given):
    """A batch's result is reused too."""
    out = fast.forward_dynamics(**given)
    before = [x.copy() for x in outputs(out)]
    changed = given | {"tau": given["tau"][::-1].copy()}
    assert fast.forward_dynamics(**changed, out=out, threads=2) is out
    assert all_same_bits(outputs(out), outputs(fast.forward_dynamics(**changed)))
    fast.forward_dynamics(**given, out=out)
    assert all_same_bits(outputs(out), tuple(before))


def test_earlier_results_stay(fast, given):
    """A result belongs to its caller: later calls do not touch it, nor each other's `out`."""
    first, second = (fast.forward_dynamics(**one(given, i)) for i in (0, 1))
    batch = fast.forward_dynamics(**given)
    kept = [[x.copy() for x in outputs(r)] for r in (first, second, batch)]
    third = fast.forward_dynamics(**one(given, 2))
    for _ in range(3):
        fast.forward_dynamics(*one(given, 3).values(), out=third)
    fast.forward_dynamics(**given | {"q": given["q"] + 0.1})
    bound = fast.bind()
    bound.q[...] = 1.0
    bound()
    for result, x in zip((first, second, batch), kept, strict=True):
        assert all_same_bits(outputs(result), tuple(x))


def test_two_results_in_turn(fast, given):
    """The builtin serves one `out` at a time; the other is right as well."""
    a, b = (fast.forward_dynamics(**one(given, 0)) for _ in range(2))
    for i in range(1, 7):
        out = a if i % 2 else b
        fast.forward_dynamics(*one(given, i).values(), out=out)
        assert all_same_bits(outputs(out), outputs(fast.forward_dynamics(**one(given, i))))


def test_parameters_do_not_stay(fast, given):
    """A parameter is for its call only, also between calls that the builtin takes."""
    out = fast.forward_dynamics(**one(given, 0))
    plain = [x.copy() for x in outputs(fast.forward_dynamics(*one(given, 0).values(), out=out))]
    fast.forward_dynamics(*one(given, 0).values(), out=out, gravity=[1.0, 2.0, 3.0])
    assert not all_same_bits(outputs(out), tuple(plain))
    fast.forward_dynamics(*one(given, 0).values(), out=out)
    assert all_same_bits(outputs(out), tuple(plain))


def test_what_does_not_fit(fast, given):
    """Another chain's result, another batch size, other objects; nothing is written."""
    single, batch = fast.forward_dynamics(**one(given, 0)), fast.forward_dynamics(**given)
    stranger = compiled("one").forward_dynamics(**one(numbers(chain_named("one"), 1), 0))
    kept = [[x.copy() for x in outputs(r)] for r in (single, batch)]
    three = {name: x[:3] for name, x in given.items()}
    for arguments, out, message in (
        (one(given, 1), stranger, "out: expected a result of this compiled chain, got CompiledResult; leave it out"),
        (one(given, 1), np.zeros(27), "out: expected a result of this compiled chain, got ndarray"),
        (one(given, 1), pickle.loads(pickle.dumps(single)), "out: expected a result of this compiled chain"),
        (one(given, 1), batch, "out: expected a result of one system, got one of a batch of 7"),
        (given, single, "out: expected a result of a batch of 7, got one of one system"),
        (three, batch, "out: expected a result of a batch of 3, got one of a batch of 7"),
    ):
        for _ in range(2):
            with pytest.raises(StateError, match=message):
                fast.forward_dynamics(**arguments, out=out)
    for result, x in zip((single, batch), kept, strict=True):
        assert all_same_bits(outputs(result), tuple(x))


def test_input_inside_out(fast, given):
    """An input that lies in the memory to be written is refused, also after calls that the builtin took."""
    for arguments in (one(given, 0), given):
        out = fast.forward_dynamics(**arguments)
        for _ in range(3):
            fast.forward_dynamics(**arguments, out=out)
        for inside in (out.qdd, out.memory[: out.qdd.size].reshape(out.qdd.shape)):
            with pytest.raises(
                StateError, match="out: expected memory of its own, but an input lies in it; try a copy"
            ):
                fast.forward_dynamics(**arguments | {"tau": inside}, out=out)
        fast.forward_dynamics(**arguments | {"tau": out.qdd.copy()}, out=out)
        wrench = out.object_acceleration.copy()  # parameters are copied first
        expected = outputs(fast.forward_dynamics(**arguments, object_wrench=wrench))
        fast.forward_dynamics(**arguments, object_wrench=out.object_acceleration, out=out)
        assert all_same_bits(outputs(out), expected)


def test_input_inside_another_result(fast, given):
    """One result's accelerations may be another call's torques."""
    a, b = (fast.forward_dynamics(**one(given, 0)) for _ in range(2))
    torque = a.qdd.copy()
    fast.forward_dynamics(**one(given, 0) | {"tau": a.qdd}, out=b)
    assert all_same_bits(outputs(b), outputs(fast.forward_dynamics(**one(given, 0) | {"tau": torque})))


def test_let_go(given):
    """A compiled chain that nobody holds is freed, results and builtin included; a result outlives it."""
    compiled(NAME)
    fast = holdfast.compile(chain_named(NAME), parameters=("link_inertia", "link_wrench"))
    out = fast.forward_dynamics(**one(given, 0))
    call = fast.forward_dynamics
    call(*one(given, 1).values(), out=out)
    kept = [x.copy() for x in outputs(out)]
    seen = weakref.ref(fast)
    del fast
    gc.collect()
    assert seen() is not None  # its builtin is held
    assert call(*one(given, 1).values(), out=out) is out
    del call
    gc.collect()
    assert seen() is None
    assert all_same_bits(outputs(out), tuple(kept))
    assert set(STATE) <= set(given)


def test_masks_are_not_lost(fast, given):
    """A masked array is refused wherever it comes in, also by the shortest way of a call that is repeated."""
    single = one(given, 0)
    result = fast.forward_dynamics(**single)
    for _ in range(2):
        fast.forward_dynamics(*single.values(), out=result)
    for name, x in single.items():
        masked = single | {name: np.ma.masked_array(x, mask=np.arange(len(x)) == 0)}
        for call in (
            lambda m=masked: fast.forward_dynamics(*m.values(), out=result),
            lambda m=masked: fast.forward_dynamics(**m),
            lambda m=masked, n=name: fast.bind(**{n: m[n]}),
        ):
            with pytest.raises(StateError, match=f"{name}: expected .*, got a masked array"):
                call()


def test_subclasses_without_a_mask(fast, given, tmp_path):
    """Arrays in a file are arrays: the answer is the same, if not by the shortest way."""
    single = one(given, 0)
    expected = fast.forward_dynamics(**single)
    result = fast.forward_dynamics(**single)
    on_disk = np.memmap(tmp_path / "q", dtype=float, mode="w+", shape=single["q"].shape)
    on_disk[...] = single["q"]
    for _ in range(2):
        fast.forward_dynamics(on_disk, *list(single.values())[1:], out=result)
        assert all_same_bits(outputs(result), outputs(expected))


def test_what_a_question_does_not_admit_is_refused_every_time():
    """Arms that hold nothing bear nothing, also where a call repeats its `out` and could run in machine code."""
    fast = compiled("rows first")
    chain = fast.chain
    f = np.zeros((len(chain.arms), 6))
    q, bar = np.zeros(chain.joint_count), np.ones(f.shape)
    out = fast.wrist_wrenches.vjp(q, f, wrist_wrenches=bar)
    assert fast.wrist_wrenches.vjp(q, f, wrist_wrenches=bar, out=out) is out
    f[[name not in chain.grasps for name in chain.names]] = 1.0
    for _ in range(2):
        with pytest.raises(StateError, match="holds nothing"):
            fast.wrist_wrenches.vjp(q, f, wrist_wrenches=bar, out=out)
        with pytest.raises(StateError, match="holds nothing"):
            fast.wrist_wrenches(q, f)


@pytest.mark.parametrize("wrong", ["nan", "far", "quaternion"])
def test_inputs_that_do_not_matter_are_checked_by_the_builtin(wrong):
    """Numbers on which a result does not depend are refused in plain calls, as in all others."""
    fast, (q, qd, tau, pose, twist) = compiled("two"), (numbers(chain_named("two"), 1)[name][0] for name in STATE)
    assert np.isfinite(fast.kinetic_energy(q, qd, pose, twist)) and fast.joint_margins(q, qd, tau).effort.size
    if wrong == "nan":
        q = q * np.nan
    elif wrong == "far":
        q = np.full_like(q, 2e5)
    else:
        pose = 1.5 * pose
    with pytest.raises(StateError):
        fast.kinetic_energy(q, qd, pose, twist)
    with pytest.raises(StateError):
        fast.closure(q, qd, pose, twist)


@pytest.mark.parametrize("name", direct())
def test_plain_calls_are_answered_by_machine_code(name, monkeypatch):
    """Whatever memory held before: gaps between results are no results."""
    chain, question = chain_named("two"), QUESTIONS[name]
    inputs = inputs_of(chain, 1)
    given = [inputs[x][0] for x in (*question.inputs, *question.by_name(chain))]
    function, checked, empty = getattr(holdfast.compile(chain), name), [], np.empty

    def of_nan(*shape, **options):
        found = empty(*shape, **options)
        if found.dtype == float:
            found.fill(np.nan)
        return found

    monkeypatch.setattr(np, "empty", of_nan)
    monkeypatch.setattr(type(function), "_checked", lambda *_, **__: checked.append(name))
    function(*given)  # makes the builtin
    checked.clear()
    assert function(*given) is not None and not checked
