"""The joint map H(k) with H^T = [h; s], the motion subspace of a joint with one degree of freedom.

The angular part h or the linear part s is None where it is zero: revolute [h; 0], prismatic [0; s], screw [h; s].
"""

from __future__ import annotations

import numpy as np

from holdfast.model.joint import Joint
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.symmetric import Symmetric6


def project(joint: Joint, f: Array) -> Scalar:
    """Return H f, the component along the joint of a wrench in link axes [N m or N]."""
    h, s = joint.motion_subspace
    if h is None:
        return s @ f[3:]
    return h @ f[:3] if s is None else h @ f[:3] + s @ f[3:]


def expand(joint: Joint, rate: Scalar) -> Array:
    """Return H^T rate, the twist (or acceleration) in link axes due to a joint rate."""
    return concatenate([np.zeros(3) if part is None else rate * part for part in joint.motion_subspace])


def column(joint: Joint, P: Symmetric6) -> Array:
    """Return P H^T, a 6-vector."""
    h, s = joint.motion_subspace
    if h is None:
        return concatenate([P.al @ s, P.ll @ s])
    turning = concatenate([P.aa @ h, h @ P.al])
    return turning if s is None else turning + concatenate([P.al @ s, P.ll @ s])
