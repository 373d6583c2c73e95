"""Coulomb friction of the joints, smoothed about standstill."""

from __future__ import annotations

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, array, sqrt

# Rate at which friction has reached 71 % of its size. A sign function has no slope that a
# fixed step could follow, and none of its solutions sticks exactly either way.
SMOOTHING_RATE = 0.05  # rad/s or m/s


def joint_friction(chain: ClosedChain) -> Array:
    """Return the joints' Coulomb friction F_c, (n,) [N m or N]."""
    return np.array([joint.friction for arm in chain.arms.values() for joint in arm.joints])


def friction_torque(size: Array, qd: Array) -> Array:
    """Return what friction takes from the drives' torques, F_c qd / sqrt(qd^2 + 0.05^2), (n,) [N m or N]."""
    return array([F * v / sqrt(v * v + SMOOTHING_RATE**2) for F, v in zip(size, qd, strict=True)])


def friction_slope(size: Array, qd: Array) -> Array:
    """Return d(friction torque)/d(qd), (n,) [N m s/rad or N s/m]; at standstill F_c / 0.05."""
    return size * SMOOTHING_RATE**2 / (qd**2 + SMOOTHING_RATE**2) ** 1.5
