"""What controllers say that they command is what hands exert where the model is exact and nothing limits them."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import (
    GravityCompensation,
    HybridForce,
    InternalForce,
    InternalImpedance,
    LoadShare,
    ObjectImpedance,
    ObjectTracking,
    RampedForces,
    RestToRest,
    TorqueSchedule,
    cooperative_law,
    observed,
    sampled,
)
from holdfast.control.commanded_forces import commanded_internal_wrenches, commands_forces, limits_kept
from holdfast.forces import ForceLimits
from tests.control.two_pandas import rubber_pandas, two_pandas

CHAIN, STATE = two_pandas()
PATH = RestToRest(STATE.object_frame, displacement=[0.05, 0.1, 0.1])
MOTION = ObjectImpedance(PATH, 100.0, 20.0)
RAMP = RampedForces(InternalForce(10.0), LoadShare({"left": 0.8, "right": 0.2}, 40.0), 0.0, 0.2)
INTEGRAL = HybridForce(50.0, 0.01, RAMP, sensor=CHAIN)
CONTROLLERS = {
    "gravity": GravityCompensation(CHAIN, 20.0),
    "tracking": ObjectTracking(CHAIN, PATH, 25.0),
    "schedule": TorqueSchedule([0.0], [np.zeros((14, 1))], ObjectTracking(CHAIN, PATH, 30.0)),
    "ramp": cooperative_law(CHAIN, MOTION, RAMP),
    "springs": cooperative_law(CHAIN, MOTION, InternalImpedance(500.0, 10.0, RAMP)),
    "integral": cooperative_law(CHAIN, MOTION, INTEGRAL),
    "observed": observed(cooperative_law(CHAIN, MOTION, RAMP), CHAIN, gain=50.0, sample_time=0.01),
    "sampled": sampled(ObjectTracking(CHAIN, PATH, 15.0), CHAIN, sample_time=0.01, resolution={"tau": 1e-9}),
}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_commanded_is_exerted(name):
    """Through every wrapper, in motion where the law knows of it: the internal part of forward dynamics' wrenches."""
    controller, t, memory = CONTROLLERS[name], 0.15, None
    at = PATH.at(t)
    twist = np.zeros(6) if name == "gravity" else at.twist
    state = hf.close(CHAIN, replace(STATE, object_pose=at.pose, object_twist=twist), hold_object=True)
    for _ in range(2 if name == "integral" else 1):  # the first sample has nothing measured
        tau, memory = controller(t, state, memory)
    exerted = hf.forces.split(CHAIN, state, hf.forward_dynamics(CHAIN, state, tau).grasp_wrench).internal
    found = commanded_internal_wrenches(controller, t, state)
    assert np.linalg.norm(found[:, 3:]) > 10.0
    assert np.abs(found - exerted).max() < 1e-6


def test_who_commands_nothing():
    """A user's function, or torques alone; an integral commands what it is put around, whatever is measured."""
    for controller in (lambda t, state, memory: (np.zeros(14), memory), TorqueSchedule([0.0], [np.zeros((14, 1))])):
        assert not commands_forces(controller)
    off = hf.forward_dynamics(CHAIN, STATE, hf.holding_torques(CHAIN, STATE, internal_force=70.0)).grasp_wrench
    law = cooperative_law(CHAIN, MOTION, replace(INTEGRAL, sensor=None))
    given = law.given({"measured_wrenches": off})
    assert (commanded_internal_wrenches(given, 0.0, STATE) == commanded_internal_wrenches(law, 0.0, STATE)).all()
    assert np.linalg.norm(commanded_internal_wrenches(given, 0.0, STATE)[0]) == pytest.approx(10.0)


def test_limits_kept():
    """Of a law within limits, also if it is sampled; none of others."""
    chain, state = rubber_pandas(0.8)
    limits = ForceLimits(effort=0.8, least_margin=2.0)
    law = cooperative_law(chain, ObjectImpedance(RestToRest(state.object_frame), 100.0, 20.0), limits=limits)
    assert limits_kept(law) is limits
    track = ObjectTracking(chain, RestToRest(state.object_frame), limits=limits)
    assert limits_kept(track) is limits and limits_kept(replace(track, limits=None)) is None
    assert limits_kept(sampled(law, chain, sample_time=0.01)) is limits
    assert limits_kept(CONTROLLERS["ramp"]) is limits_kept(lambda t, state, memory: None) is None
