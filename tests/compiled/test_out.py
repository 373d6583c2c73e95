"""Results: written over by `out=` when they fit, refused when not; pickled and copied, as compiled chains are."""

import copy
import gc
import pickle
import weakref

import numpy as np
import pytest

import holdfast
from holdfast.compiled import CompiledChain, arrays
from holdfast.compiled.structure import Options
from holdfast.dynamics import Status
from holdfast.errors import StateError
from holdfast.questions.question import QUESTIONS
from tests.compiled import problems
from tests.compiled.problems import chain_named, compiled, numbers, one, outputs
from tests.compiler.programs import all_same_bits
from tests.questions.every import direct, inputs_of
from tests.systems import planar_parallelogram
from tests.systems.as_chain import as_chain

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


def test_single(fast, given, monkeypatch):
    """The same object, the same arrays, another call's numbers; from the second call on the Python code is left out."""
    expected = [outputs(fast.forward_dynamics(**one(given, i))) for i in range(7)]
    out = fast.forward_dynamics(**one(given, 0))
    first = out.qdd
    assert fast.forward_dynamics(*one(given, 1).values(), out=out) is out
    assert all_same_bits(outputs(out), expected[1])
    monkeypatch.setattr(arrays, "floats", None)
    for i in range(7):
        assert fast.forward_dynamics(*one(given, i).values(), out=out) is out and out.qdd is first
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


def test_let_go(fast, given):
    """A compiled chain that nobody holds is freed, results and builtin included; a result outlives it."""
    ours = holdfast.compile(fast.chain, parameters=("link_inertia", "link_wrench"))
    out = ours.forward_dynamics(**one(given, 0))
    call = ours.forward_dynamics
    call(*one(given, 1).values(), out=out)
    kept = [x.copy() for x in outputs(out)]
    seen = weakref.ref(ours)
    del ours
    gc.collect()
    assert seen() is not None  # its builtin is held
    assert call(*one(given, 1).values(), out=out) is out
    del call
    gc.collect()
    assert seen() is None
    assert all_same_bits(outputs(out), tuple(kept))


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


@pytest.mark.slow
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


@pytest.mark.parametrize(("name", "factor", "shift"), [("q", np.nan, 0.0), ("q", 0.0, 2e5), ("object_pose", 1.5, 0.0)])
def test_inputs_that_do_not_matter_are_checked_by_the_builtin(name, factor, shift):
    """Numbers on which a result does not depend are refused in plain calls, as in all others."""
    fast, given = compiled("two"), one(numbers(chain_named("two"), 1), 0)
    tau = given.pop("tau")
    assert np.isfinite(fast.kinetic_energy(**given))
    assert fast.joint_margins(given["q"], given["qd"], tau).effort.size
    given[name] = factor * given[name] + shift
    for function in (fast.kinetic_energy, fast.closure):
        with pytest.raises(StateError):
            function(*given.values())


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


@pytest.mark.parametrize("again", [copy.deepcopy, copy.copy, lambda x: pickle.loads(pickle.dumps(x))])
def test_compiled_chains(again):
    """The copy answers with the same bits, by the same code."""
    chain, fast = chain_named("nine"), compiled("nine")
    other = again(fast)
    assert other is not fast and other.options == fast.options
    assert other.forward_dynamics.calls.kernel is fast.forward_dynamics.calls.kernel
    given = numbers(chain, 5) | problems.forces(chain, 5)
    assert all_same_bits(outputs(other.forward_dynamics(**given)), outputs(fast.forward_dynamics(**given)))
    single = other.forward_dynamics(**one(given, 2))
    for _ in range(2):
        other.forward_dynamics(**one(given, 2), out=single)
        assert all_same_bits(outputs(single), outputs(fast.forward_dynamics(**one(given, 2))))


def test_generic_rank_travels():
    """What was found out need not be sought again."""
    p = as_chain(planar_parallelogram(0.3))
    fast = holdfast.compile(p.chain)
    expected = fast.forward_dynamics(**problems.given_by(p))
    other = pickle.loads(pickle.dumps(fast))
    assert other.generic_rank == 9
    found = other.forward_dynamics(**problems.given_by(p))
    assert found.status is Status.INDETERMINATE_FORCES and all_same_bits(outputs(found), outputs(expected))


@pytest.mark.parametrize("batch", [None, 0, 3])
def test_results(batch):
    """A result comes back with the same numbers, statuses and parts; it no longer depends on the code."""
    chain, fast = chain_named("nine"), compiled("nine")
    given = one(numbers(chain, 1), 0) if batch is None else numbers(chain, batch)
    result = fast.forward_dynamics(**given)
    for other in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):
        assert type(other) is type(result) and other.batch == batch
        assert all_same_bits(outputs(other), outputs(result))
        assert np.array_equal(other.status, result.status) and np.array_equal(other.rank, result.rank)
        assert np.array_equal(other["arm3"].qdd, result["arm3"].qdd)
        other.qdd[...] = 0.0
        assert other["arm0"].qdd.base is not None and not other["arm0"].qdd.any()
        assert not batch or result.qdd.any()
    assert type(result.chain).__name__ == "ClosedChain" and result.method == "sequential"


@pytest.mark.parametrize("name", QUESTIONS)
def test_functions(name):
    """A function is that of its question again, and so are its derivatives."""
    chain = chain_named("two")
    of = getattr(CompiledChain(chain, Options(), None), name)
    made = [of, of.derived("vjp", of.question.names[:1], of.question.by[:1])] if of.question.by else [of]
    for function in made:
        for other in (pickle.loads(pickle.dumps(function)), copy.deepcopy(function)):
            assert other is not function and (other.question, other.request) == (function.question, function.request)
            assert other.name == function.name and [*other.externals] == [*function.externals]
