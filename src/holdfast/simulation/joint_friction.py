"""Dry friction of joints, smoothed near standstill."""

from __future__ import annotations

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, array, sqrt

# Rate at which friction reaches 71 % of its full size. The sign function is discontinuous, so no fixed step could
# follow it, and with either function a joint does not stick exactly.
SMOOTHING_RATE = 0.05  # rad/s or m/s


def joint_friction(chain: ClosedChain) -> Array:
    """Return the joints' Coulomb friction F_c, (n,) [N m or N]; a spherical joint has none."""
    return np.array([joint.friction for joint in chain.freedoms])


def friction_torque(size: Array, qd: Array) -> Array:
    """Return the friction torques, F_c qd / sqrt(qd^2 + 0.05^2), which oppose the drives, (n,) [N m or N]."""
    return array([F * v / sqrt(v * v + SMOOTHING_RATE**2) for F, v in zip(size, qd, strict=True)])


def friction_slope(size: Array, qd: Array) -> Array:
    """Return d(friction torque)/d(qd), (n,) [N m s/rad or N s/m]; at standstill F_c / 0.05."""
    squares = [v * v + SMOOTHING_RATE**2 for v in qd]
    return array([F * SMOOTHING_RATE**2 / (x * sqrt(x)) for F, x in zip(size, squares, strict=True)])
