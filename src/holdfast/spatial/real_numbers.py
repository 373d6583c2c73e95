"""Convert an argument to a float64 array, or raise an error that names it."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import numpy as np

from holdfast.errors import HoldfastError, ModelError
from holdfast.spatial import rotation
from holdfast.spatial.frozen import read_only
from holdfast.spatial.scalar import Array
from holdfast.spatial.traced_array import TracedArray, as_traced

ROTATION_TOLERANCE = 1e-6  # further from orthogonal or unit length is an error; nearer is normalised


def numbers(value: Any, shape: tuple[int, ...] | None, what: str, error: type[HoldfastError] = ModelError) -> Array:
    """Return a read-only copy with finite entries and the given shape (any if None); traced scalars are kept."""
    if type(value) is np.ndarray and value.dtype == float:
        a = np.array(value, order="C")
    else:
        a = real_array(value, what, _numbers_of(shape), error)
        with np.errstate(over="ignore"):  # a long double may be infinite as a float
            a = as_traced_as(value, np.array(a)) if a.dtype == object else a.astype(float, order="C")
    if shape is not None and a.shape != shape:
        raise error(f"{what}: expected shape {shape}, got shape {a.shape}")
    if a.dtype != object and not np.isfinite(a).all():
        raise error(f"{what}: expected finite numbers, got {short(value)}")
    a.flags.writeable = False
    return a


def real_array(value: Any, what: str, expected: str, error: type[HoldfastError]) -> Array:
    """Return an argument of any shape as an array of floats, integers or traced scalars, without a copy where possible.

    Masked entries, truth values, texts, dates and complex numbers are refused; NumPy would convert them silently.

    Args:
        value: the argument.
        what: its name in the message.
        expected: description of what is expected.
        error: type of the error.

    Raises:
        HoldfastError: of the type `error`.
    """
    if is_masked(value):
        raise error(
            f"{what}: expected {expected}, got a masked array; try its method filled, or the rows without masks"
        )
    try:
        a = np.asarray(value)
        if a.dtype.kind == "O":
            a = _of_objects(a)
    except HoldfastError:
        raise
    except Exception as cause:  # an object may convert itself to an array, and fail as it likes
        raise error(f"{what}: expected {expected}, got {short(value)}") from cause
    if a.dtype.kind not in "fiuO":
        kind = f" ({'truth values' if a.dtype == bool else a.dtype})" if isinstance(value, np.ndarray) else ""
        raise error(f"{what}: expected {expected}, got {short(value)}{kind}")
    return a


def rotation_matrix(value: Any, what: str) -> Array:
    """Return a rotation matrix; smaller deviations than 1e-6 are corrected, larger ones are an error."""
    R = numbers(value, (3, 3), what)
    if R.dtype == object:  # traced scalars: their values are not known here
        return R
    with np.errstate(all="ignore"):  # entries like 1e200
        if not rotation.is_rotation(R, ROTATION_TOLERANCE):
            defect, det = float(np.abs(R.T @ R - np.eye(3)).max()), float(np.linalg.det(R))
            raise ModelError(
                f"{what}: expected a rotation matrix (R^T R = 1, det R = +1), got |R^T R - 1| = {defect:.3g},"
                f" det R = {det:.9g}"
            )
    return R if rotation.is_rotation(R, 1e-14) else read_only(rotation.nearest(R))


def pose_numbers(value: Any, what: str) -> Array:
    """Return wxyz_xyz, (7,), with a normalised quaternion; a length off from 1 by more than 1e-6 is an error."""
    a = numbers(value, (7,), f"{what} (wxyz_xyz)")
    if a.dtype == object:
        return a
    length = math.hypot(*a[:4])
    if abs(length - 1) > ROTATION_TOLERANCE:
        raise ModelError(
            f"{what}: expected a unit quaternion (w, x, y, z), got length {length:.9g}; try dividing by it"
        )
    return read_only(np.concatenate([a[:4] / length, a[4:]]))


def short(value: Any) -> str:
    """Return the representation of a value on one line, cut after 60 characters."""
    try:
        text = " ".join(repr(value).split())
    except Exception:
        return f"an object of type {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."


def is_masked(value: Any) -> bool:
    """Return whether a value is a masked array, or a list that holds one at any depth."""
    if isinstance(value, list | tuple):
        return any(is_masked(x) for x in value if not isinstance(x, float))
    return isinstance(value, np.ndarray) and type(value) is not np.ndarray and hasattr(value, "mask")


def as_traced_as(value: Any, a: Array) -> Array:
    """Return an array of traced scalars, a `TracedArray` if it was made of one."""
    return as_traced(a) if isinstance(value, TracedArray) else a


def _of_objects(a: Array) -> Array:
    """Return floats of an array of objects that are numbers; traced and recorded scalars stay."""
    if any(hasattr(x, "where") or hasattr(x, "chosen") for x in a.flat):
        return a
    for x in a.flat:
        if isinstance(x, bool) or not (isinstance(x, Real) or hasattr(x, "as_integer_ratio")):  # a decimal has that
            raise TypeError(f"{type(x).__name__} is no real number")
    return a.astype(float)


def _numbers_of(shape: tuple[int, ...] | None) -> str:
    if shape is None:
        return "an array of numbers"
    return f"numbers of shape {shape}" if shape else "a number"
