"""Coulomb friction of the joints, smoothed about standstill."""

from __future__ import annotations

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

# Rate at which friction has reached 76 % of its size. A sign function has no slope that a
# fixed step could follow, and none of its solutions sticks exactly either way.
SMOOTHING_RATE = 0.05  # rad/s or m/s


def friction_torque(chain: ClosedChain, qd: Array) -> Array:
    """Return what friction takes from the drives' torques, F_c tanh(qd / 0.05), (n,) [N m or N]."""
    size = np.array([joint.friction for arm in chain.arms.values() for joint in arm.joints])
    return size * np.tanh(qd / SMOOTHING_RATE)
