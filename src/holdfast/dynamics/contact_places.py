"""Where the grasps are, without motion: the axes and the point that their wrenches are given along and about."""

from __future__ import annotations

from typing import NamedTuple

from holdfast.dynamics.arm.posture import posture
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.scalar import Array
from holdfast.state import State


class ContactPlace(NamedTuple):
    """Axes and point of one grasp, world axes.

    Attributes:
        grasp: the grasp.
        R: (3, 3) its axes of freedom and transmission.
        offset: (3,) from C to the contact point, the tip's where the object slides [m].
    """

    grasp: Grasp
    R: Array
    offset: Array


def contact_places(chain: ClosedChain, state: State) -> list[ContactPlace]:
    """Return where each grasp is, in order. O(l), and O(n) where axes or point follow the tips."""
    frame, found = state.object_frame, []
    for name, grasp in chain.grasps.items():
        kind, R, offset = grasp.of_kind, frame.R @ grasp.frame.R, frame.R @ grasp.frame.p
        if kind.follows_tip:
            tip = posture(chain.arms[name], state.q[chain.joints[name]]).tip
            R, offset = kind.axes(R, tip.R), tip.p - frame.p if kind.slides else offset
        found.append(ContactPlace(grasp, R, offset))
    return found
