"""The tangent of the state manifold at a state, from the constraint's own derivatives."""

from __future__ import annotations

import numpy as np
from scipy.linalg import null_space

from tests.oracles.arithmetic import arithmetic
from tests.oracles.chain_derivatives import Seeded, numbers_of
from tests.oracles.held_equations import relative_twists
from tests.spatial.dual import tangents_of
from tests.systems.as_chain import Problem


def closed_rows(p: Problem) -> np.ndarray:
    """Return the rows of rigid grasps that a change (dq, turn, shift, dqd, d omega, dv) makes zero, (12 g, 2n + 12).

    Relative displacements are the relative twists with displacements for rates; relative twists stay zero.
    """
    numbers = arithmetic(None)
    seeded = Seeded(numbers_of(p, numbers), ("q", "object_pose", "qd", "object_twist"))
    changed = tangents_of(relative_twists(p.chain, seeded.given, numbers), seeded.count)
    of_positions, of_rates = np.split(changed, 2, axis=1)
    return np.block([[of_rates, 0 * of_rates], [of_positions, of_rates]])


def tangent(p: Problem) -> np.ndarray:
    """Return a basis of the tangent, (2n + 12, m); rigid grasps, closed."""
    return null_space(closed_rows(p))
