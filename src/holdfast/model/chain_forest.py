"""A closed chain as a forest: a trunk's bodies first, then those of the arms in order, and the objects last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closure import Closure
from holdfast.model.coupling import Coupling
from holdfast.model.forest import BodyJoint, Forest, ForestBody, JointCoupling
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.trunk import BASE, TRUNK
from holdfast.spatial.frozen import Frozen, changed
from holdfast.spatial.pose import Pose

if TYPE_CHECKING:
    from holdfast.model.closed_chain import ClosedChain


@dataclass(frozen=True, eq=False)
class ChainForest(Frozen):
    """The forest of a chain, and where its parts are in it.

    Attributes:
        forest: the forest; force elements, whose wrenches follow from the state, are no part of it.
        trunk: the bodies of the trunk, beginning with a floating base.
        arms: by name, the bodies of every arm; none for an anchor.
        objects: by name, the body of every object.
        closures: by the name of an arm, or arm and frame, the closure of its grasp, and by its name that of a loop;
            none for a bushing.
    """

    forest: Forest
    trunk: range
    arms: Mapping[str, range]
    objects: Mapping[str, int]
    closures: Mapping[Any, int]

    @property
    def held_object(self) -> int:
        """The body of the only object."""
        (held,) = self.objects.values()
        return held

    def frame(self, chain: ClosedChain, given: Any, what: str) -> tuple[int | None, Pose]:
        """Return the body to which a frame of the chain belongs, and its pose on it; see `frame_of`."""
        return frame_of(chain, self.arms, self.objects, given, what)


def chain_forest(chain: ClosedChain) -> ChainForest:
    """Return the forest of a chain. O(n) + O(l).

    The bodies on joints to the world stand where their bases are; prescribed motions of bases are inputs.

    Args:
        chain: the chain.

    Raises:
        ModelError: a grasp, loop or coupling names a frame, object or joint that the chain does not have.
    """
    bodies: list[ForestBody] = []
    arms: dict[str, range] = {}
    trunk = chain.trunk
    if trunk is not None:
        if trunk.floating is not None:
            bodies.append(ForestBody(trunk.floating, BodyJoint("free")))
        base, on = Pose.identity() if trunk.floating is not None else trunk.base, 0 if bodies else None
        serial = (None, *range(len(trunk.joints)))[:-1]
        bodies += _on_joints(TRUNK, trunk.joints, trunk.links, serial, base, on, len(bodies))
    first = len(bodies)
    stands = {name: chain.mounted_on.get(name) for name in chain.arms}
    for name, arm in chain.arms.items():
        start = len(bodies)
        bodies += _on_joints(name, arm.joints, arm.links, arm.parent_of, arm.base, stands[name], start)
        arms[name] = range(start, len(bodies))
    objects = {name: len(bodies) + k for k, name in enumerate(chain.free_objects)}
    for name, one in chain.free_objects.items():
        bodies.append(ForestBody(Link(one.mass, one.com, one.inertia, name, one.physical), BodyJoint("free")))

    end = partial(frame_of, chain, arms, objects)
    closures: list[Closure] = []
    closed: dict[Any, int] = {}
    for key, grasp in chain.grasps.items():
        if grasp.of_kind.bushing is not None and not chain.beyond_serial:
            continue
        name, frame = (key, None) if isinstance(key, str) else key
        label = f"grasp '{name if frame is None else f'{name}/{frame}'}'"
        arm, own = chain.arms[name], arms[name]
        if frame is not None:
            link, tip = arm.frame(frame, label)
            a: int | None = own[link]
        elif arm.parents:
            frames = [*arm.frames, *filter(None, (link.name for link in arm.links))]
            raise ModelError(
                f"{label}: expected a link or frame of an arm with branches, as ('{name}', frame)."
                f"{checks.did_you_mean('', frames)}"
            )
        else:
            a, tip = (own[-1], arm.tip) if own else (stands[name], arm.base @ arm.tip)
        closed[key] = len(closures)
        closures.append(Closure(a, objects[chain.held_by(grasp, key)], grasp, tip, label))

    def within(arm: str, given: Any, what: str) -> tuple[int | None, Pose]:
        """Return the body of an end of an arm's own loop, likewise."""
        if given is None:
            return stands[arm], chain.arms[arm].base
        link, at = chain.arms[arm].frame(given, what)
        return arms[arm][link], at

    every = [
        (f"{arm}/{name}", loop, partial(within, arm))
        for arm, of in chain.arms.items()
        for name, loop in of.loops.items()
    ]
    for name, loop, found in [*every, *((name, loop, end) for name, loop in chain.loops.items())]:
        (a, at_a), (b, at_b) = (found(getattr(loop, side), f"loop '{name}': {side}") for side in ("a", "b"))
        if b is None or a == b:
            raise ModelError(
                f"loop '{name}': expected two bodies, or None for the world as a, got {loop.a!r}, {loop.b!r}"
            )
        closed[name] = len(closures)
        grasp = loop.grasp.standing_at(at_b @ loop.grasp.frame)
        closures.append(Closure(a, b, grasp, at_a @ loop.tip, f"loop '{name}'"))
    places = [k for k in range(len(bodies) - len(objects)) if not (k == 0 and chain.floats)]
    joints = dict(zip(chain.joint_names(), places, strict=True))
    couplings = [_coupling(one, joints) for one in chain.all_couplings]
    return ChainForest(Forest(bodies, closures, couplings, chain.gravity), range(first), arms, objects, closed)


