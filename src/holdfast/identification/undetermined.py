"""Describing the unknowns that a motion does not identify."""

from __future__ import annotations

import numpy as np

from holdfast.identification.base_parameters import pivoted
from holdfast.identification.unknowns import Unknowns
from holdfast.spatial.scalar import Array

WHOLLY, PARTLY = 0.99, 0.01  # squared share of an unknown in the fixed combinations above which it is so the model's
ALONE = 0.05  # terms smaller than this, relative to a combination's largest one, are not named


def parts_kept(fixed: Array) -> tuple[Array, Array]:
    """Return which unknowns keep the model's value entirely, and which partly, (p,) each."""
    part = (fixed**2).sum(axis=1)
    return part > WHOLLY, (part > PARTLY) & (part <= WHOLLY)


def sentences(fixed: Array, unknowns: Unknowns) -> tuple[str, ...]:
    """Return a sentence for each combination that cannot be identified.

    Args:
        fixed: (p, d) an orthonormal basis of these combinations, with unknowns scaled by their sizes.
        unknowns: the unknowns.
    """
    d = fixed.shape[1]
    if not d:
        return ()
    pivots = np.sort(pivoted(fixed.T)[1][:d])
    directions = fixed @ np.linalg.inv(fixed[pivots])
    alone, together = [], []
    for k, direction in zip(pivots.tolist(), directions.T, strict=True):
        others = [j for j in np.flatnonzero(np.abs(direction) > ALONE).tolist() if j != k]
        if not others:
            alone.append(unknowns.names[k])
            continue
        steps = direction * unknowns.sizes / unknowns.sizes[k]
        with_it = ", ".join(f"{steps[j]:+.3g} {unknowns.units[j]} of {unknowns.names[j]}" for j in others)
        together.append(
            f"+1 {unknowns.units[k]} of {unknowns.names[k]} together with {with_it} cannot be told from noise"
        )
    lead = (f"cannot be told from noise: {', '.join(alone)}",) if alone else ()
    return (*lead, *together)
