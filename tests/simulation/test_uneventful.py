"""Steps taken together: the same samples, to the bit, as steps taken one by one; and each sample is asked for once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any
from unittest import mock

import numpy as np
import pytest
from benchmarks.bench.systems import facing_pandas
from examples.benchmarks.n_four_bar import n_four_bar

import holdfast as hf
from holdfast.forces.force_split import split
from holdfast.simulation import run as run_module
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout import compiled_steppers, mechanism_steppers
from holdfast.simulation.rollout.fused_stepper import MOST_TOGETHER
from holdfast.simulation.run import FEWEST_TOGETHER, Pace
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.simulation.uneventful import uneventful_steps
from holdfast.simulation.zero_order_hold import AskedOnce
from holdfast.spatial import scalar
from holdfast.world import HalfSpace, Touching, corners
from tests.longer import mostly_long, mostly_slow
from tests.simulation.problems import PROBLEMS
from tests.systems.branched import branched_problems, swinging

STEP, STEPS = 1e-3, 80
RUBBER = hf.Friction(mu=0.8, torsion_radius=0.02)


def springs(chain: hf.ClosedChain, state: hf.State, push: float = 40.0, stiffness: float = 200.0) -> hf.ControlLaw:
    """Return a law that holds a chain by springs in its joints, a little beside where it is."""
    hold = hf.holding_torques(chain, state, internal_force=push)
    aside = state.q + 0.002 * np.cos(np.arange(chain.joint_count))
    return hf.ControlLaw(lambda t, now, memory, given: (hold + stiffness * (aside - now.q) - 2.0 * now.qd, memory))


def swaying(t: Any) -> Any:
    """Return the motion of a base that moves to and fro by a centimetre."""
    along = scalar.array([-0.55 + 0.01 * (1.0 - scalar.cos(6.0 * t)), 0.0, 0.0])
    pose = np.concatenate([[1.0, 0.0, 0.0, 0.0], along])
    none = np.zeros(3)
    return (
        pose,
        np.concatenate([none, [0.06 * scalar.sin(6.0 * t), 0.0, 0.0]]),
        np.concatenate([none, [0.36 * scalar.cos(6.0 * t), 0.0, 0.0]]),
    )


swaying.traceable = True  # type: ignore[attr-defined]


def of_pandas(kind: Any = "rigid", contact: hf.Friction | None = None, **options: Any) -> Callable[[], Any]:
    """Return what simulates two Pandas that hold a box."""

    def run(**more: Any) -> hf.simulation.Trajectory:
        chain, state = facing_pandas(kind, contact)
        return hf.simulate(chain, state, springs(chain, state), STEPS * STEP, STEP, **options, **more)

    return run


def by_function(kind: Any = "rigid", contact: hf.Friction | None = None, **options: Any) -> Callable[[], Any]:
    """Return what simulates two Pandas under a Python function with a memory, which integrates."""

    def run(**more: Any) -> hf.simulation.Trajectory:
        chain, state = facing_pandas(kind, contact)
        return hf.simulate(chain, state, integrating(chain, state), STEPS * STEP, STEP, **options, **more)

    return run


def integrating(chain: hf.ClosedChain, state: hf.State) -> Callable[[float, hf.State, Any], Any]:
    """Return springs as a Python function, with a sum of errors as memory."""
    law = springs(chain, state)

    def controller(t: float, now: hf.State, memory: Any) -> Any:
        summed = (0.0 if memory is None else memory) + STEP * (state.q - now.q)
        return np.asarray(law.torque(t, now, np.zeros(0), {})[0]) + 5.0 * summed, summed

    return controller


def wind(t: float) -> hf.Inputs:
    """Return a push on the object that comes and goes."""
    return hf.Inputs(object_wrench=[0.0, 0.0, 0.1, 0.0, 4.0 * math.sin(60.0 * t), 0.0])


def drag(t: float, now: hf.State) -> hf.Inputs:
    """Return what a fluid takes from the object and from every link, more and more."""
    turning, moving = now.object_twist[:3], now.object_twist[3:]
    return hf.Inputs(
        [*(-0.1 * turning), *(-20.0 * (1.0 + t) * moving)], np.tile([0.0, 0.0, 0.02, 0.0, -0.3, 0.0], (14, 1))
    )


def beyond_limits(function: bool = False, **more: Any) -> hf.simulation.Trajectory:
    """Simulate arms whose drives are asked for more than their limits most of the time, which is recorded."""
    chain, state = facing_pandas("softfinger", RUBBER)
    joints = {name: [replace(joint, effort_limit=4.0) for joint in arm.joints] for name, arm in chain.arms.items()}
    weak = replace(chain, arms={name: replace(arm, joints=joints[name]) for name, arm in chain.arms.items()})
    law = integrating(chain, state) if function else springs(chain, state)
    return hf.simulate(weak, state, law, STEPS * STEP, STEP, **more)


def tracking(rise: float = 0.01, table: float | None = None, **more: Any) -> hf.simulation.Trajectory:
    """Simulate arms that move an object; margins of their joints have their lowest minima on the way.

    Args:
        rise: how far the object rises [m].
        table: how far a table is below it at the start [m]; None for none.
        **more: options of `simulate`.
    """
    chain, state = facing_pandas()
    path = hf.control.RestToRest(state.object_frame, [0.0, 0.0, rise], duration=STEPS * STEP)
    law = hf.control.ObjectTracking(chain, path, internal_force=40.0)
    if table is not None:
        height = float(state.object_frame.p[2]) - table
        touching = Touching({"foot": [0.0, 0.0, 0.0]}, {"table": HalfSpace(offset=height, friction=0.4)})
        chain = replace(chain, touching=touching)
    return hf.simulate(chain, state, law, STEPS * STEP, STEP, **more)


def sliding(spin: float, slope: float = 0.0) -> Callable[..., hf.simulation.Trajectory]:
    """Return what simulates a box on a floor, which slides and stops, or stands where it hardly sticks."""

    def run(**more: Any) -> hf.simulation.Trajectory:
        frame = hf.Pose.from_rpy(0.0, slope, 0.0)
        floor = HalfSpace(normal=frame.R[:, 2], offset=-0.05, friction=0.4)
        touching = Touching(corners(0.2, 0.2, 0.1), {"floor": floor})
        chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, 0.2, 0.2, 0.1), {}, touching=touching)
        none = hf.ControlLaw(lambda t, now, memory, given: (np.zeros(0), memory))
        state = hf.State([], [], frame, spin * np.array([0.0, 0.0, 0.8, 0.1, 0.1, 0.0]))
        with mock.patch.object(compiled_steppers, "STEPS_WORTH_COMPILING", 1):
            return hf.simulate(chain, state, none, STEPS * STEP, STEP, **more)

    return run


def four_bar(**more: Any) -> hf.simulation.Trajectory:
    """Simulate the N-four-bar, whose forces are not unique, through its first flat configuration."""
    free = hf.ControlLaw(lambda t, now, memory, given: (0.0 * now.qd, memory))
    return hf.simulate(*n_four_bar(), free, 0.8, 4e-3, on_singular="continue", **more)


def platform(**more: Any) -> hf.simulation.Trajectory:
    """Simulate a chain with passive joints that slide."""
    chain, state = PROBLEMS["Stewart platform"]()
    return hf.simulate(chain, state, springs(chain, state, 0.0), STEPS * STEP, STEP, **more)


def pendulum(**more: Any) -> hf.simulation.Trajectory:
    """Simulate a chain without joints: a rod on an anchor."""
    rod = hf.HeldObject(1.5, np.diag([0.02, 0.02, 0.001]), com=[0, 0, -0.4])
    chain = hf.ClosedChain({"pin": hf.Anchor()}, rod, {"pin": hf.Grasp("hinge")})
    none = hf.ControlLaw(lambda t, now, memory, given: (np.zeros(0), memory))
    return hf.simulate(chain, hf.State([], [], hf.Pose.from_rpy(0.5, 0, 0)), none, STEPS * STEP, STEP, **more)


def branched(name: str, chain: Any = None, **options: Any) -> Callable[[], Any]:
    """Return what simulates a chain with branches under a law."""

    def run(**more: Any) -> hf.simulation.Trajectory:
        whole, state, tau = branched_problems()[name]
        law = swinging(tau)
        with mock.patch.object(mechanism_steppers, "WHOLE_STEPS_FROM", 1):
            return hf.simulate(whole if chain is None else chain(), state, law, STEPS * STEP, STEP, **options, **more)

    return run


def slippery() -> hf.ClosedChain:
    """Return arms with grippers, one of which holds the box by friction that does not suffice."""
    chain, key = branched_problems()["grippers"].chain, ("arm2", "link6")
    contact = hf.Friction(0.5, torsion_radius=0.02)
    return replace(chain, grasps={**chain.grasps, key: replace(chain.grasps[key], contact=contact)})


RUNS: dict[str, tuple[Callable[..., hf.simulation.Trajectory], int]] = {  # and how many samples at least are together
    "rigid": (of_pandas(), STEPS // 2),
    "soft fingers": (of_pandas("softfinger", RUBBER), STEPS // 2),
    "midpoint": (of_pandas(scheme="midpoint"), STEPS // 2),
    "sampled": (of_pandas("softfinger", RUBBER, sample_time=2 * STEP), STEPS // 2),
    "sampled, delayed": (of_pandas(sample_time=STEP, delay=0.5 * STEP), STEPS // 2),
    "breakpoints": (of_pandas(breakpoints=[0.02, 0.0305]), STEPS // 4),
    "little drift": (of_pandas(largest_drift=1e-13), STEPS // 4),
    "an arm lets go": (of_pandas("softfinger", RUBBER, events=[hf.Release(0.04, "left")]), STEPS // 8),
    "recorded violations": (beyond_limits, STEPS // 2),
    "minima of margins": (tracking, STEPS),
    "minima, sampled": (partial(tracking, sample_time=2 * STEP), STEPS),
    "onto a table": (partial(tracking, -0.01, 0.008), STEPS // 2),
    "a box slides and stops": (sliding(1.0), STEPS // 4),
    "a box hardly sticks": (sliding(0.0, 0.37), STEPS // 2),
    "above a table, sampled": (partial(tracking, 0.01, 1e-4, sample_time=2 * STEP), STEPS // 2),
    "a moving base": (of_pandas(base_motion={"left": swaying}), STEPS // 4),
    "flat linkage": (four_bar, 190),
    "platform": (platform, STEPS // 4),
    "pendulum": (pendulum, STEPS // 2),
    "function": (by_function(), STEPS // 2),
    "function, soft fingers": (by_function("softfinger", RUBBER), STEPS // 2),
    "function, midpoint, breakpoints": (by_function(scheme="midpoint", breakpoints=[0.02, 0.0305]), STEPS // 4),
    "function, a moving base": (by_function(base_motion={"left": swaying}), STEPS // 4),
    "function, an arm lets go": (by_function("softfinger", RUBBER, events=[hf.Release(0.04, "left")]), STEPS // 8),
    "function, recorded violations": (partial(beyond_limits, True), STEPS // 4),
    "function, little drift": (by_function(largest_drift=1e-9), 0),
    "wrench, minima of margins": (of_pandas(inputs=wind), STEPS - 2),
    "function, minima of margins": (by_function(inputs=wind), STEPS - 2),
    "wrench of time": (of_pandas("softfinger", RUBBER, inputs=wind), STEPS // 2),
    "wrench of state": (by_function(inputs=drag, scheme="midpoint"), STEPS // 2),
    "wrench, sampled, delayed": (of_pandas(sample_time=2 * STEP, delay=0.5 * STEP, inputs=drag), STEPS // 2),
    "wrench, breakpoints, a moving base": (
        of_pandas(base_motion={"left": swaying}, inputs=wind, breakpoints=[0.02, 0.0305]),
        STEPS // 4,
    ),
    "branches": (branched("palletiser"), STEPS),
    "branches, sampled, delayed": (branched("palletiser", sample_time=2 * STEP, delay=0.5 * STEP), STEPS // 2),
    "branches, breakpoints": (branched("palletiser", scheme="midpoint", breakpoints=[0.02, 0.0305]), STEPS // 4),
    "branches, little drift": (branched("palletiser", largest_drift=1e-13), STEPS // 4),
    "branches, a floating base": (branched("on a shoulder"), STEPS // 2),
    "branches, recorded violations": (branched("grippers", slippery, on_slip="record"), STEPS // 2),
    "branches, an arm lets go": (branched("grippers", slippery, on_slip="release"), STEPS // 2),
}


SOON = [
    "soft fingers",
    "recorded violations",
    "pendulum",
]
LATER = [
    "sampled, delayed",
    "above a table, sampled",
    "minima, sampled",
    "wrench of state",
    *(x for x in RUNS if x.startswith("function, ")),
]
LATER += ["branches, recorded violations", "branches, an arm lets go"]
EARLIER = [name for name in RUNS if name not in LATER]


@contextmanager
def together(monkeypatch: pytest.MonkeyPatch, allowed: bool) -> Iterator[list[int]]:
    """Within this context, count the samples of steps taken together, or let none be taken together."""
    counts: list[int] = []

    def counted(*given: Any) -> Any:
        found = uneventful_steps(*given) if allowed else None
        counts.append(0 if found is None else len(found.samples))
        return found

    with monkeypatch.context() as patched:
        patched.setattr(run_module, "uneventful_steps", counted)
        yield counts


@pytest.mark.parametrize("name", [*mostly_slow(EARLIER, SOON), *mostly_long(LATER, ())])
def test_same_bits(name, monkeypatch):
    """Samples, log, and every checkpoint, whatever happens; and most steps are indeed taken together."""
    run, least = RUNS[name]
    kept: dict[bool, list[Any]] = {True: [], False: []}
    with together(monkeypatch, True) as counts:
        mine = run(on_checkpoint=kept[True].append)
    with together(monkeypatch, False):
        theirs = run(on_checkpoint=kept[False].append)
    assert sum(counts) >= least
    assert mine.stopped == theirs.stopped
    assert mine.occurrences == theirs.occurrences
    assert mine.recorded == theirs.recorded
    for array in mine.recorded:
        assert getattr(mine, array).tobytes() == getattr(theirs, array).tobytes(), array
    for a, b in zip(kept[True], kept[False], strict=True):
        (x, data), (y, other) = a.to_data(), b.to_data()
        assert data == other
        assert x.keys() == y.keys()
        for array in x:
            assert x[array].tobytes() == y[array].tobytes(), array


def test_a_sample_is_asked_for_once(monkeypatch):
    """Also where steps taken together are taken again one by one, because a minimum or a slip lies in them."""
    chain, state = facing_pandas("softfinger", RUBBER)
    law, asked = springs(chain, state), []

    def controller(t: float, now: hf.State, memory: Any) -> Any:
        asked.append(t)
        return law(t, now, memory)

    with together(monkeypatch, True) as counts:
        run = hf.simulate(chain, state, controller, STEPS * STEP, STEP, sample_time=STEP, on_slip="record")
    assert len(counts) > 3  # some stretches did not come to their end
    assert run.stopped is None
    np.testing.assert_allclose(asked, STEP * np.arange(STEPS), atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("options", mostly_slow([{}, {"scheme": "midpoint"}, {"breakpoints": [0.0205]}], [{}]))
def test_a_function_is_called_at_the_stages(options):
    """Once at each, if no margin needs a closer look; the motion is that of the traced law, and so are the margins."""
    chain, state = facing_pandas("softfinger", RUBBER)
    hold, asked = hf.holding_torques(chain, state, internal_force=40.0), []

    def torque(t: Any, now: Any, memory: Any, given: Any) -> Any:
        return (1.0 - 0.2 * t) * hold - 2.0 * now.qd, memory  # so that it sinks, faster and faster

    def controller(t: float, now: hf.State, memory: Any) -> Any:
        asked.append(t)
        return torque(t, now, None, {})[0], memory

    laws = controller, hf.ControlLaw(torque)
    run, traced = (hf.simulate(chain, state, one, STEPS * STEP, STEP, **options) for one in laws)
    stages = 2 if options.get("scheme") == "midpoint" else 4
    assert stages * STEPS <= len(asked) <= stages * STEPS + 20
    for name in ("t", "q", "qd", "tau", "grasp_wrench", "work", "margin"):
        mine, theirs = getattr(run, name), getattr(traced, name)
        np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=1e-11 * max(1.0, np.abs(theirs).max()), err_msg=name)
    for name in ("lowest_margin", "lowest_joint_margin"):
        mine, theirs = getattr(run, name), getattr(traced, name)
        finite = np.isfinite(theirs)
        np.testing.assert_allclose(mine[finite], theirs[finite], rtol=1e-4, err_msg=name)


@pytest.mark.long
@pytest.mark.parametrize("name", ["wrench of time", "wrench of state", "wrench, sampled, delayed"])
def test_wrenches_by_functions(name):
    """The motion, its forces and its balances are those that the reference finds; the function is called at stages."""
    run, _ = RUNS[name]
    mine, theirs = run(), run(make_stepper=ReferenceStepper)
    assert mine.stopped is None and np.abs(mine.work[:, 3]).max() > 1e-7
    for array in ("t", "q", "qd", "tau", "grasp_wrench", "base_wrench", "work", "margin", "momentum"):
        a, b = getattr(mine, array), getattr(theirs, array)
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-11 * max(1.0, np.abs(b).max()), err_msg=array)


@pytest.mark.slow
def test_constant_wrenches_on_links():
    """Are machine code as well, and do what the reference says."""
    chain, state = facing_pandas()
    acting = hf.Inputs(link_wrenches=np.linspace(-0.5, 0.5, 84).reshape(14, 6))
    given = chain, state, springs(chain, state), 12 * STEP, STEP
    mine, theirs = (hf.simulate(*given, inputs=acting, make_stepper=make) for make in (None, ReferenceStepper))
    calm = hf.simulate(*given)
    for array in ("q", "qd", "grasp_wrench", "work"):
        a, b, without = (getattr(one, array) for one in (mine, theirs, calm))
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-11 * max(1.0, np.abs(b).max()), err_msg=array)
        assert np.abs(without - b).max() > 1e-6


@pytest.mark.slow
def test_bases_do_not_begin_to_move():
    """A function of time that moves a base later than at its start is refused, with the way to say it."""
    chain, state = facing_pandas()
    late = lambda t: hf.Inputs(base_twists=np.zeros((2, 6))) if t > 0.01 else hf.Inputs()  # noqa: E731
    run = hf.simulate(chain, state, springs(chain, state), STEPS * STEP, STEP, inputs=late)
    assert run.t[-1] == pytest.approx(0.01) and run.stopped is not None
    assert "none at t = 0: base_twists: expected none" in run.stopped and "try base_motion=" in run.stopped


@pytest.mark.parametrize("seed", mostly_slow(range(4), ()))
def test_instants_under_a_function(seed):
    """Effort limits are passed when they are under the same law, traced, to a billionth of a second."""
    chain, state = facing_pandas()
    random = np.random.default_rng(seed)
    hold = hf.holding_torques(chain, state, internal_force=20.0)
    size, rate, phase = (random.uniform(*bounds, 14) for bounds in ((1.0, 3.0), (40.0, 200.0), (0.0, 6.0)))

    def torque(t: Any, now: Any, memory: Any, given: Any) -> Any:
        return hold + size * scalar.sin(rate * t + phase) - 3.0 * now.qd, memory

    joints = {
        name: [
            replace(joint, effort_limit=abs(h) + 2.0)
            for joint, h in zip(arm.joints, hold[chain.joints[name]], strict=True)
        ]
        for name, arm in chain.arms.items()
    }
    weak = replace(chain, arms={name: replace(arm, joints=joints[name]) for name, arm in chain.arms.items()})

    def controller(t: float, now: hf.State, memory: Any) -> Any:
        return torque(t, now, None, {})[0], memory

    mine, theirs = (hf.simulate(weak, state, one, 0.1, STEP) for one in (controller, hf.ControlLaw(torque)))
    assert len(theirs.occurrences) > 3
    for a, b in zip(mine.occurrences, theirs.occurrences, strict=True):
        assert (a.kind, a.name, a.quantity) == (b.kind, b.name, b.quantity)
        assert abs(a.t - b.t) < 1e-9


@pytest.mark.slow
def test_a_controller_that_fails():
    """The samples before are kept, and its own error is raised, as when it is asked one by one."""
    chain, state = facing_pandas()
    law, seen = springs(chain, state), []

    def controller(t: float, now: hf.State, memory: Any) -> Any:
        if t > 0.0495:
            raise ZeroDivisionError("at half time")
        return law(t, now, memory)

    for sample_time in (STEP, None):
        seen.clear()
        with pytest.raises(ZeroDivisionError, match="at half time"):
            hf.simulate(chain, state, controller, STEPS * STEP, STEP, sample_time=sample_time, on_sample=seen.append)
        assert float(seen[-1].t) == pytest.approx(0.05 if sample_time else 0.049, abs=1e-12)


def test_asked_once():
    """Only a question with the same state and the very same memory is answered without asking again."""
    asked = []

    def controller(t: float, state: hf.State, memory: Any) -> Any:
        asked.append(t)
        return np.zeros(1), memory

    once = AskedOnce(controller)
    state, other, memory = hf.State([0.1], [0.0], np.eye(7)[0]), hf.State([0.2], [0.0], np.eye(7)[0]), object()
    for given in ((0.0, state, memory), (0.0, state, memory), (0.0, other, memory), (0.0, other, object())):
        once(*given)
    assert asked == [0.0, 0.0, 0.0]


def test_pace():
    """Twice as many as went well; after failure none for a while, twice as long each time; none inside a step."""
    pace, tries = Pace(), []
    for _ in range(60):
        tries.append(pace.may_try())
    assert np.diff(np.flatnonzero(tries)).tolist() == [2, 4, 8, 16]
    pace.taken(FEWEST_TOGETHER, whole=True)
    assert pace.may_try() and pace.most == 2 * FEWEST_TOGETHER
    pace.taken(1, whole=False)
    assert not pace.may_try() and pace.may_try() and pace.most == FEWEST_TOGETHER
    pace.taken(MOST_TOGETHER - 1, whole=False)
    assert pace.most == MOST_TOGETHER and not pace.may_try()
    pace.alone(planned=False)
    assert not pace.may_try()
    pace.alone(planned=True)
    assert pace.may_try()


@pytest.mark.slow
def test_internal_wrenches_of_hinges_on_a_moving_base():
    """Axes that follow a tip are those of the arm where its base is at that time."""
    chain, state = facing_pandas("hinge")
    run = hf.simulate(chain, state, springs(chain, state, 0.0), 0.06, 2e-3, base_motion={"left": swaying})
    for k in (10, len(run) - 1):
        moved = Environment(chain, {"left": swaying}).chain_at(float(run.t[k]))
        parts = split(moved, run.state(k), run.grasp_wrench[k])
        np.testing.assert_allclose(run.internal_wrench[k], parts.internal, atol=1e-10)
