"""The joint map H(k): H^T = [h; 0] for a revolute joint, [0; h] for a prismatic one."""

from __future__ import annotations

import numpy as np

from holdfast.model.joint import Joint
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.symmetric import Symmetric6


def project(joint: Joint, f: Array) -> Scalar:
    """Return H f: the part of a link-axes wrench that the joint's drive carries [N m or N]."""
    return joint.axis @ (f[:3] if joint.kind == "revolute" else f[3:])


def expand(joint: Joint, rate: Scalar) -> Array:
    """Return H^T rate: the link-axes twist (or acceleration) of a joint rate."""
    turning = rate * joint.axis
    parts = [turning, np.zeros(3)] if joint.kind == "revolute" else [np.zeros(3), turning]
    return concatenate(parts)


def column(joint: Joint, P: Symmetric6) -> Array:
    """Return P H^T, a 6-vector."""
    h = joint.axis
    if joint.kind == "revolute":
        return concatenate([P.aa @ h, h @ P.al])
    return concatenate([P.al @ h, P.ll @ h])
