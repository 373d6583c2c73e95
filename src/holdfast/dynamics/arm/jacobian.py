"""The tip Jacobian, V(0) = J qd: J = B^T phi^T H^T (5.1b)."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics
from holdfast.model.arm import Arm
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.vector import cross


def jacobian(arm: Arm, at: Kinematics) -> Array:
    """Return the Jacobian of the tip point, (6, N), world axes. O(N)."""
    columns = []
    for joint, R, reach in zip(arm.joints, at.R, at.reach, strict=True):
        h, s = joint.motion_subspace
        along = None if s is None else R @ s
        if h is None:
            columns.append(concatenate([np.zeros(3), along]))
        else:
            axis = R @ h
            columns.append(concatenate([axis, cross(axis, reach) if along is None else cross(axis, reach) + along]))
    return array(columns).reshape(-1, 6).T
