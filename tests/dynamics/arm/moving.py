"""An arm a moment later, on dual numbers: exact time derivatives of whatever is computed from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast import Pose
from holdfast.dynamics.arm.motion import ArmInputs
from holdfast.spatial.vector import skew
from tests.spatial.dual import duals


def moving(given: ArmInputs, qdd: np.ndarray, gravity=(0.0, 0.0, 0.0)) -> ArmInputs:
    """Return the arm's inputs as x + x' e at joint accelerations qdd, base motion included.

    Args:
        given: the arm; its base acceleration is less [0; g].
        qdd: (N,) joint accelerations.
        gravity: (3,) g, to find the base's true acceleration.
    """
    base, twist = given.arm.base, given.base_twist
    pose = Pose(duals(base.R, skew(twist[:3]) @ base.R), duals(base.p, twist[3:]))
    acceleration = given.base_acceleration + np.r_[np.zeros(3), gravity]
    return replace(
        given,
        arm=given.arm.at(pose),
        q=duals(given.q, given.qd),
        qd=duals(given.qd, qdd),
        base_twist=duals(twist, acceleration),
    )


def displaced(given: ArmInputs, dq: np.ndarray) -> ArmInputs:
    """Return the arm's inputs at q + dq e, everything else as it is."""
    return replace(given, q=duals(given.q, dq))
