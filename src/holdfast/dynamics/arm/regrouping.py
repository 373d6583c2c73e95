"""Regrouping of inertial parameters: an equivalent arm whose link inertias have more zeros.

A thin rod along the axis of a revolute joint moves in the same way whether it belongs to the joint's link or to the
link before. The mass of a link, its first moment along the axis and one of its transverse moments of inertia can
therefore be moved to the link before, and so on down to the first link. All torques, the forces at tip and base, and
the energy stay the same (W. Khalil and E. Dombre, Modeling, Identification and Control of Robots, ch. 9: base inertial
parameters). The resulting link inertias are not those of physical bodies, but constants with more zeros.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.spatial.frozen import frozen_property
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.vector import outer


def regrouped(arm: Arm) -> Arm:
    """Return an arm with the same dynamics, in which rods along the joint axes are moved towards the base. O(N)."""
    inertias = [link.spatial_inertia for link in arm.links]
    for k in range(arm.joint_count - 1, 0, -1):
        joint = arm.joints[k]
        if joint.motion_subspace[1] is None:
            rod = rod_within(inertias[k], joint)
            inertias[k] = inertias[k].minus(rod)
            # the axis is fixed in the link before, so the position of the joint does not matter
            inertias[k - 1] = inertias[k - 1].plus(rod.moved(joint.placement.R, joint.placement.p))
    return arm.of(links=[RegroupedLink(0.0, about_origin=I) for I in inertias])


def rod_within(inertia: RigidInertia, joint: Joint) -> RigidInertia:
    """Return the thin rod along a joint's axis that removes most of a link's inertia, about the same point."""
    a = joint.axis
    along = np.flatnonzero(np.abs(a) == 1.0)
    # for an axis that is not a coordinate axis, no entry of the matrix would vanish
    across = inertia.I[along[0] - 1, along[0] - 1] if along.size else 0.0
    return RigidInertia(inertia.m, (inertia.h @ a) * a, across * (np.eye(3) - outer(a, a)))


@dataclass(frozen=True, eq=False)
class RegroupedLink(Link):
    """A link with a given inertia about its origin, which need not be that of a physical body.

    Attributes:
        about_origin: the inertia, in link axes.
    """

    about_origin: RigidInertia | None = None

    @frozen_property
    def spatial_inertia(self) -> RigidInertia:
        """M(k), the inertia about the link's origin, in link axes."""
        assert self.about_origin is not None
        return self.about_origin
