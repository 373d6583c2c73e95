"""Motion and internal parts of the grasp forces, and who carries how much (beyond.md 6)."""

from __future__ import annotations

import numpy as np

from holdfast.spatial.scalar import Array

SMALLEST_LENGTH = 1e-3  # m


def length_scale(offsets: list[Array]) -> float:
    """Return L: rms distance of the contact points from their centroid [m].

    One contact, or contacts in one point, have no such distance: 1 m is taken.
    """
    if len(offsets) < 2:
        return 1.0
    points = np.array(offsets)
    L = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return L if L > SMALLEST_LENGTH else 1.0
