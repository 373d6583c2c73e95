"""The smallest grasp forces with the same effect, where the motion does not determine them; floats or traced.

Of a grasp's wrench f = K^T lambda, |moment/L|^2 + |force|^2 = |mu|^2 with mu = C^T lambda and K W^2 K^T = C C^T, where
W = diag(1/L, 1). Its effect on joints and object is (C^-1 K [J, -A])^T mu. Hence the smallest mu with a given effect is
the part of mu in the range of that matrix, E = C^-1 K [J, -A].
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.constraint import constraint_rows, length_scale
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution, in_range
from holdfast.spatial.scalar import Array, array, concatenate, reciprocal
from holdfast.spatial.spatial_vector import shift_wrench


def with_smallest_forces(motion: ChainMotion, found: Solution) -> Solution:
    """Return the solution with the grasp forces of least norm, sum |moment/L|^2 + |force|^2.

    Args:
        motion: the chain's motion, of which only the configuration matters.
        found: a solution, of which only the wrenches are used, and the rank of the constraint, a number that must be
            known: if the grasps are slightly open, the effect of these wrenches is small but not zero.
    """
    rows = constraint_rows(motion)
    per_length = reciprocal(length_scale([c.offset for c in motion.contacts]))
    weights = array([*3 * [per_length * per_length], 1.0, 1.0, 1.0])
    factors, effects, sizes = [], [np.zeros((0, rows.matrix.shape[1]))], []
    for c, part, f in zip(motion.contacts, rows.slices, found.wrenches, strict=True):
        K = c.grasp.of_kind.directions[list(c.rows)]
        factors.append(cholesky((K * weights) @ K.T))
        effects.append(forward_substitution(factors[-1], rows.matrix[part]))
        sizes.append(factors[-1].T @ c.transmitted(f))
    independent = int(found.rank) - motion.chain.contact_freedom_count
    smallest = in_range(np.concatenate(effects), concatenate(sizes), independent)
    wrenches = [
        back_substitution(factor, smallest[part]) @ c.K
        for c, part, factor in zip(motion.contacts, rows.slices, factors, strict=True)
    ]
    return replace(found, wrenches=wrenches, base_wrenches=None)  # they belong to other forces


def replaced_by_smallest(
    motion: ChainMotion, rank: int, grasp_wrench: Array, base_wrench: Array, trunk_base_wrench: Array | None
) -> tuple[Array, Array, Array | None]:
    """Return the smallest grasp wrenches with the same effect, and the wrenches of the bases with them.

    The accelerations are the same, hence a change of a grasp's wrench passes through the arm to its base as it is.

    Args:
        motion: the chain's motion, of which only the configuration matters.
        rank: rank of the constraint.
        grasp_wrench: (arms, 6) wrench of each arm on the object, about the contact point.
        base_wrench: (arms, 6) wrench of the base on each arm, about the base origin.
        trunk_base_wrench: (6,) wrench of the base on the trunk, about the base origin; None without a trunk.
    """
    chain, trunk, below = motion.chain, motion.trunk, trunk_base_wrench
    places = [chain.names.index(name) for name in chain.grasps]
    given = [grasp_wrench[k] for k in places]
    found = with_smallest_forces(motion, Solution([], given, np.zeros(6), rank=rank)).wrenches
    grasps, bases = list(grasp_wrench), list(base_wrench)
    for name, k, c, arm, f in zip(chain.grasps, places, motion.contacts, motion.holding, found, strict=True):
        if not c.rows:  # what a bushing exerts is known
            continue
        grasps[k], passed = f, shift_wrench(arm.base_to_tip, f - grasp_wrench[k])
        bases[k] = bases[k] + passed
        if name in trunk.mounts and not trunk.floats:
            below = below + shift_wrench(trunk.mounts[name].frame.p - trunk.base.p, passed)
    return array(grasps), array(bases), below
