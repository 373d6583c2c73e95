"""Describing the unknowns that a motion does not identify."""

from __future__ import annotations

import numpy as np

from holdfast.identification.base_parameters import pivoted
from holdfast.identification.unknowns import Unknowns
from holdfast.spatial.scalar import Array

WHOLLY, PARTLY = 0.99, 1e-8  # squared share of an unknown in the fixed combinations above which it is so from the guess
ALONE = 0.05  # terms smaller than this, relative to a combination's largest one, are not named


def parts_kept(fixed: Array) -> tuple[Array, Array]:
    """Return which unknowns keep the guess's value entirely, and which partly, (p,) each."""
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
        weights = direction * unknowns.sizes[k] / unknowns.sizes
        with_it = "".join(
            f" {'-' if weights[j] < 0 else '+'} {abs(weights[j]):.3g} {unknowns.names[j]}" for j in others
        )
        together.append(f"the combination {unknowns.names[k]}{with_it} is not identifiable")
    lead = (f"cannot be told from noise: {', '.join(alone)}",) if alone else ()
    return (*lead, *together)
