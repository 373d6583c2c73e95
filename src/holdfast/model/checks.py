"""Checks of arguments, which return read-only arrays or raise an error that names the argument."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from holdfast.errors import HoldfastError, ModelError, StateError
from holdfast.names import did_you_mean as did_you_mean
from holdfast.spatial.frozen import read_only as read_only
from holdfast.spatial.pose import Pose
from holdfast.spatial.real_numbers import ROTATION_TOLERANCE as ROTATION_TOLERANCE
from holdfast.spatial.real_numbers import is_masked as is_masked
from holdfast.spatial.real_numbers import numbers as numbers
from holdfast.spatial.real_numbers import pose_numbers as pose_numbers
from holdfast.spatial.real_numbers import real_array as real_array
from holdfast.spatial.real_numbers import rotation_matrix as rotation_matrix
from holdfast.spatial.real_numbers import short as short
from holdfast.spatial.scalar import Array

ROUNDED = 1e-15  # vectors this close to unit length have been normalised before
INERTIA_TOLERANCE = 1e-6  # relative violation of the triangle inequality that counts as rounding


def vector(value: Any, what: str, error: type[HoldfastError] = ModelError) -> Array:
    """Return a one-dimensional read-only array of finite numbers; see `numbers`."""
    a = numbers(value, None, what, error)
    if a.ndim != 1:
        raise error(f"{what}: expected shape ({a.size},), got shape {a.shape}")
    return a


def finite(found: Array, what: str) -> Array:
    """Return the result of an algorithm after checking that it is finite; traced numbers are not checked.

    Raises:
        StateError: some numbers have overflowed float64.
    """
    if np.asarray(found).dtype != object and not np.isfinite(found).all():
        raise StateError(
            f"{what}: expected finite numbers, got an overflow of float64; check the sizes of lengths, masses,"
            " velocities and forces"
        )
    return found


def number(value: Any, what: str, *, at_least: float | None = None, above: float | None = None) -> Any:
    """Return a finite number within the bounds."""
    x = numbers(value, (), what)[()]
    if not isinstance(x, float):
        return x  # the value of a traced scalar is not known
    if at_least is not None and x < at_least:
        raise ModelError(f"{what}: expected >= {at_least:g}, got {float(x)!r}")
    if above is not None and x <= above:
        raise ModelError(f"{what}: expected > {above:g}, got {float(x)!r}")
    return float(x)


def unit_vector(value: Any, what: str) -> Array:
    """Return a unit 3-vector; a length that differs from 1 by more than 1e-6 is refused."""
    a = numbers(value, (3,), what)
    length = math.hypot(*a)
    if abs(length - 1) > ROTATION_TOLERANCE:
        raise ModelError(f"{what}: expected a unit vector, got length {length:.9g}; try dividing by it")
    return a if abs(length - 1) <= ROUNDED else read_only(a / length)


def pose(value: Any, what: str) -> Pose:
    """Return a pose from a Pose, or from unit quaternion + position (7,)."""
    if isinstance(value, Pose):
        R = rotation_matrix(value.R, f"{what}: rotation")
        return Pose.unchecked(R, numbers(value.p, (3,), f"{what}: position"))
    return Pose.unchecked_seven(pose_numbers(value, what))


def rotational_inertia(value: Any, what: str, *, definite: bool = False, physical: bool = True) -> Array:
    """Return a physically possible inertia about the mass centre, (3, 3) symmetric [kg m^2].

    The principal moments of any mass distribution are >= 0 and satisfy A + B >= C. With `physical=False` only the first
    condition is checked.
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
    """Return a symmetric (3, 3) matrix; an asymmetry of more than 1e-9 of its size is refused."""
    J = numbers(value, (3, 3), what)
    if J.dtype == object:
        return J
    with np.errstate(over="ignore"):
        asymmetry = float(np.abs(J - J.T).max())
    if asymmetry > 1e-9 * float(np.abs(J).max()):
        raise ModelError(f"{what}: expected a symmetric matrix, got asymmetry {asymmetry:.3g}")
    return read_only(0.5 * J + 0.5 * J.T)


def instance(
    value: Any, kind: type | tuple[type, ...], what: str, error: type[HoldfastError] = ModelError, advice: str = ""
) -> None:
    """Check the type of a value; the error ends with the advice."""
    if not isinstance(value, kind):
        kinds = kind if isinstance(kind, tuple) else (kind,)
        expected = " or ".join("None" if k is type(None) else k.__name__ for k in kinds)
        raise error(f"{what}: expected {expected}, got {type(value).__name__}{'; ' * bool(advice)}{advice}")


def name(value: Any, what: str) -> None:
    """Check that a value is a text that files can hold: one without lone surrogates."""
    instance(value, str, what)
    if not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
        raise ModelError(
            f"{what}: expected a text that UTF-8 can encode, got {ascii(value)[:60]}, a lone surrogate in it"
        )


def flag(value: Any, what: str, error: type[HoldfastError] = ModelError) -> bool:
    """Return a truth value; numbers, texts and arrays are none."""
    if not isinstance(value, bool | np.bool_):
        raise error(f"{what}: expected True or False, got {short(value)}")
    return bool(value)


def is_listed(value: Any) -> bool:
    """Return whether something has items one after another: a text has not, nor has an array without axes."""
    return isinstance(value, Iterable) and not isinstance(value, str | bytes) and getattr(value, "ndim", 1) > 0


def limit(value: Any, what: str) -> float:
    """Return a limit, which must be > 0 and may be infinite."""
    infinite = isinstance(value, float | np.floating) and value == math.inf
    return math.inf if infinite else number(value, what, above=0.0)


def shapes_with_rows(shape: tuple[int, ...], rows: int | str) -> str:
    """Return a shape, and the same with an axis of rows before, as text: `(3,) or (batch, 3)`."""
    lead = [str(rows), *map(str, shape)]
    return f"{shape} or ({lead[0]},)" if not shape else f"{shape} or ({', '.join(lead)})"


def place(p: Any) -> str:
    """Return a position, force or moment as text with four digits; rounding errors are shown as 0."""
    x = np.asarray(p)
    if x.dtype == object:
        return "(...)"
    noise = 1e-9 * max(1.0, float(np.abs(x).max()))  # m, N or N m
    return f"({', '.join(f'{one:.4g}' for one in np.where(np.abs(x) < noise, 0.0, x).tolist())})"