def frame_of(
    chain: ClosedChain, arms: Mapping[str, range], objects: Mapping[str, int], given: Any, what: str
) -> tuple[int | None, Pose]:
    """Return the body to which a frame belongs, None for the world, and the frame's pose on it.

    Args:
        chain: the chain.
        arms: as in `ChainForest`.
        objects: likewise.
        given: "arm/link" for a link or frame of an arm, "trunk/link" for a body of the trunk, an object's name, or None
            for the world.
        what: what names it, for messages.

    Raises:
        ModelError: there is none.
    """
    if given is None or given in objects:
        return None if given is None else objects[given], Pose.identity()
    arm, _, frame = str(given).partition("/")
    if chain.trunk is not None and arm == TRUNK and frame:
        return chain.trunk.body(frame, what), Pose.identity()
    if arm not in arms or not frame:
        of_trunk = [] if chain.trunk is None else [f"{TRUNK}/{link.name}" for link in chain.trunk.links]
        of_trunk += [f"{TRUNK}/{BASE}"] if chain.floats else []
        of_arms = [f"{one}/{link.name}" for one, found in chain.arms.items() for link in found.links]
        ends = [*objects, *of_trunk, *of_arms]
        raise ModelError(f"{what}: no '{given}'.{checks.did_you_mean(str(given), ends)}")
    link, at = chain.arms[arm].frame(frame, what)
    return arms[arm][link], at


def _coupling(coupling: Coupling, joints: Mapping[str, int]) -> JointCoupling:
    """Return a coupling by bodies."""
    for name in coupling.terms:
        if name not in joints:
            raise ModelError(f"coupling: no joint '{name}'.{checks.did_you_mean(name, joints)}")
    terms = [(joints[name], 0, c) for name, c in coupling.terms.items()]
    return JointCoupling(terms, coupling.offset, f"coupling of {' and '.join(map(repr, coupling.terms))}")


def _on_joints(
    name: str,
    joints: Sequence[Joint],
    links: Sequence[Link],
    parents: Sequence[int | None],
    base: Pose,
    parent: int | None,
    first: int,
) -> list[ForestBody]:
    """Return the bodies of a tree on a base that is fixed to `parent`; the first of them has the index `first`.

    Their names are those of the links, as "arm/link", or the indices of links without a name.
    """
    bodies = []
    for k, (joint, link, on) in enumerate(zip(joints, links, parents, strict=True)):
        placement = joint.placement if on is not None else base @ joint.placement
        given = {name: getattr(joint, name) for name in ("pitch", "armature", "damping", "stiffness", "rest")}
        own = BodyJoint(joint.kind, placement, joint.axis, **given, actuated=joint.actuated)
        named = changed(link, name=f"{name}/{link.name or k}")
        bodies.append(ForestBody(named, own, parent if on is None else first + on))
    return bodies
