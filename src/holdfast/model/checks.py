"""Checks that turn what a caller gave into read-only arrays, or refuse it by name."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from holdfast.errors import HoldfastError, ModelError
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

ROTATION_TOLERANCE = 1e-6  # further from orthogonal or unit length is an error; nearer is normalised
ROUNDED = 1e-15  # so near to unit length is what was normalised before
INERTIA_TOLERANCE = 1e-6  # relative violation of the triangle inequality that is still rounding


def numbers(value: Any, shape: tuple[int, ...] | None, what: str, error: type[HoldfastError] = ModelError) -> Array:
    """Return a read-only finite array of the shape (None: of any), floats unless it holds traced scalars."""
    try:
        a = np.array(value)
        if a.dtype.kind in "cSUmM":  # complex numbers, texts and dates would be converted silently
            raise TypeError(f"{a.dtype} is no real number")
        if a.dtype != object or not any(hasattr(x, "where") for x in a.flat):
            a = a.astype(float)
    except (TypeError, ValueError, OverflowError) as cause:
        raise error(f"{what}: expected {_numbers_of(shape)}, got {_short(value)}") from cause
    if shape is not None and a.shape != shape:
        raise error(f"{what}: expected shape {shape}, got shape {a.shape}")
    if a.dtype != object and not np.isfinite(a).all():
        raise error(f"{what}: expected finite numbers, got {_short(value)}")
    a.flags.writeable = False
    return a


def vector(value: Any, what: str, error: type[HoldfastError] = ModelError) -> Array:
    """Return a read-only finite array of one axis, as `numbers` does."""
    a = numbers(value, None, what, error)
    if a.ndim != 1:
        raise error(f"{what}: expected shape ({a.size},), got shape {a.shape}")
    return a


def _numbers_of(shape: tuple[int, ...] | None) -> str:
    if shape is None:
        return "an array of numbers"
    return f"numbers of shape {shape}" if shape else "a number"


def number(value: Any, what: str, *, at_least: float | None = None, above: float | None = None) -> Any:
    """Return a finite number within the bounds."""
    x = numbers(value, (), what)[()]
    if not isinstance(x, float):
        return x  # a traced scalar: its value is not known here
    if at_least is not None and x < at_least:
        raise ModelError(f"{what}: expected >= {at_least:g}, got {float(x)!r}")
    if above is not None and x <= above:
        raise ModelError(f"{what}: expected > {above:g}, got {float(x)!r}")
    return float(x)


def unit_vector(value: Any, what: str) -> Array:
    """Return a unit 3-vector; one that is off by more than 1e-6 is refused."""
    a = numbers(value, (3,), what)
    length = math.hypot(*a)
    if abs(length - 1) > ROTATION_TOLERANCE:
        raise ModelError(f"{what}: expected a unit vector, got length {length:.9g}; try dividing by it")
    return a if abs(length - 1) <= ROUNDED else read_only(a / length)


def pose(value: Any, what: str) -> Pose:
    """Return a pose from a Pose, or from unit quaternion + position (7,)."""
    if not isinstance(value, Pose):
        a = numbers(value, (7,), f"{what} (wxyz_xyz)")
        length = math.hypot(*a[:4])
        if abs(length - 1) > ROTATION_TOLERANCE:
            raise ModelError(
                f"{what}: expected a unit quaternion (w, x, y, z), got length {length:.9g}; try dividing by it"
            )
        made = Pose.from_wxyz_xyz(np.concatenate([a[:4] / length, a[4:]]))
        return Pose(read_only(made.R), read_only(made.p))
    R = numbers(value.R, (3, 3), f"{what}: rotation")
    p = numbers(value.p, (3,), f"{what}: position")
    if R.dtype == object:
        return value
    return Pose(rotation_matrix(R, f"{what}: rotation"), p)


def rotation_matrix(value: Any, what: str) -> Array:
    """Return a rotation matrix; one that is off by more than 1e-6 is refused, less is mended."""
    R = numbers(value, (3, 3), what)
    with np.errstate(all="ignore"):  # entries like 1e200
        if not rotation.is_rotation(R, ROTATION_TOLERANCE):
            defect, det = float(np.abs(R.T @ R - np.eye(3)).max()), float(np.linalg.det(R))
            raise ModelError(
                f"{what}: expected a rotation matrix (R^T R = 1, det R = +1), got |R^T R - 1| = {defect:.3g},"
                f" det R = {det:.9g}"
            )
    return R if rotation.is_rotation(R, 1e-14) else read_only(rotation.nearest(R))


def rotational_inertia(value: Any, what: str, *, definite: bool = False, physical: bool = True) -> Array:
    """Return a physically possible inertia about the mass centre, (3, 3) symmetric [kg m^2].

    The principal moments of any mass distribution satisfy A + B >= C and are >= 0;
    `physical=False` asks only that they are >= 0.
    """
    J = symmetric_matrix(value, what)
    if J.dtype == object:
        return J
    a, b, c = np.linalg.eigvalsh(J).tolist()
    if a < -INERTIA_TOLERANCE * max(c, 0.0) or c < 0:
        raise ModelError(f"{what}: expected principal moments >= 0, got {a:.6g}, {b:.6g}, {c:.6g}")
    if definite and a <= 1e-14 * c:
        raise ModelError(f"{what}: expected principal moments > 0, got {a:.6g}, {b:.6g}, {c:.6g}")
    if physical and a + b < c * (1 - INERTIA_TOLERANCE):
        raise ModelError(
            f"{what}: no mass distribution has principal moments {a:.6g}, {b:.6g}, {c:.6g} (the two smaller must"
            f" sum to at least the largest); try physical=False (Link, HeldObject) to accept it as it is"
        )
    return J


def symmetric_matrix(value: Any, what: str) -> Array:
    """Return a symmetric (3, 3) matrix; asymmetry above 1e-9 of its size is refused."""
    J = numbers(value, (3, 3), what)
    if J.dtype == object:
        return J
    with np.errstate(over="ignore"):
        asymmetry = float(np.abs(J - J.T).max())
    if asymmetry > 1e-9 * float(np.abs(J).max()):
        raise ModelError(f"{what}: expected a symmetric matrix, got asymmetry {asymmetry:.3g}")
    return read_only(0.5 * J + 0.5 * J.T)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ' Did you mean ...?' or a list of what is known."""
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f" Did you mean '{near[0]}'?" if near else f" Known: {', '.join(known) or 'none'}."


def read_only(a: Array) -> Array:
    """Return the array itself, no longer writeable."""
    a.flags.writeable = False
    return a


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
