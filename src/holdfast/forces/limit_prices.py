"""Prices of limits in the elastic programme: by how much its least cost falls per unit by which a limit is raised."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.forces.arm_block import OfArm, cone_conditions
from holdfast.forces.limit_rows import NOUNS
from holdfast.forces.programme_block import Block
from holdfast.spatial.scalar import Array, Scalar, array, where

JOINT_LIMITS = ("effort", "acceleration")
LEAST_NORMAL, MOST_NORMAL, PRESSING = "least normal force", "most normal force", NOUNS["lifts off"].limit
GRASP_LIMITS = (*dict.fromkeys(noun.limit for noun in NOUNS.values()), LEAST_NORMAL, MOST_NORMAL)


def joint_prices(block: Block, z: Array, per_unit: Array, per_force: Scalar, limited: bool) -> Array:
    """Return the prices of joints, (n, 2), in the order of `JOINT_LIMITS`.

    Args:
        block: their block.
        z: its multipliers.
        per_unit: (n,) one over the unit of each joint's torque.
        per_force: 1 / F0.
        limited: whether accelerations are limited.
    """
    n, m = len(per_unit), len(block.low)
    both = z[:m] + z[m : 2 * m]
    return array([per_unit * both[:n], per_force * both[n : 2 * n] if limited else np.zeros(n)]).T


def grasp_prices(block: Block, z: Array, held: Contact | None, of: OfArm, per_force: Scalar) -> Array:
    """Return the prices of a grasp, (7,), in the order of `GRASP_LIMITS`; zeros without one.

    Args:
        block: the arm's block, whose last bound is that on the normal force.
        z: its multipliers.
        held: the grasp.
        of: its limits.
        per_force: 1 / F0.
    """
    found: dict[str, Scalar] = dict.fromkeys(GRASP_LIMITS, 0.0)
    if held is None:
        return array([*found.values()])
    m = len(block.low)
    found[MOST_NORMAL], found[LEAST_NORMAL] = z[m - 1], z[2 * m - 1]
    if held.grasp.contact is not None:  # of both lower bounds, the higher one is in the block
        bounded = of.bounds[1] > 0.0
        found[LEAST_NORMAL], found[PRESSING] = where(bounded, z[2 * m - 1], 0.0), where(bounded, 0.0, z[2 * m - 1])
    for condition, of_cone in zip(cone_conditions(held, of.contact), z[2 * m :], strict=True):
        found[NOUNS[condition.broken].limit] = found[NOUNS[condition.broken].limit] + of_cone
    return per_force * array([*found.values()])
