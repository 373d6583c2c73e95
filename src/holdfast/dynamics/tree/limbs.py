"""Limbs of a forest: chains of joints with one degree of freedom that end at one closure, each solved as an arm.

What a limb does to the rest follows from its tip response, in the axes of its links, which takes fewer operations than
to carry its bodies one by one. The elimination takes it as a leaf, and its joints follow from its wrench and from the
acceleration of the body on which it stands (`tip_response`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmInputs, ArmMotion, arm_motion
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.closed.tip_response import TipResponse, tip_response
from holdfast.dynamics.tree.forest_motion import Carrier, ClosureMotion, ForestMotion, Limb, forest_motion, still_world
from holdfast.dynamics.tree.order import MeasureLeaves
from holdfast.dynamics.tree.plan import plan_of
from holdfast.model.arm import Arm
from holdfast.model.closure import Closure
from holdfast.model.forest import GROUND, Forest
from holdfast.model.joint import Joint
from holdfast.spatial.frozen import changed
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array, each
from holdfast.spatial.spatial_vector import shift_twist


class LimbArm(NamedTuple):
    """A limb by itself.

    Attributes:
        closure: the closure that it ends.
        joints: its bodies.
        is_b: whether its last body is the closure's body b.
        on: the body on which it stands; `GROUND` for the world.
        base: pose of its base in the frame of that body.
        arm: its joints and links; the tip is the contact point. Limbs that differ only where they stand are equal.
    """

    closure: int
    joints: tuple[int, ...]
    is_b: bool
    on: int
    base: Pose
    arm: Arm


class StandingLimb(NamedTuple):
    """A limb on its body at one instant.

    Attributes:
        limb: the limb.
        offset: (3,) from the body's point to its base [m].
        given: its arm, standing there, with its state, torques and loads.
    """

    limb: LimbArm
    offset: Array
    given: ArmInputs


class LimbMotion(NamedTuple):
    """A limb at one instant: its arm, the closure that it ends, and its tip response."""

    limb: LimbArm
    arm: ArmMotion
    closure: ClosureMotion
    tip: TipResponse


class LimbedMotion(NamedTuple):
    """A forest at one instant, with limbs.

    Attributes:
        motion: the forest's motion, with None for the bodies of limbs.
        limbs: by closure, the limbs.
    """

    motion: ForestMotion
    limbs: Mapping[int, LimbMotion]


def limb_arms(forest: Forest) -> list[LimbArm]:
    """Return the limbs among the leaves of a forest's plan."""
    topology, found = forest.topology, []
    needed = Counter([*topology.parents, *(k for ends in topology.ends for k in ends)])
    needed.update(k for bodies in topology.coupled for k in bodies)
    for steps in plan_of(topology).steps:
        for leaf in (one for step in steps if isinstance(step, MeasureLeaves) for one in step.leaves):
            single = [forest.bodies[k].joint.of_kind.freedoms == 1 for k in leaf.joints]
            bare = [needed[k] == 1 for k in leaf.joints]  # by the next body, or by the closure
            closure = forest.closures[leaf.closure]
            moves = leaf.is_b and closure.grasp.of_kind.slides  # the contact point would move on the limb
            if leaf.joints and all(single) and all(bare) and not moves:
                base = forest.bodies[leaf.joints[0]].joint.placement
                on, arm = topology.parents[leaf.joints[0]], _arm(forest, leaf.joints, closure, leaf.is_b)
                found.append(LimbArm(leaf.closure, leaf.joints, leaf.is_b, on, base, arm))
    return found


def _arm(forest: Forest, bodies: Sequence[int], closure: Closure, is_b: bool) -> Arm:
    tip = Pose.translation(*closure.grasp.frame.p) if is_b else closure.tip
    joints, links, place = [], [], Pose.identity()
    for k in bodies:
        joint, link = forest.bodies[k].joint, forest.bodies[k].link
        assert joint.kind != "free"
        joints.append(Joint(joint.kind, joint.axis, place, pitch=joint.pitch, armature=joint.armature))
        links.append(replace(link, name=""))
        place = forest.bodies[bodies[len(links)]].joint.placement if len(links) < len(bodies) else place
    return Arm(joints, links, tip=tip)


def with_links_of(forest: Forest, one: LimbArm, varied: Container[str]) -> LimbArm:
    """Return a limb with the numbers of a forest's joints and links if some of those are varied."""
    if not any(name in varied for name in ("armature", "link_mass", "link_com", "link_inertia")):
        return one
    bodies = [forest.bodies[k] for k in one.joints]
    joints = [changed(joint, armature=b.joint.armature) for joint, b in zip(one.arm.joints, bodies, strict=True)]
    return one._replace(arm=one.arm.of(joints, [body.link for body in bodies]))


