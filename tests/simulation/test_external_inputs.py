"""External wrenches that depend on the state: asked at every instant for its own state, and what is refused."""

from __future__ import annotations

import functools
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiler.errors import CompileError
from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.environment import take_state
from holdfast.simulation.stepper import ReferenceStepper
from tests.control.two_pandas import rubber_pandas
from tests.longer import mostly_long, mostly_slow
from tests.simulation.rollout.problems import arrays, tiled
from tests.simulation.runs import limp
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain
from tests.systems.problems import relative_gap
from tests.systems.sprung import by_hand, with_springs
from tests.systems.trunk_runs import still_base

FREE = hf.ControlLaw(lambda t, state, memory, given: (0.0 * state.qd, memory), key="tests: no torques")
EXTERNAL, DAMPING = WORK_TERMS.index("external"), WORK_TERMS.index("damping")
WAYS = [  # of taking steps, and the damping of every joint [N m s/rad]
    ({"make_stepper": ReferenceStepper}, 0.0),
    ({}, 0.0),
    ({"scheme": "dop853", "rtol": 1e-10}, 0.0),
    ({"scheme": "midpoint", "largest_drift": 1e-9}, 0.0),
    ({}, 3e3),
]
ONCE, AGAIN = ([(*way, (limp, FREE)[(k + again) % 2]) for k, way in enumerate(WAYS)] for again in (0, 1))
SPRUNG = mostly_slow(ONCE, ONCE[::2][:2]) + mostly_long(AGAIN, ())


def sprung(damping: float = 0.0) -> tuple[hf.ClosedChain, hf.State]:
    """Return a chain with springs between bodies of all kinds, its bases still, and a state in motion.

    Args:
        damping: of every joint besides; much of it makes steps implicit [N m s/rad].
    """
    options = {"moving_base": False, "extras": False, "joint_speed": 0.7, "gravity": (0, 0, -9.81)}
    p = as_chain(well_conditioned_system(4, joints=(4, 3), grasps=["rigid", "ball"], **options))
    chain = with_springs(p.chain, 4)
    joints = {name: [replace(j, damping=damping) for j in arm.joints] for name, arm in chain.arms.items()}
    arms = {name: replace(arm, joints=joints[name]) for name, arm in chain.arms.items()}
    return replace(chain, arms=arms), p.state


def compared(found: hf.Trajectory, expected: hf.Trajectory) -> float:
    """Return by how much two runs differ, relative to each array's size."""
    names = ("t", "q", "qd", "qdd", "object_pose", "object_twist", "grasp_wrench", "base_wrench", "kinetic", "momentum")
    return max(relative_gap(getattr(found, name), getattr(expected, name)) for name in names)


@pytest.mark.slow
@pytest.mark.parametrize(("options", "damping", "controller"), SPRUNG)
def test_a_spring_by_hand(options: dict[str, Any], damping: float, controller: Any):
    """Is the library's spring: same motion, forces and balances, but that what it stores counts as work done on it."""
    chain, state = sprung(damping)
    expected = hf.simulate(chain, state, controller, 0.06, 1e-3, **options)
    found = hf.simulate(replace(chain, springs=()), state, controller, 0.06, 1e-3, inputs=by_hand(chain), **options)
    assert found.stopped is None and len(found) >= 60
    assert bool(damping) == any(one.kind == "stiff" for one in found.occurrences)
    assert compared(found, expected) <= 1e-12
    assert np.abs(found.work[:, EXTERNAL]).max() > 1e-2
    assert relative_gap(found.momentum_imbalance, expected.momentum_imbalance) <= 1e-6


