"""Momentum observer: it finds pushes that no sensor measures, at the rate of its gain, and says who is pushed."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, cooperative_law, observation, observed, sampled
from holdfast.errors import MethodNotApplicable, ModelError
from tests.control.kit import CHAIN, DAMPER, HERE, MASS, SPRING, STATE, N
from tests.control.two_pandas import two_pandas

PUSH = np.array([0.2, -0.1, 0.3, 12.0, -16.0, 0.0])  # 20 N
T = 1e-3
HOLD = ObjectImpedance(HERE, SPRING, DAMPER)


@pytest.mark.parametrize(
    "kinds",
    [
        ("rigid", "ball"),
        *(pytest.param(x, marks=pytest.mark.slow) for x in (("rigid", "rigid"), ("hinge", "softfinger"))),
    ],
)
def test_error_shrinks_as_predicted(kinds):
    """Under Euler steps of the velocities, r_k = (1 - (1 - K_o T)^k) w, to 1e-9."""
    chain, state = two_pandas(*kinds)
    law = observed(cooperative_law(chain, HOLD, InternalForce(20.0)), chain, gain=80.0, sample_time=T)
    memory, twist = None, np.zeros(6)
    for k in range(30):
        now = hf.State(state.q, state.qd, state.object_pose, twist)
        tau, memory = law(0.0, now, memory)
        assert observation(law, memory).object_wrench == pytest.approx((1 - 0.92**k) * PUSH, abs=1e-9)
        found = hf.forward_dynamics(chain, now, tau, inputs=hf.Inputs(object_wrench=PUSH), check=False)
        twist = twist + T * found.object_acceleration


def wrapped(law, kept):
    """Return a controller that notes the memories of a law."""

    def controller(t, state, memory):
        tau, memory = law(t, state, memory)
        kept.append(memory)
        return tau, memory

    return controller


@pytest.mark.slow
def test_a_push_is_found():
    """In a run, 20 N on the box are found within 2 % after six time constants, and the flag rises, and falls."""
    law = observed(cooperative_law(CHAIN, HOLD, InternalForce(20.0)), CHAIN, gain=60.0, sample_time=T, threshold=10.0)
    kept = []
    push = lambda t: hf.Inputs(object_wrench=PUSH * (t < 0.1))  # noqa: E731
    run = hf.simulate(CHAIN, STATE, wrapped(law, kept), 0.2, T, sample_time=T, inputs=push, breakpoints=[0.1])
    assert run.stopped is None
    found = [observation(law, memory) for memory in kept]
    assert found[99].object_wrench == pytest.approx(PUSH, abs=0.02 * 20.0)
    assert found[99].touched == {"object": True} and not found[0].touched["object"]
    assert np.abs(found[-1].object_wrench).max() < 0.02 * 20.0 and not found[-1].touched["object"]
    rising = [k for k in range(1, 100) if found[k].touched["object"] and not found[k - 1].touched["object"]]
    sizes = [np.linalg.norm(np.r_[x.object_wrench[:3] / 0.15, x.object_wrench[3:]]) for x in found]
    assert len(rising) == 1 and sizes[rising[0] - 1] <= 10.0 < sizes[rising[0]]
    falling = next(k for k in range(100, 200) if not found[k].touched["object"])
    assert sizes[falling] <= 5.0 < sizes[falling - 1]


def simulated(inputs):
    """Return what is found after 0.1 s with sensors at the wrists."""
    law = observed(
        cooperative_law(CHAIN, HOLD, InternalForce(20.0)), CHAIN, gain=60.0, sample_time=T, measured=True, threshold=4.0
    )
    rollout = hf.compile_rollout(CHAIN, law, parameters=["link_wrench"] if "link_wrench" in inputs else [])
    arrays = [x[None] for x in (STATE.q, STATE.qd, STATE.object_pose, STATE.object_twist)]
    measured = hf.forward_dynamics(CHAIN, STATE, hf.holding_torques(CHAIN, STATE, None, 20.0)).grasp_wrench
    systems = rollout.start(*arrays, measured_wrenches=measured, **inputs)
    for _ in range(100):
        record = rollout.run(systems, T, T, record=["grasp_wrench"], measured_wrenches=measured)
        systems, measured = record.systems, record["grasp_wrench"][-1]
    return observation(law, systems.memory[0])


@pytest.mark.slow
def test_which_arm_is_pushed():
    """With wrist sensors, a push on a link of the right arm is its own: J^T w on its joints; the rest feels nothing."""
    push = np.zeros((N, 6))
    push[7 + 5, 3:] = [0.0, 20.0, 0.0]
    found = simulated({"link_wrench": push})
    truth = hf.inverse_dynamics(CHAIN, STATE, np.zeros(N), np.zeros((2, 6))) - hf.inverse_dynamics(
        CHAIN, STATE, np.zeros(N), np.zeros((2, 6)), hf.Inputs(link_wrenches=push)
    )
    assert np.abs(truth[7:]).max() > 5.0
    assert found.joint_torques == pytest.approx(truth, abs=0.05 * np.abs(truth).max())
    assert found.touched == {"object": False, "left": False, "right": True}
    assert np.abs(found.object_wrench).max() < 0.5


@pytest.mark.slow
def test_the_object_is_pushed():
    """With wrist sensors, a push on the box is on the box alone."""
    found = simulated({"object_wrench": PUSH})
    assert found.object_wrench == pytest.approx(PUSH, abs=0.02 * 20.0)
    assert found.touched == {"object": True, "left": False, "right": False}


@pytest.mark.slow
def test_it_feeds_an_impedance():
    """A chosen inertia without a sensor: under a push the box gives way by w / K, as the observer supplies w."""
    motion = ObjectImpedance(HERE, SPRING, np.repeat([10.0, 100.0], 3), MASS)
    law = observed(cooperative_law(CHAIN, motion), CHAIN, gain=60.0, sample_time=T)
    law = sampled(law, CHAIN, sample_time=T)
    push = np.array([0.0, 0.0, 0.0, 4.0, 0.0, -6.0])
    run = hf.simulate(CHAIN, STATE, law, 2.0, T, inputs=hf.Inputs(object_wrench=push))
    assert run.stopped is None and not law.parameters
    assert run.object_pose[-1, 4:] - STATE.object_pose[4:] == pytest.approx(push[3:] / SPRING[3:], abs=2e-4)


def test_refused():
    """Gains that overshoot, laws that are none, chains that hold nothing."""
    law = cooperative_law(CHAIN, HOLD)
    with pytest.raises(ModelError, match=r"gain \* sample_time < 1, the limit of stability without overshoot, got 1"):
        observed(law, CHAIN, gain=1000.0, sample_time=T)
    with pytest.raises(ModelError, match="observed: expected a ControlLaw or a built-in controller, got function"):
        observed(lambda t, x, m: (x.q, m), CHAIN, gain=10.0, sample_time=T)
    with pytest.raises(ModelError, match="observation: law: expected one that observed"):
        observation(law, np.zeros(0))
    with pytest.raises(MethodNotApplicable, match="got no grasp"):
        observed(law, CHAIN.without_grasp("left").without_grasp("right"), gain=1.0, sample_time=T)