def limbed_motion(
    forest: Forest, arms: Sequence[LimbArm], q: Array, qd: Array, torque: Array, wrenches: Array | None = None
) -> LimbedMotion:
    """Return the motion of a forest with limbs, O(bodies + closures).

    Args:
        forest: the forest.
        arms: its limbs; see `limb_arms`.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        torque: (n_v,) torques without those of dampers; for a free body a wrench about its frame's origin.
        wrenches: (bodies, 6) external wrenches about the frames' origins, world axes; None for none.
    """
    loads = np.zeros((len(forest.bodies), 6)) if wrenches is None else wrenches
    motion = forest_motion(forest, q, qd, torque, loads, within={k for one in arms for k in one.joints})
    carriers = carriers_of(motion)
    standing = standing_limbs(forest, arms, carriers, q, qd, torque, wrenches)
    limbs, on_bodies, closures = {}, {}, [*motion.closures]
    for stood, (arm, tip) in zip(standing, each(_in_motion, [one.given for one in standing]), strict=True):
        one, closed = stood.limb, closed_by(forest, stood.limb, arm.at.tip, arm.tip_twist, carriers)
        limbs[one.closure] = LimbMotion(one, arm, closed, tip)
        on_bodies[one.closure] = Limb(one.on, stood.offset, tip)
        closures[one.closure] = closed
    return LimbedMotion(motion._replace(closures=closures, limbs=on_bodies), limbs)


def carriers_of(motion: ForestMotion) -> list[Any]:
    """Return the carriers of bodies and, last, of the world; None within limbs."""
    return [*(None if body is None else body.at for body in motion.bodies), still_world(motion.forest.gravity)]


def standing_limbs(
    forest: Forest,
    arms: Sequence[LimbArm],
    carriers: Sequence[Any],
    q: Array,
    qd: Array,
    torque: Array,
    wrenches: Array | None,
) -> list[StandingLimb]:
    """Return limbs on what carries them, `carriers_of`; the other arguments are those of `limbed_motion`."""
    found = []
    for one in arms:
        at = carriers[one.on]
        pushed = None if wrenches is None else wrenches[list(one.joints)]
        l = at.frame.R @ one.base.p - at.centre
        found.append(StandingLimb(one, l, _inputs(one, at, l, *_joints_of(forest, one, q, qd, torque), pushed)))
    return found


def _inputs(
    one: LimbArm, at: Carrier, l: Array, q: Array, qd: Array, torque: Array, wrenches: Array | None
) -> ArmInputs:
    columns = None
    if one.on != GROUND:
        columns = array([shift_twist(l, column) for column in np.eye(6)]).T
    base = Pose.unchecked(at.frame.R @ one.base.R, at.point + l)
    return ArmInputs(one.arm.standing_at(base), q, qd, torque, at.twist_at(l), at.zeta_at(l), wrenches, columns)


def _joints_of(forest: Forest, one: LimbArm, q: Array, qd: Array, torque: Array) -> tuple[Array, Array, Array]:
    at_q, at_v = ([of[k].start for k in one.joints] for of in (forest.positions, forest.velocities))
    return q[at_q], qd[at_v], torque[at_v]


def _in_motion(given: ArmInputs) -> tuple[ArmMotion, TipResponse]:
    arm = arm_motion(given)
    return arm, tip_response(arm, "auto")


def closed_by(forest: Forest, one: LimbArm, end: Pose, twist: Array, carriers: Sequence[Any]) -> ClosureMotion:
    """Return the closure that a limb ends, without the limb's free acceleration, which is in its response.

    Args:
        forest: the forest.
        one: the limb.
        end: pose of its tip.
        twist: (6,) twist of its tip.
        carriers: as in `standing_limbs`.
    """
    closure, none = forest.closures[one.closure], np.zeros(6)
    k = closure.a if one.is_b else closure.b
    other = carriers[GROUND if k is None else k]
    if not one.is_b:
        c = contact(closure.grasp, other.frame, other.twist_at(-other.centre), end, twist)
        l = c.offset - other.centre
        return ClosureMotion(_anywhere(c), end, np.zeros(3), l, c.g, none, other.zeta_at(l))
    reach = other.frame.R @ closure.tip.p
    to_origin, l = -(end.R @ closure.grasp.frame.p), reach - other.centre
    tip = Pose.unchecked(other.frame.R @ closure.tip.R, other.frame.p + reach)
    frame, twist = Pose.unchecked(end.R, end.p + to_origin), shift_twist(to_origin, twist)
    c = contact(closure.grasp, frame, twist, tip, other.twist_at(l))
    return ClosureMotion(_anywhere(c), tip, l, np.zeros(3), c.g, other.zeta_at(l), none)


def _anywhere(c: Contact) -> Contact:
    """Return a contact whose grasp stands nowhere in particular, so that those of equal kind share their code."""
    return replace(c, grasp=c.grasp.standing_at(Pose.identity()))