def at_hundredths(run: hf.Trajectory, term: int = DAMPING) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, what potential energy has changed by, and work of one kind, every hundredth of a second."""
    rows = np.flatnonzero(np.abs(run.t / 0.01 - np.round(run.t / 0.01)) < 1e-9)
    return run.t[rows], run.potential[rows] - run.potential[0], run.work[rows, term]


@pytest.mark.slow
def test_balances():
    """The work of the wrenches is what the springs would have taken out of store, less what their dampers lost."""
    chain, state = sprung()
    options = {"scheme": "dop853", "rtol": 1e-13}
    expected = hf.simulate(chain, state, limp, 0.05, 0.01, **options)
    found = hf.simulate(replace(chain, springs=()), state, limp, 0.05, 0.01, inputs=by_hand(chain), **options)
    (t, stored, lost), (same_t, none, also) = map(at_hundredths, (expected, found))
    assert t.tolist() == same_t.tolist() and len(t) == 6
    stored, lost, done = stored - none, lost - also, at_hundredths(found, EXTERNAL)[2]
    size = np.abs(found.kinetic).max()
    assert np.ptp(lost) > 1e-2 and np.ptp(stored) > 0.1
    assert np.abs(done + stored - lost).max() <= 1e-11 * size
    assert np.abs(found.imbalance).max() <= 1e-11 * size
    assert np.abs(found.momentum_imbalance).max() <= 1e-6 * np.abs(found.momentum).max()


def test_what_is_recorded():
    """Every sample's forces are those of forward dynamics at its own time and state, between them too."""
    chain, state = sprung()
    plain, acting = replace(chain, springs=()), by_hand(chain)
    asked = []

    def watched(t: float, now: hf.State) -> hf.Inputs:
        asked.append((t, now))
        return acting(t, now)

    run = hf.simulate(plain, state, limp, 0.01, 1e-3, inputs=watched, make_stepper=ReferenceStepper)
    for k in range(len(run)):
        now = run.state(k)
        again = hf.forward_dynamics(plain, now, np.zeros(plain.joint_count), inputs=acting(run.t[k], now))
        assert relative_gap(run.qdd[k], again.qdd) <= 1e-12
        assert relative_gap(run.grasp_wrench[k], again.grasp_wrench) <= 1e-12
    assert {round(t / 0.5e-3, 9) for t, _ in asked} == set(range(21))  # stages of rk4


@pytest.mark.slow
def test_slips_events_and_limits():
    """A hand that lets go, one that grips and a contact that slips under the spring: all at the same instants."""
    chain, state = rubber_pandas(0.8)
    spring = hf.Spring(("world", (0, 0, -0.2)), ("object", (0, 0, -0.1)), 300.0, 0.62, 5.0)
    hold = hf.holding_torques(chain, state, internal_force=30.0)

    def pulled(t: float, now: hf.State, memory: Any) -> tuple[np.ndarray, Any]:
        return hold - np.r_[np.zeros(5), 40.0 * t, np.zeros(8)] - 10.0 * now.qd, memory

    sprung = replace(chain, springs=[spring])
    options: dict[str, Any] = {"on_slip": "release"}
    expected = hf.simulate(sprung, state, pulled, 0.3, 2e-3, **options)
    found = hf.simulate(chain, state, pulled, 0.3, 2e-3, inputs=by_hand(sprung), **options)
    assert [one.kind for one in found.occurrences] == [one.kind for one in expected.occurrences]
    assert {"violation", "release"} <= {one.kind for one in found.occurrences}
    late = np.array([one.t for one in found.occurrences]) - [one.t for one in expected.occurrences]
    assert np.abs(late).max() <= 1e-10
    assert relative_gap(found.q, expected.q) <= 1e-10


def test_gripping():
    """An arm that grips in motion under the spring: the same impulse, the same motion after it."""
    chain, state = sprung()
    loose, grip = chain.without_grasp("arm1"), hf.Attach(2e-3, "arm1", chain.grasps["arm1"], here=True)
    runs = [
        hf.simulate(one, state, limp, 6e-3, 1e-3, events=[grip], inputs=acting)
        for one, acting in ((loose, None), (replace(loose, springs=()), by_hand(chain)))
    ]
    assert all(run.stopped is None for run in runs) and runs[0].occurrences[0].kind == "attach"
    assert compared(runs[1], runs[0]) <= 1e-12
    gained = [run.occurrences[0].energy_change for run in runs]
    assert gained[1] == pytest.approx(gained[0], rel=1e-12)


