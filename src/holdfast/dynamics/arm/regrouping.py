"""The same arm with fewer numbers: what turns about an axis without changing counts for the link before.

A thin rod along a revolute joint's axis moves alike whether it belongs to the joint's link or to
the one before. So all of a link's mass, its first moment along the axis and one of the moments
across it can be given to the link before, as far down as the first link, and every torque, every
force at tip and base, and the energy stay what they are (W. Khalil and E. Dombre, Modeling,
Identification and Control of Robots, ch. 9: base inertial parameters). Links' inertias are then
no body's any more, but they are constants with more zeros.
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
    """Return an arm of the same dynamics, rods along the joints' axes moved towards the base. O(N)."""
    inertias = [link.spatial_inertia for link in arm.links]
    for k in range(arm.joint_count - 1, 0, -1):
        joint = arm.joints[k]
        if joint.motion_subspace[1] is None:
            rod = rod_within(inertias[k], joint)
            inertias[k] = inertias[k].minus(rod)
            # the axis stands still in the link before, so any position of the joint will do
            inertias[k - 1] = inertias[k - 1].plus(rod.moved(joint.placement.R, joint.placement.p))
    return arm.of(links=[RegroupedLink(0.0, about_origin=I) for I in inertias])


def rod_within(inertia: RigidInertia, joint: Joint) -> RigidInertia:
    """Return the thin rod along a joint's axis that takes most of a link's inertia with it, about the same point."""
    a = joint.axis
    along = np.flatnonzero(np.abs(a) == 1.0)
    # off the coordinate axes no entry of the matrix would vanish
    across = inertia.I[along[0] - 1, along[0] - 1] if along.size else 0.0
    return RigidInertia(inertia.m, (inertia.h @ a) * a, across * (np.eye(3) - outer(a, a)))


@dataclass(frozen=True, eq=False)
class RegroupedLink(Link):
    """A link of a given inertia about its origin, which need not be a body's: no mass centre would give it.

    Attributes:
        about_origin: that inertia, link axes.
    """

    about_origin: RigidInertia | None = None

    @frozen_property
    def spatial_inertia(self) -> RigidInertia:
        """M(k): the inertia about the link's origin, link axes."""
        assert self.about_origin is not None
        return self.about_origin
