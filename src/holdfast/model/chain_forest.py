"""A closed chain as a forest: a trunk's bodies first, then those of the arms in order, and the object last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from holdfast.model.forest import BodyJoint, Closure, Forest, ForestBody
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.spatial.pose import Pose

if TYPE_CHECKING:
    from holdfast.model.closed_chain import ClosedChain


@dataclass(frozen=True, eq=False)
class ChainForest:
    """The forest of a chain, and where its parts are in it.

    Attributes:
        forest: the forest; force elements, whose wrenches follow from the state, are no part of it.
        trunk: the bodies of the trunk, beginning with a floating base.
        arms: by name, the bodies of every arm; none for an anchor.
        held_object: the object's body.
        closures: by the name of an arm, the closure of its grasp; none for a bushing.
    """

    forest: Forest
    trunk: range
    arms: Mapping[str, range]
    held_object: int
    closures: Mapping[str, int]


def chain_forest(chain: ClosedChain) -> ChainForest:
    """Return the forest of a chain. O(n) + O(l).

    The bodies on joints to the world stand where their bases are; prescribed motions of bases are inputs.

    Args:
        chain: the chain.
    """
    bodies: list[ForestBody] = []
    closures: list[Closure] = []
    arms: dict[str, range] = {}
    closed: dict[str, int] = {}
    trunk = chain.trunk
    if trunk is not None:
        if trunk.floating is not None:
            bodies.append(ForestBody(trunk.floating, BodyJoint("free")))
        base = Pose.identity() if trunk.floating is not None else trunk.base
        bodies += _serial(trunk.joints, trunk.links, base, 0 if bodies else None, len(bodies))
    first = len(bodies)
    stands = {name: chain.mounted_on.get(name) for name in chain.arms}
    for name, arm in chain.arms.items():
        start = len(bodies)
        bodies += _serial(arm.joints, arm.links, arm.base, stands[name], start)
        arms[name] = range(start, len(bodies))
    held, last = len(bodies), chain.held_object
    bodies.append(ForestBody(Link(last.mass, last.com, last.inertia, "object", last.physical), BodyJoint("free")))
    for name, grasp in chain.grasps.items():
        if grasp.of_kind.bushing is None:
            arm, own = chain.arms[name], arms[name]
            a, tip = (own[-1], arm.tip) if own else (stands[name], arm.base @ arm.tip)
            closed[name] = len(closures)
            closures.append(Closure(a, held, grasp, tip))
    return ChainForest(Forest(bodies, closures, (), chain.gravity), range(first), arms, held, closed)


def _serial(
    joints: Sequence[Joint], links: Sequence[Link], base: Pose, parent: int | None, first: int
) -> list[ForestBody]:
    """Return the bodies of a serial chain, of which the first has the index `first`."""
    bodies = []
    for k, (joint, link) in enumerate(zip(joints, links, strict=True)):
        placement = joint.placement if k else base @ joint.placement
        own = BodyJoint(joint.kind, placement, joint.axis, armature=joint.armature, damping=joint.damping)
        bodies.append(ForestBody(link, own, first + k - 1 if k else parent))
    return bodies