@pytest.mark.long
def test_on_a_trunk():
    """Wrenches on a trunk's bodies and on the arms' links, where steps are machine code: the reference's."""
    p = still_base(3, 1, floating=True, in_world=0.0, arms={"joints": (3, 2), "grasps": ("ball", None)})
    chain = p.chain
    assert chain.trunk is not None
    n, bodies = chain.joint_count - len(chain.trunk.joints), len(chain.trunk.bodies)

    def drag(t: float, now: hf.State) -> hf.Inputs:
        push = (1.0 + t) * now.object_twist
        on_trunk = np.tile(0.2 * push, (bodies, 1))
        return hf.Inputs(-2.0 * push, np.tile(-0.3 * push, (n, 1)), trunk_link_wrenches=on_trunk)

    ways = [(drag, ReferenceStepper), (drag, None), (None, ReferenceStepper)]
    given = chain, p.state, limp, 0.05, 1e-3
    reference, fast, without = (hf.simulate(*given, inputs=acting, make_stepper=make) for acting, make in ways)
    assert compared(fast, reference) <= 1e-11 and compared(without, reference) > 1e-3


def test_which_functions_take_the_state():
    """Those that cannot be called with a time alone; a default, however it is named, makes a function of time."""
    nothing = hf.Inputs()

    class Wind:
        def __call__(self, t: float, state: hf.State) -> hf.Inputs:
            return nothing

        def gust(self, t: float) -> hf.Inputs:
            return nothing

    def three(t: float, state: hf.State, gain: float) -> hf.Inputs:
        return nothing

    of_time = nothing, lambda t: nothing, lambda t, gain=2.0: nothing, Wind().gust, lambda *a: nothing
    of_state = lambda t, state: nothing, Wind(), functools.partial(three, gain=1.0), lambda t, x, k=1: nothing
    assert not any(map(take_state, of_time)) and all(map(take_state, of_state))
    for given in (three, lambda: nothing, lambda t, *, state: nothing):
        with pytest.raises(hf.errors.ModelError, match=r"or \(t, state\) -> Inputs, got one that is called with \("):
            take_state(given)
    with pytest.raises(hf.errors.ModelError, match="got ndarray; try Inputs"):
        take_state(np.zeros(6))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["base_twists", "base_accelerations"])
def test_bases_move_with_time_alone(name: str):
    """Inputs of the state that move bases are refused, in rollouts those of time too; and what is no Inputs."""
    chain, state = sprung()
    moving = hf.Inputs(**{name: np.zeros((2, 6))})
    for inputs, message in (
        (lambda t, now: moving, rf"\(t, state\): {name}: expected none.*try base_motion"),
        (lambda t, now: now.qd, "return Inputs, got ndarray"),
        (lambda t, now: hf.Inputs(now.qd), r"object_wrench: expected shape \(6,\), got shape \(7,\)"),
    ):
        with pytest.raises(hf.errors.StateError, match=message):
            hf.simulate(chain, state, limp, 0.01, 1e-3, inputs=inputs)
    rollout = hf.compile_rollout(chain, FREE, inputs=lambda t: moving)
    with pytest.raises(hf.errors.StateError, match=f"of a rollout: {name}: expected none"):
        rollout.start(**arrays(state))


def lone() -> tuple[hf.ClosedChain, hf.State]:
    """Return an arm of three joints that holds a box by a ball, in motion."""
    p = as_chain(well_conditioned_system(8, joints=(3, 2), grasps=["ball", None], moving_base=False, extras=False))
    return p.chain, p.state


def tied(chain: hf.ClosedChain) -> hf.ClosedChain:
    """Return the chain with springs from the object to the world and to a link, and between two arms' links."""
    first, second = chain.arms
    springs = [
        hf.Spring(("world", (0.3, 0.2, 0.9)), ("object", (0.05, 0, 0.1)), 60.0, 0.4, 2.0),
        hf.Spring((first, 0, (0.1, 0, 0.2)), (second, 1, (0, 0.1, 0)), 40.0, 0.3, 0.5),
    ]
    return replace(chain, springs=springs)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["rk4", "midpoint"])
