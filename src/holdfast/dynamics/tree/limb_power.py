"""The part of limbs in the virtual power of a forest, each an arm that stands on a body.

It is that of an arm's links (`closed.virtual_power`), in their axes, with the motion and the virtual twist of its base.
The tip's acceleration and virtual twist make up the rows of the closure that the limb ends (`tree.virtual_power`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmInputs
from holdfast.dynamics.closed.virtual_power import ArmCase, ArmUnknowns, TipMotion
from holdfast.dynamics.tree.elimination import Tips
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.limbs import StandingLimb, carriers_of, closed_by
from holdfast.model.forest import GROUND
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, each
from holdfast.spatial.spatial_vector import shift_twist

_NONE = np.zeros(6)


class LimbsInMotion(NamedTuple):
    """A forest's motion with the part of its limbs in L; without limbs, the motion alone.

    Attributes:
        motion: the motion, with the closures that limbs end.
        power: the limbs' part of L.
        accelerations: by closure and whether its body b ends a limb, the acceleration of the limb's tip, (6,).
        virtual: likewise, its virtual twist, (6,).
    """

    motion: ForestMotion
    power: Scalar = 0.0
    accelerations: Tips = MappingProxyType({})
    virtual: Tips = MappingProxyType({})


def limbs_in_motion(
    motion: ForestMotion,
    rates: Sequence[Array],
    beta: Sequence[Array],
    virtual_rates: Sequence[Array],
    virtual: Sequence[Array],
) -> LimbsInMotion:
    """Return the motion of a forest with the part of its limbs in the virtual power. O(joints).

    Args:
        motion: the forest's motion, with None for bodies within limbs and for closures that limbs end.
        rates: per body, (m,) joint accelerations.
        beta: per body that is not within limbs, the acceleration of its point, (6,).
        virtual_rates: per body, (m,) virtual joint rates.
        virtual: per body that is not within limbs, the virtual twist of its point, (6,).
    """
    limbs: Sequence[StandingLimb] = motion.standing
    if not limbs:
        return LimbsInMotion(motion)

    def of(per_body: Sequence[Array]) -> list[Array]:
        return [concatenate([per_body[k] for k in one.limb.joints]) for one in limbs]

    def at_base(per_body: Sequence[Array]) -> list[Array]:
        return [_NONE if (k := one.limb.on) == GROUND else shift_twist(one.offset, per_body[k]) for one in limbs]

    given = [one.given for one in limbs], of(rates), at_base(beta), of(virtual_rates), at_base(virtual)
    power, tips, carriers, closures = 0.0, {}, carriers_of(motion), [*motion.closures]
    for one, (own, tip) in zip(limbs, each(_limb_power, *given), strict=True):
        limb, power = one.limb, power + own
        tips[limb.closure, limb.is_b] = tip
        closures[limb.closure] = closed_by(motion.forest, limb, tip.pose, tip.twist, carriers)
    accelerations = {at: tip.acceleration for at, tip in tips.items()}
    return LimbsInMotion(
        motion._replace(closures=closures), power, accelerations, {at: tip.virtual for at, tip in tips.items()}
    )


def _limb_power(
    given: ArmInputs, qdd: Array, acceleration: Array, rates: Array, virtual: Array
) -> tuple[Scalar, TipMotion]:
    """Return the power of a limb's links, and the motion of its tip."""
    moved = replace(given, base_acceleration=given.base_acceleration + acceleration)
    case, none = ArmCase(moved, None, Pose.identity(), _NONE), np.zeros(0)
    z, y = (ArmUnknowns(x, _NONE, none, _NONE, base) for x, base in ((qdd, _NONE), (rates, virtual)))
    return case.of_links(*case.configuration({}), z, y, {})
