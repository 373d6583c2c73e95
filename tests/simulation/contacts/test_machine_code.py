"""Runs with contacts whose stages are machine code are those of the reference."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.simulation import simulate as simulated
from holdfast.simulation.contact_stepper import ContactStepper
from holdfast.simulation.impulse_stepper import ImpulseStepper
from holdfast.simulation.rollout import compiled_impulses
from holdfast.simulation.rollout.contact_stages import StagewiseContactStepper
from holdfast.simulation.rollout.open_contacts import ContactSteppers, OpenContactStepper
from holdfast.simulation.trajectory import array_names
from holdfast.spatial import rotation
from holdfast.world import HalfSpace, Touching, corners
from tests.control.two_pandas import two_pandas
from tests.systems.stored_cases import stored_cases

RECORDED = ("q", "qd", "qdd", "object_pose", "object_twist", "grasp_wrench", "touch_force", "touch_gap", "work")


def lowering(gap):
    """Return two Pandas whose box falls onto a table with one kilogram more than their torques hold."""
    chain, state = two_pandas()
    below = {name: x for name, x in corners(0.3, 0.2, 0.2).items() if name[2] == "-"}
    lowest = min((state.object_frame.R @ x + state.object_frame.p)[2] for x in below.values())
    touching = Touching(below, {"table": HalfSpace(offset=lowest - gap, friction=0.5)})
    tau = hf.holding_torques(replace(chain, held_object=hf.HeldObject.box(2.0, 0.3, 0.2, 0.2)), state)
    return replace(chain, touching=touching), state, lambda t, state, memory: (tau, memory)


@pytest.mark.long
@pytest.mark.parametrize("gap", [0.0, 4e-5])
def test_as_the_reference(monkeypatch, gap):
    """At rest on the table, and across an impact: samples and log agree to 1e-9 of what they are."""
    chain, state, law = lowering(gap)
    fast = hf.simulate(chain, state, law, 0.01, 0.0025, contacts="events")
    monkeypatch.setattr(simulated, "ContactSteppers", lambda steps: ContactStepper)
    true = hf.simulate(chain, state, law, 0.01, 0.0025, contacts="events")
    assert [(one.kind, one.name) for one in fast.occurrences] == [(one.kind, one.name) for one in true.occurrences]
    assert np.abs(fast.t - true.t).max() < 1e-12 and fast.stopped is true.stopped is None
    for name in RECORDED:
        a, b = getattr(fast, name), getattr(true, name)
        assert np.abs(a - b).max() < 1e-9 * max(1.0, np.abs(b).max()), name
    assert fast.position_gap[:, 1].max() < 1e-12
    assert fast.touch_gap.min() > -1e-12


@pytest.mark.slow
def test_whole_steps_while_contacts_are_open(monkeypatch):
    """Until a box lands, whole steps give the samples of the stages and the same landing; after it, stages follow."""
    chain, state, law = lowering(2e-4)
    tau = law(0.0, state, None)[0]
    traced = hf.ControlLaw(lambda t, now, memory, given: (tau - 0.5 * now.qd, memory))
    fast = hf.simulate(chain, state, traced, 0.04, 1e-3)
    monkeypatch.setattr(simulated, "ContactSteppers", lambda steps: ContactSteppers(1))
    monkeypatch.setattr(OpenContactStepper, "take", None)
    true = hf.simulate(chain, state, traced, 0.04, 1e-3)
    assert [(one.kind, one.name) for one in fast.occurrences] == [(one.kind, one.name) for one in true.occurrences]
    assert fast.occurrences[0].kind == "touch" and 0.01 < fast.occurrences[0].t < 0.03
    for one, other in zip(fast.occurrences, true.occurrences, strict=True):
        assert abs(one.t - other.t) < 1e-9
    before = fast.t < fast.occurrences[0].t
    for name in array_names():
        a, b = (np.asarray(getattr(run, name)) for run in (fast, true))
        assert a.shape == b.shape, name
        if name != "lowest_joint" and not name.endswith("_time"):  # both arms have the same margins; some stay the same
            np.testing.assert_allclose(a[before], b[before], rtol=1e-11, atol=1e-11, err_msg=name)
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8, err_msg=name)


@pytest.mark.long
@pytest.mark.parametrize(
    ("twist", "slope"),
    [([0.0, 0.0, 0.8, 0.05, 0.05, 0.0], 0.0), ([0.0, 0.0, 0.0, 0.3, 0.1, 0.0], 0.2), ([0.0] * 6, 0.37)],
)
def test_whole_steps_with_closed_contacts(monkeypatch, twist, slope):
    """A box that turns, slides and stops, one that slides down, and one at rest whose load is shared in another way."""
    normal = np.array([np.sin(slope), 0.0, np.cos(slope)])
    touching = Touching(corners(0.2, 0.2, 0.1), {"floor": HalfSpace(normal=normal, friction=0.4)})
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, 0.2, 0.2, 0.1), {}, touching=touching)
    frame = hf.Pose(rotation.exp(np.array([0.0, slope, 0.0])), 0.05 * normal)
    state = hf.State([], [], frame, np.concatenate([frame.R @ twist[:3], frame.R @ twist[3:]]))
    none = hf.ControlLaw(lambda t, state, memory, given: (np.zeros(0), memory))
    taken, stages = list[float](), StagewiseContactStepper.advance

    def counted(stepper, now, ends):
        taken.extend(ends)
        return stages(stepper, now, ends)

    monkeypatch.setattr(StagewiseContactStepper, "advance", counted)
    monkeypatch.setattr(simulated, "ContactSteppers", lambda steps: ContactSteppers(1000))
    fast = hf.simulate(chain, state, none, 0.03, 1e-3)
    assert not taken
    monkeypatch.setattr(simulated, "ContactSteppers", lambda steps: ContactSteppers(1))
    true = hf.simulate(chain, state, none, 0.03, 1e-3)
    assert taken and fast.stopped is true.stopped is None
    assert [(one.kind, one.name) for one in fast.occurrences] == [(one.kind, one.name) for one in true.occurrences]
    for one, other in zip(fast.occurrences, true.occurrences, strict=True):
        assert abs(one.t - other.t) < 1e-9
    for name in array_names():
        if not name.endswith("_time"):
            a, b = (np.asarray(getattr(run, name)) for run in (fast, true))
            np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-10, err_msg=name)


@pytest.mark.slow
def test_which_chains():
    """Machine code takes chains with independent grasps that stand still; the reference takes the others."""
    chain, state, law = lowering(0.0)
    made, steppers = [], ContactSteppers(1)

    def noting(*of):
        made.append(steppers(*of))
        return made[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated, "ContactSteppers", lambda steps: noting)
        hf.simulate(chain, state, law, 0.002, 0.002)
        assert isinstance(made[-1], StagewiseContactStepper)
        free = hf.ClosedChain({}, chain.held_object, {}, touching=chain.touching)
        alone = hf.State(np.zeros(0), np.zeros(0), state.object_pose, np.zeros(6))
        hf.simulate(free, alone, None, 0.002, 0.002)
        assert isinstance(made[-1], StagewiseContactStepper)
        still = lambda t: (chain.arms["left"].base, np.zeros(6), np.zeros(6))  # noqa: E731
        hf.simulate(chain, state, law, 0.002, 0.002, base_motion={"left": still})
        assert not isinstance(made[-1], StagewiseContactStepper)


@pytest.mark.slow
def test_steps_without_friction(monkeypatch):
    """A point without friction falls from 2 mm, and no step is left to the reference: also those before the touch."""
    touching = Touching({"p": [0.0, 0.0, 0.0]}, {"floor": HalfSpace(friction=0.0, restitution=0.5)})
    chain = hf.ClosedChain({}, hf.HeldObject.sphere(1.0, 0.1), {}, touching=touching)
    state = hf.State(np.zeros(0), np.zeros(0), hf.Pose.translation(0.0, 0.0, 2e-3), np.zeros(6))
    none = lambda t, state, memory, given: (np.zeros(0), memory)  # noqa: E731
    monkeypatch.setattr(ImpulseStepper, "advance", None)
    run = hf.simulate(chain, state, hf.ControlLaw(none), 0.05, 1e-3, contacts="steps")
    fall = np.sqrt(2 * 2e-3 / 9.81)
    before, after = run.t < fall - 1e-3, run.t > fall + 1e-3
    heights = 2e-3 - 0.5 * 9.81 * run.t**2
    assert np.abs(run.object_pose[before, -1] - heights[before]).max() < 1e-15
    assert abs(run.object_twist[after][0, 5] / (0.5 * 9.81 * fall) - 1) < 0.2  # within a step of the rebound


@pytest.mark.slow
def test_steps_under_python_functions(monkeypatch):
    """A controller with memory and wrenches that are functions: the motion of the reference, and of a traced law."""
    case = stored_cases("cases_contact.json")["contact_arm_strikes_wall"]
    chain, state = case.chain(), case.state()
    wall, p = chain.touching.world["wall"], state.object_frame.p
    near = replace(wall, offset=wall.normal @ p - chain.touching.points["sphere"].radius - 1e-4)
    chain = replace(chain, touching=replace(chain.touching, world={"wall": near}))

    def torque(t, state, memory, given):
        return -0.2 * state.qd + memory, 0.9 * memory + 0.01 * state.q

    def controller(t, state, memory):
        return torque(t, state, np.zeros(1) if memory is None else memory, None)

    law, push = hf.ControlLaw(torque, memory=np.zeros(1)), lambda t: hf.Inputs(object_wrench=t * np.arange(6.0))
    of, how = (chain, state), {"inputs": push, "contacts": "steps"}
    true = hf.simulate(*of, controller, 0.04, 1e-3, **how)
    monkeypatch.setattr(ImpulseStepper, "advance", None)
    called, traced = (hf.simulate(*of, one, 0.06, 1e-3, **how) for one in (controller, law))
    for name in ("q", "touch_force", "work"):
        np.testing.assert_allclose(getattr(called, name), getattr(traced, name), rtol=1e-12, atol=1e-15, err_msg=name)
        size = max(1.0, np.abs(getattr(true, name)).max())
        assert np.abs(getattr(called, name)[: len(true)] - getattr(true, name)).max() < 1e-9 * size, name
    assert called.touch_force.any()


@pytest.mark.long
@pytest.mark.parametrize(("seed", "until", "within"), [(20, 0.43, 1e-9), (11, 0.1, 1e-7)])
def test_surer_ways(monkeypatch, seed, until, within):
    """A tumbling box: where the whole path finds no impulses, one way of rollouts does (seed 20), or steps in halves.

    No step is left to the reference, whose steps from there find the same: up to rounding, or to the steps' error.
    """
    touching = Touching(corners(0.2, 0.2, 0.1), {"floor": HalfSpace(friction=0.5)})
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, 0.2, 0.2, 0.1), {}, touching=touching)
    dice = np.random.default_rng(seed)
    q = dice.normal(size=4)
    pose = np.array([*q / np.linalg.norm(q), 0.0, 0.0, 0.17])
    state = hf.State([], [], pose, dice.normal(size=6) * np.repeat([3.0, 1.0], 3))
    kept, how = list[Any](), dict[str, Any](contacts="steps")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ImpulseStepper, "advance", None)
        found = hf.simulate(chain, state, None, until, 1e-3, **how, on_checkpoint=kept.append)
    monkeypatch.setattr(compiled_impulses, "STEPS_WORTH_COMPILING", np.inf)
    true = hf.simulate(chain, state, None, until, 1e-3, **how, start=kept[-12])
    for name in ("object_pose", "object_twist", "work"):
        a, b = getattr(found, name)[-len(true) :], getattr(true, name)
        assert np.abs(a - b).max() < within * max(1.0, np.abs(b).max()), name
    total, wanted = (run.touch_force.sum(axis=1) for run in (found, true))  # corners may share it in several ways
    assert np.abs(total[-len(true) :] - wanted).max() < 1e-9 * np.abs(wanted).max()
    assert wanted.any() and found.touch_gap.min() > -1e-12
