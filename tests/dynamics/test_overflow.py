"""Velocities and places beyond float64's range: numbers or a sentence, and no warning (pytest makes errors of them)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast import control, dynamics
from tests.control.two_pandas import two_pandas

CHAIN, STATE = two_pandas()
ZERO = np.zeros(14)
PATH = control.RestToRest(STATE.object_pose, [0.1, 0.0, 0.0])
FOUND = hf.forward_dynamics(CHAIN, STATE, ZERO)
FAST = hf.State(STATE.q, np.full(14, 1e200), STATE.object_pose, np.full(6, 1e200))
FAR = hf.State(STATE.q, STATE.qd, [1, 0, 0, 0, 1e308, 1e308, 1e308], FAST.object_twist)

REFUSED: dict[str, Callable[[], Any]] = {
    "kinetic energy": lambda: dynamics.kinetic_energy(CHAIN, FAST),
    "potential energy": lambda: dynamics.potential_energy(CHAIN, FAR),
    "centre of mass": lambda: dynamics.centre_of_mass(CHAIN, FAR),
    "momentum": lambda: dynamics.momentum(CHAIN, FAR),
    "power": lambda: dynamics.power(CHAIN, FAST, np.full(14, 1e200), FOUND),
    "inverse dynamics": lambda: hf.inverse_dynamics(CHAIN, FAST, ZERO, FOUND.grasp_wrench),
    "split": lambda: hf.forces.split(CHAIN, STATE, np.full((2, 6), 1e308)),
    "last joint wrenches": lambda: hf.forces.last_joint_wrenches(CHAIN, FAST, FOUND),
    "holding torques": lambda: hf.holding_torques(CHAIN, FAST),
    "object tracking": lambda: control.ObjectTracking(CHAIN, PATH)(0.5, FAST, None),
    "gravity compensation": lambda: control.GravityCompensation(CHAIN, 10.0, 1e308)(0.0, FAST, None),
    "torque schedule": lambda: control.TorqueSchedule([0.0], [np.full((14, 2), 1e300)])(1e300, STATE, None),
    "the accelerations": lambda: hf.forward_dynamics(CHAIN, FAST, ZERO, check=False),
}


@pytest.mark.parametrize("what", REFUSED)
def test_an_overflow_is_refused_by_name(what):
    with pytest.raises(hf.errors.StateError, match=f"{what}.*overflow"):
        REFUSED[what]()


def test_what_fits_is_answered_without_a_warning():
    assert np.isfinite(dynamics.momentum(CHAIN, FAST)).all()
    assert np.isfinite(dynamics.momentum_rate(CHAIN, FAST, FOUND)).all()
    assert np.isfinite(dynamics.project_velocity(CHAIN, FAST).qd).all()
    assert hf.project(CHAIN, FAST)[0].q.tobytes() == STATE.q.tobytes()