def test_rollouts(scheme: str):
    """A spring by hand becomes machine code, of many systems, as the library's does; calls' wrenches come on top."""
    chain, state = lone()
    with_springs, steps = tied(chain), 20
    push = np.array([0.1, 0.2, -0.1, 1.0, -2.0, 0.5])
    rollout = hf.compile_rollout(chain, FREE, scheme=scheme, inputs=by_hand(with_springs))
    systems = rollout.start(**tiled(state, 3), object_wrench=push)
    rollout.step(systems, 1e-3, steps=steps)
    options: dict[str, Any] = {"scheme": scheme, "make_stepper": ReferenceStepper}
    run = hf.simulate(with_springs, state, limp, steps * 1e-3, 1e-3, inputs=hf.Inputs(push), **options)
    assert systems.running.all()
    for name in ("q", "qd", "qdd", "object_pose", "object_twist", "grasp_wrench"):
        assert relative_gap(np.array(getattr(systems, name)[2]), getattr(run, name)[-1]) <= 1e-12
    acting = by_hand(with_springs)
    options["inputs"] = lambda t, now: pushed(acting(t, now), push)
    own = hf.simulate(chain, state, limp, steps * 1e-3, 1e-3, **options)
    assert relative_gap(systems.work[2], own.work[-1]) <= 1e-11


def pushed(inputs: hf.Inputs, push: np.ndarray) -> hf.Inputs:
    """Return inputs with more of a wrench on the object."""
    assert inputs.object_wrench is not None
    return replace(inputs, object_wrench=inputs.object_wrench + push)


@pytest.mark.slow
def test_rollouts_of_other_wrenches():
    """Systems that go on in a rollout of other wrenches begin with a slope under these; after a pickle to the bit."""
    chain, state = lone()
    start = (state.q, state.qd, state.object_pose, state.object_twist)
    winds = (lambda t, now, size=size: drag(t, now, size) for size in (0.0, 3.0))
    calm, windy = (hf.compile_rollout(chain, FREE, scheme="midpoint", inputs=wind) for wind in winds)
    other, from_start = windy.start(*start), windy.start(*start)
    systems = calm.start(*start)
    windy.step(systems, 1e-3, steps=5)
    windy.step(from_start, 1e-3, steps=5)
    assert relative_gap(systems.q, from_start.q) <= 1e-14
    assert relative_gap(calm.step(calm.start(*start), 1e-3, steps=5).qd, systems.qd) > 1e-5
    again, there = pickle.loads(pickle.dumps((windy, other)))
    again.step(there, 1e-3, steps=5)
    assert there.q.tobytes() == from_start.q.tobytes() and there.qd.tobytes() == from_start.qd.tobytes()
    run = hf.simulate(chain, state, FREE, 5e-3, 1e-3, scheme="midpoint", inputs=again.inputs)
    assert relative_gap(run.q[-1], there.q[0]) <= 1e-12


def drag(t: Any, now: hf.State, size: float) -> hf.Inputs:
    """Return what wind that rises takes from the object."""
    return hf.Inputs(object_wrench=-size * (1.0 + t) * now.object_twist)


def test_what_cannot_be_traced():
    """Names its line; a constant that moves nothing is a constant of the code."""
    chain, state = lone()

    def stepwise(t: Any, now: hf.State) -> hf.Inputs:
        return hf.Inputs(object_wrench=np.ones(6) if now.q[0] > 0.0 else np.zeros(6))

    rollout = hf.compile_rollout(chain, FREE, inputs=stepwise)
    with pytest.raises(CompileError, match=r"test_external_inputs\.py"):
        rollout.start(**arrays(state))
    for given in (3.0, lambda: hf.Inputs()):
        with pytest.raises(hf.errors.ModelError, match=r"inputs: expected"):
            hf.compile_rollout(chain, FREE, inputs=given)  # type: ignore[arg-type]
