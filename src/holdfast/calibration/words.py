"""What postures do not determine, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.calibration.layout import Unknown
from holdfast.identification.base_parameters import ALONE, pivot_directions
from holdfast.spatial.scalar import Array

MOST_NAMED = 4  # parts of a direction that a sentence names


def not_determined(null: Array, sizes: Array, unknowns: Sequence[Unknown], known: Array) -> tuple[str, ...]:
    """Return a sentence for each direction that the postures do not determine.

    Args:
        null: (p, d) an orthonormal basis of these directions, in sizes.
        sizes: (p,) sizes of the unknowns.
        unknowns: the unknowns.
        known: (p,) whether each has a prior.
    """
    alone, together = [], []
    for k, direction in pivot_directions(null):
        whose = "the prior's value" if known[k] else "the model's value"
        order = np.argsort(-np.abs(direction)).tolist()
        others = [j for j in order if j != k and abs(direction[j]) > ALONE]
        if not others:
            alone.append(f"{unknowns[k].words} is not determined by these postures and keeps {whose}")
            continue
        shares = direction * sizes / sizes[k]
        said = [f"{shares[j]:+.2g} {unknowns[j].name}" for j in others[:MOST_NAMED]]
        more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
        together.append(
            f"{unknowns[k].words} is not determined by these postures: it may change together with {', '.join(said)}"
            f"{more}, and keeps {whose}"
        )
    return (*alone, *together)
