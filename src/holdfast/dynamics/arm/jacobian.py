"""The tip Jacobian, V(0) = J qd: J = B^T phi^T H^T (5.1b)."""

from __future__ import annotations

from holdfast.dynamics.arm.posture import Posture
from holdfast.model.arm import Arm
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.vector import cross


def jacobian(arm: Arm, at: Posture) -> Array:
    """Return the Jacobian of the tip point, (6, N), world axes. Cost O(N)."""
    columns = []
    for joint, R, reach in zip(arm.joints, at.R, at.reach, strict=True):
        axis = R @ joint.axis
        if joint.kind == "revolute":
            columns.append(concatenate([axis, cross(axis, reach)]))
        else:
            columns.append(concatenate([0.0 * axis, axis]))
    return array(columns).T
