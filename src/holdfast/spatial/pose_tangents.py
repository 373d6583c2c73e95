"""Tangents of poses, with R -> exp(turn) R and p -> p + shift, and gradients with respect to them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.vector import axial, skew


def rates_of(tangents: Mapping[str, Array], what: str, R: Array, named: str = "") -> dict[str, Array]:
    """Return the rates of the matrix and the origin of a pose for its tangent [turn; shift]; empty without a tangent.

    Args:
        tangents: tangents by argument.
        what: name of the pose, without "_pose".
        R: its matrix.
        named: name of matrix and origin in the result, without "_R" and "_p"; by default `what`.
    """
    if f"{what}_pose" not in tangents:
        return {}
    motion, name = tangents[f"{what}_pose"], named or what
    return {f"{name}_R": skew(motion[:3]) @ R, f"{name}_p": motion[3:]}


def by_motion(of_R: Array, R: Array, of_p: Array) -> Array:
    """Return the gradient (6,) with respect to [turn; shift] of a pose from those by its matrix and its origin."""
    return concatenate([axial(of_R @ R.T), of_p])


def by_motions(of_R: Array, R: Array, of_p: Array) -> Array:
    """Return the gradients (..., 6) with respect to one pose, or to several with a leading axis; see `by_motion`."""
    each = zip(of_R.reshape(-1, 3, 3), R.reshape(-1, 3, 3), of_p.reshape(-1, 3), strict=True)
    return np.array([by_motion(*one) for one in each]).reshape(*of_p.shape[:-1], 6)
