"""Laws as machine code give the torques of their own text: called, bound, in batches, and wrapped in a run."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import holdfast as hf
from holdfast import ControlLaw
from holdfast.compiler.errors import CompileError
from holdfast.control.clipped import clipped
from holdfast.control.compiled_law import compile_law
from holdfast.control.controller import machine_code
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.simulation.simulate import laws_by_machine_code
from holdfast.spatial import scalar
from holdfast.spatial.scalar import clip, exp
from tests.control.two_pandas import two_pandas
from tests.simulation.rollout.problems import problem

CHAIN, STATE = two_pandas()
N = CHAIN.joint_count
PATH = RestToRest(STATE.object_frame, displacement=[0, 0, 0.2], turn=[0, 0.1, 0.3], begin=0.0, duration=1.5)
LAWS = {
    "gravity": GravityCompensation(CHAIN, internal_force=20.0, joint_damping=0.3),
    "tracking": ObjectTracking(CHAIN, PATH.at, internal_force=15.0),
    "clipped": clipped(ObjectTracking(CHAIN, PATH.at), CHAIN),
}
REMEMBERING = ControlLaw(
    lambda t, x, m, given: (given["gain"] * (given["target"] - x.q) - (1.0 + t) * x.qd + m[0], 0.5 * m + x.q[:3]),
    memory=np.array([0.1, 0.2, 0.3]),
    parameters={"gain": (), "target": (N,)},
)
GIVEN = {"gain": 3.0, "target": np.linspace(0.0, 1.0, N)}


def moving(seed: int) -> hf.State:
    """Return a state near the grasps, in motion."""
    random = np.random.default_rng(seed)
    q = STATE.q + 0.1 * random.normal(size=N)
    return hf.State(q, random.normal(size=N), STATE.object_pose, random.normal(size=6))


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_called_as_a_controller(name):
    """The torques to rounding, and the memory that it was given."""
    law = compile_law(LAWS[name], CHAIN)
    for seed, t in enumerate((0.0, 0.4, 2.0)):
        state = moving(seed)
        tau, memory = law(t, state, "kept")
        expected, _ = LAWS[name](t, state, None)
        assert memory == "kept"
        np.testing.assert_allclose(tau, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_saturating_words():
    """Hard and soft limits, in the library's words and in NumPy's functions of one argument."""
    limits = np.linspace(2.0, 80.0, N)

    def law(t, state, memory, given):
        soft = limits * np.tanh(-30.0 * state.qd / limits)
        return clip(soft - 50.0 * np.sin(state.q) * exp(-t), -limits, limits), memory

    made = compile_law(ControlLaw(law), CHAIN)
    for seed in range(3):
        state = moving(seed)
        tau, _ = made(0.3, state, None)
        assert (np.abs(tau) <= limits).all()
        assert (np.abs(tau) == limits).any()
        np.testing.assert_allclose(tau, law(0.3, state, None, {})[0], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("word", ["minimum", "maximum", "where", "clip", "tanh", "exp", "arctan2"])
def test_words_on_arrays(word):
    """The words with NumPy's names say of traced arrays what NumPy's functions say of numbers."""
    ours, theirs, limits = getattr(scalar, word), getattr(np, word), np.linspace(0.1, 1.0, N)
    arguments = {
        **dict.fromkeys(("minimum", "maximum", "arctan2"), lambda q: (q, limits)),
        **dict.fromkeys(("tanh", "exp"), lambda q: (q,)),
        "where": lambda q: (scalar.less(q, limits), q, 2.0),
        "clip": lambda q: (q, -limits, 0.5),
    }[word]
    made = compile_law(ControlLaw(lambda t, x, memory, given: (ours(*arguments(x.q)), memory)), CHAIN)
    state = moving(3)
    np.testing.assert_allclose(made(0.0, state, None)[0], theirs(*arguments(state.q)), rtol=1e-15)


def test_memory_and_parameters():
    """What a law remembers moves on as its text says; parameters are given once, or with a call."""
    own, law = REMEMBERING.given(GIVEN), compile_law(REMEMBERING.given(GIVEN), CHAIN)
    mine = theirs = None
    for seed in range(3):
        (tau, mine), (expected, theirs) = (f(0.3, moving(seed), m) for f, m in ((law, mine), (own, theirs)))
        np.testing.assert_allclose(tau, expected, atol=1e-13)
        np.testing.assert_allclose(mine, theirs, atol=1e-14)
    state = moving(7)
    free = compile_law(REMEMBERING, CHAIN)
    found = free.torques(0.3, state.q, state.qd, state.object_pose, state.object_twist, memory=mine, **GIVEN)
    for a, b in zip(found, law(0.3, state, mine), strict=True):
        assert np.array_equal(a, b)
    with pytest.raises(StateError, match="the law takes gain, target, got no value"):
        free(0.3, state, None)


def test_batches_and_bound_calls_have_the_bits_of_single_ones():
    """Whatever their number, whoever shares what, in however many threads."""
    law, states = compile_law(REMEMBERING, CHAIN), [moving(seed) for seed in range(11)]
    q, qd = np.array([x.q for x in states]), np.array([x.qd for x in states])
    times, target = np.linspace(0.0, 1.0, 11), np.random.default_rng(1).normal(size=(11, N))
    shared = STATE.object_pose, STATE.object_twist
    every = law.torques(times, q, qd, *shared, gain=2.0, target=target, threads=2)
    assert every.tau.shape == (11, N)
    assert every.memory.shape == (11, 3)
    bound = law.bind(object_pose=STATE.object_pose, gain=2.0)
    for k in range(11):
        one = law.torques(times[k], q[k], qd[k], *shared, gain=2.0, target=target[k])
        assert np.array_equal(one.tau, every.tau[k])
        assert np.array_equal(one.memory, every.memory[k])
        bound.t[...], bound.q[...], bound.qd[...], bound.target[...] = times[k], q[k], qd[k], target[k]
        bound.object_twist[...] = STATE.object_twist
        assert np.array_equal(bound(), one.tau)
        assert np.array_equal(bound.kept, one.memory)
    bound.keep()
    assert np.array_equal(bound.memory, bound.kept)
    none = law.torques(times[:0], q[:0], qd[:0], *shared, gain=2.0, target=target[:0])
    assert none.tau.shape == (0, N)


def test_where_it_does_not_apply():
    """Refused by name; in a batch an invalid system alone has no torques; large angles are the law's own text's."""
    with pytest.raises(MethodNotApplicable, match="expected a ControlLaw or a built-in controller, got function"):
        compile_law(lambda t, x, m: (np.zeros(N), m), CHAIN)
    with pytest.raises(ModelError, match="chain: expected the ClosedChain whose joints the law drives, got none"):
        compile_law(REMEMBERING)
    with pytest.raises(StateError, match="parameter 'q': expected another name"):
        compile_law(ControlLaw(lambda t, x, m, given: (given["q"], m), parameters={"q": (N,)}), CHAIN)
    with pytest.raises(CompileError, match="torques: expected shape"):
        compile_law(ControlLaw(lambda t, x, m, given: (x.q[:2], m)), CHAIN)(0.0, STATE, None)
    law, pose, twist = compile_law(REMEMBERING.given(GIVEN), CHAIN), STATE.object_pose, STATE.object_twist
    with pytest.raises(StateError, match="q: expected finite numbers, got nan"):
        law.torques(0.0, np.full(N, np.nan), STATE.qd, pose, twist)
    with pytest.raises(StateError, match=r"no argument 'gian'. Did you mean 'gain'"):
        law.torques(0.0, STATE.q, STATE.qd, pose, twist, gian=1.0)
    with pytest.raises(StateError, match="q: expected shape"):
        law.torques(0.0, STATE.q[1:], STATE.qd, pose, twist)
    with pytest.raises(StateError, match="bind: q: expected shape"):
        law.bind(q=STATE.q[1:])
    with pytest.raises(
        hf.errors.FrozenError, match=r"bound: q: expected the array .* to stay; try bound.q\[...\] = values"
    ):
        law.bind().q = STATE.q
    some = law.torques(0.0, np.array([STATE.q, np.full(N, np.inf)]), STATE.qd, pose, twist).tau
    assert np.isfinite(some[0]).all() and np.isnan(some[1]).all()
    far = hf.State(STATE.q + 1e6, STATE.qd, STATE.object_pose)
    gravity = compile_law(LAWS["gravity"])
    assert np.array_equal(gravity(0.0, far, None)[0], LAWS["gravity"](0.0, far, None)[0])


def test_pickled():
    """A ready-made law and its machine code go to other processes."""
    law = compile_law(LAWS["tracking"])
    again = pickle.loads(pickle.dumps(law))
    assert np.array_equal(again(0.2, STATE, None)[0], law(0.2, STATE, None)[0])


def test_wrapped_in_a_function():
    """In a run worth it what a function calls is machine code, to rounding; elsewhere nothing changes."""
    law = LAWS["tracking"]
    plain = law(0.4, STATE, None)[0]
    with laws_by_machine_code(CHAIN, 10_000):
        fast = law(0.4, STATE, None)[0]
        assert np.array_equal(fast, compile_law(law)(0.4, STATE, None)[0])
        # one that cannot be traced stays as it is
        branching = ControlLaw(lambda t, x, m, given: (x.q if x.q[0] > 0.0 else -x.q, m))
        solving = ControlLaw(lambda t, x, m, given: (np.linalg.solve(np.diag(1.0 + x.q**2), x.q), m))
        for other in (branching, solving):
            assert np.array_equal(other(0.0, STATE, None)[0], other.given({}).on_floats(0.0, STATE, None)[0])
    np.testing.assert_allclose(fast, plain, rtol=0.0, atol=1e-12)
    assert not np.array_equal(fast, plain)
    assert machine_code.get() is None
    assert np.array_equal(law(0.4, STATE, None)[0], plain)


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, pytest.param(1e-3, marks=pytest.mark.long)])
def test_runs_of_wrapped_laws(sample_time):
    """A run under a law is one under a function that calls it, and both go on to the bit."""
    chain, state = problem("one")
    law = GravityCompensation(chain, joint_damping=0.5)

    def wrapped(t, x, memory):
        tau, _ = law(t, x, None)
        return tau + 0.1, memory

    def expected(t, x, memory):
        tau = law.__class__.__call__(replaced, t, x, None)[0]
        return tau + 0.1, memory

    replaced = Text(chain, joint_damping=0.5)
    kept = []
    steps = 260 if sample_time else 16
    given = state, wrapped, steps * 1e-3, 1e-3
    run = hf.simulate(chain, *given, sample_time=sample_time, on_checkpoint=kept.append)
    other = hf.simulate(chain, state, expected, *given[2:], sample_time=sample_time)
    np.testing.assert_allclose(run.q, other.q, rtol=0.0, atol=1e-10)
    rest = hf.simulate(chain, *given, sample_time=sample_time, start=kept[len(kept) // 2])
    assert np.array_equal(rest.tau, run.tau[len(kept) // 2 + 1 :])


class Text(GravityCompensation):
    """Gravity compensation that is never machine code."""

    traceable = False


def test_a_controller_is_no_law():
    """A function of three arguments is refused where the law is made, with what is missing; others are not."""
    with pytest.raises(ModelError, match=r"got one of \(t, now, memory\); try a fourth argument"):
        ControlLaw(lambda t, now, memory: (np.zeros(N), memory))
    for torque in (lambda *all_four: (np.zeros(N), all_four[2]), lambda t, now, memory, given=None: (now.qd, memory)):
        assert compile_law(ControlLaw(torque), CHAIN)(0.0, STATE, None)[0] == pytest.approx(np.zeros(N))
