"""Find invalid inputs: numbers that are not finite, too large angles, and quaternions that are not of unit length."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from holdfast.compiler.elementary import LARGEST_ARGUMENT
from holdfast.errors import StateError
from holdfast.model.checks import ROTATION_TOLERANCE
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import POSES
from holdfast.spatial.scalar import Array

_LARGEST = float(np.finfo(np.float64).max)


def largest_number(name: str) -> float:
    """Return a bound of the numbers of an input; of positions of joints, `largest_positions` are exact ones."""
    return LARGEST_ARGUMENT if name == "q" else _LARGEST


def largest_positions(chain: ClosedChain) -> Array:
    """Return the largest valid |q| of each joint, (n,): 1e5 rad for revolute joints, no bound for prismatic ones."""
    return np.array([LARGEST_ARGUMENT if joint.turns else _LARGEST for joint in chain.all_joints])


def invalid_mask(found: Mapping[str, Array], ranks: Mapping[str, int], largest: Array, batch: int) -> Array | None:
    """Return which systems of a batch have an invalid input, (batch,), or None if there are none.

    Args:
        found: the inputs by name.
        ranks: the number of axes of each input for one system; an input with one more axis has a batch axis.
        largest: (n,) the largest valid |q|.
        batch: the number of systems.
    """
    unsure = {name: x for name, x in found.items() if not _surely_sound(name, x)}
    if not unsure:
        return None
    bad = np.zeros(batch, dtype=bool)
    for name, x in unsure.items():
        wrong = ~_sound(name, x, largest)
        bad |= wrong.reshape(batch, -1).any(1) if x.ndim > ranks[name] else wrong.any()
    return bad


def input_error(found: Mapping[str, Array], largest: Array) -> StateError | None:
    """Return the error for the first invalid input of one system, or None if all are valid."""
    for name, x in found.items():
        if _surely_sound(name, x) or _sound(name, x, largest).all():
            continue
        if not np.isfinite(x).all():
            return StateError(f"{name.rpartition('.')[2]}: expected finite numbers, got {x[~np.isfinite(x)][0]}")
        if name in POSES:
            length = math.hypot(*x[:4])
            return StateError(f"{name}: expected a unit quaternion (w, x, y, z) first, got length {length:.9g}")
        worst = float(np.abs(x[~_sound(name, x, largest)]).max())
        return StateError(f"{name}: expected at most {LARGEST_ARGUMENT:g} rad, got {worst:.6g}")
    return None


def _surely_sound(name: str, x: Array) -> bool:
    """Return whether a fast sufficient test shows that all numbers are valid."""
    if not x.size:
        return True
    most = largest_number(name)
    within = bool(-most <= x.min() and x.max() <= most)  # false if x contains NaN
    return within and (name not in POSES or bool(_of_unit_length(x).all()))


def _sound(name: str, x: Array, largest: Array) -> Array:
    """Return which numbers are valid; no number of a pose is if its quaternion is not of unit length."""
    if name == "q":
        return np.abs(x) <= largest
    if name in POSES:
        return np.isfinite(x) & _of_unit_length(x)[..., None]
    return np.isfinite(x)


def _of_unit_length(pose: Array) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.sqrt(np.einsum("...i,...i", pose[..., :4], pose[..., :4]))
        return np.abs(length - 1.0) <= ROTATION_TOLERANCE
