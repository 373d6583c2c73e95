"""What the tables of a scene have in common, and the pose, which many of them hold. SI units, world axes, +z up."""

from __future__ import annotations

import msgspec

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Twist = tuple[float, float, float, float, float, float]
NumberRows = float | list[float | list[float]]  # one for all, a list, or a matrix
ZEROS: Triple = (0.0, 0.0, 0.0)


class KeyTable(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Base of all tables; unknown keys are errors."""


class PoseTable(KeyTable):
    """A pose: a position, and an attitude as a quaternion (w, x, y, z) or as roll, pitch, yaw."""

    position: Triple = ZEROS
    quaternion: Quaternion | None = None
    rpy: Triple | None = None


class SwayTable(KeyTable):
    """Three sine oscillations: a sin(2 pi f t + phase) along or about each world axis."""

    amplitude: Triple
    frequency: Triple
    phase: Triple = ZEROS


class BaseMotionTable(KeyTable):
    """A base that oscillates about its pose; the amplitude grows smoothly from zero within `smooth_start` seconds.

    `shift` is in m; `turn` is in rad: roll, pitch, yaw about the base's origin.
    """

    shift: SwayTable | None = None
    turn: SwayTable | None = None
    smooth_start: float = 0.5
