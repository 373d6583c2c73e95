"""The axes and contact points of the grasps at rest: grasp wrenches are expressed along and about them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, each
from holdfast.state import State


class ContactPlace(NamedTuple):
    """The axes and the contact point of one grasp.

    Attributes:
        grasp: the grasp.
        R: (3, 3) rotation from the axes of its free and transmitted directions to world axes.
        offset: (3,) from C to the contact point, world axes [m]. If the object slides, the contact point is the tip's
            origin.
    """

    grasp: Grasp
    R: Array
    offset: Array


def contact_places(chain: ClosedChain, state: State) -> list[ContactPlace]:
    """Return axes and contact point of each grasp, in order. O(l), or O(n) if any of them follow the tips."""
    frame, found = state.object_frame, []
    tips = tip_frames(chain, state, [name for name, grasp in chain.grasps.items() if grasp.of_kind.follows_tip])
    for name, grasp in chain.grasps.items():
        kind, R, offset = grasp.of_kind, frame.R @ grasp.frame.R, frame.R @ grasp.frame.p
        if name in tips:
            tip = tips[name]
            R, offset = kind.axes(R, tip.R), tip.p - frame.p if kind.slides else offset
        found.append(ContactPlace(grasp, R, offset))
    return found


def tip_frames(chain: ClosedChain, state: State, names: Sequence[str]) -> dict[str, Pose]:
    """Return the tip poses of the named arms in the world. O(n)."""
    trunk = trunk_at_rest(chain, state)
    mounts = {} if trunk is None else trunk.mounts
    arms = [chain.arms[name].standing_at(mounts[name].frame) if name in mounts else chain.arms[name] for name in names]
    own = [state.q[chain.joints[name]] for name in names]
    return dict(zip(names, each(lambda arm, q: forward_kinematics(arm, q).tip, arms, own), strict=True))
