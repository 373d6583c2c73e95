"""The arguments of a forest's equations, in which numbers can be replaced by scalars of any kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.tree.forest_motion import Carrier, ForestMotion, forest_motion, moving_world
from holdfast.dynamics.tree.limbs import LimbArm, carriers_of, standing_limbs, with_links_of
from holdfast.model.forest import Forest, ForestBody
from holdfast.questions.case import varied_body
from holdfast.spatial import rotation
from holdfast.spatial.frozen import changed
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.vector import skew

FOREST_ARGUMENTS = (
    *("q", "qd", "tau", "link_wrench", "gravity", "armature", "damping"),
    *("link_mass", "link_com", "link_inertia", "joint_pose", "tip_pose", "grasp_pose"),
)


class MovingBase(NamedTuple):
    """The prescribed motion of something that stands in the world.

    Attributes:
        point: (3,) its origin [m].
        twist: (6,) its twist.
        acceleration: (6,) its true acceleration.
    """

    point: Array
    twist: Array
    acceleration: Array

    def world(self, gravity: Array) -> Carrier:
        """Return the world as it moves with it."""
        return moving_world(self.point, self.twist, self.acceleration - concatenate([np.zeros(3), gravity]))


class ForestArguments(NamedTuple):
    """The arguments of `forest_dynamics`, shaped.

    Attributes:
        forest: the forest.
        q: (n_q,) positions with unit quaternions.
        qd: (n_v,) rates.
        tau: (n_v,) torques of drives, without those of dampers and springs in the joints.
        wrenches: (bodies, 6) external wrenches about the origins of the bodies' frames.
        under: by body on a joint to the world, the base on which it stands, if that moves.
        behind: by closure with the world, the base to which it is fixed, if that moves.
        limbs: chains of joints whose part in the virtual power is that of arms (`limb_power`).
    """

    forest: Forest
    q: Array
    qd: Array
    tau: Array
    wrenches: Array
    under: Mapping[int, MovingBase] = MappingProxyType({})
    behind: Mapping[int, MovingBase] = MappingProxyType({})
    limbs: Sequence[LimbArm] = ()

    def values(self, names: Sequence[str]) -> dict[str, Array]:
        """Return the named numbers; those of positions and poses are tangents, which are zero."""
        forest = self.forest
        bodies, closures = forest.bodies, len(forest.closures)
        own = {
            "q": lambda: np.zeros(forest.velocity_count),
            "qd": lambda: self.qd,
            "tau": lambda: self.tau,
            "link_wrench": lambda: self.wrenches,
            "gravity": lambda: forest.gravity,
            "armature": lambda: np.array([body.joint.armature for body in bodies]),
            "damping": lambda: np.array([body.joint.damping for body in bodies]),
            "link_mass": lambda: np.array([body.link.mass for body in bodies]),
            "link_com": lambda: np.array([body.link.com for body in bodies]),
            "link_inertia": lambda: np.array([body.link.inertia for body in bodies]),
            "joint_pose": lambda: np.zeros((len(bodies), 6)),
            "tip_pose": lambda: np.zeros((closures, 6)),
            "grasp_pose": lambda: np.zeros((closures, 6)),
        }
        return {name: own[name]() for name in names}

    def motion(self, varied: Mapping[str, Array]) -> ForestMotion:
        """Return the motion with some numbers replaced, named as by `values`; tangents are exact to first order."""
        forest = self.forest
        if not varied.keys() <= {"q", "qd", "tau", "link_wrench"}:
            forest = changed(
                forest,
                bodies=tuple(_body(body, k, varied) for k, body in enumerate(forest.bodies)),
                closures=tuple(
                    changed(
                        c,
                        tip=_moved(c.tip, "tip_pose", varied, i),
                        grasp=c.grasp.standing_at(_moved(c.grasp.frame, "grasp_pose", varied, i)),
                    )
                    for i, c in enumerate(forest.closures)
                ),
                gravity=varied.get("gravity", forest.gravity),
            )
        q = self.q + position_rates(self.forest, self.q, varied["q"]) if "q" in varied else self.q
        qd, tau, wrenches = (
            varied.get(name, own) for name, own in (("qd", self.qd), ("tau", self.tau), ("link_wrench", self.wrenches))
        )
        drives = tau - damping_torques(forest, qd) - spring_torques(forest, q)
        bases = ({i: base.world(forest.gravity) for i, base in of.items()} for of in (self.under, self.behind))
        limbs = [with_links_of(forest, one, varied) for one in self.limbs if not _changes_shape(one, varied)]
        within = {k for one in limbs for k in one.joints}
        motion = forest_motion(forest, q, qd, drives, wrenches, *bases, within=within)
        standing = standing_limbs(forest, limbs, carriers_of(motion), q, qd, drives, wrenches)
        return motion._replace(standing=standing)


def displaced(forest: Forest, q: Array, step: Array) -> Array:
    """Return positions after a step: q + step, but for quaternions, which turn by exp(step) from the left.

    Args:
        forest: the forest.
        q: (n_q,) positions.
        step: (n_v,) small displacement in the coordinates of qd.
    """
    parts = []
    for body, at_q, at_v in zip(forest.bodies, forest.positions, forest.velocities, strict=True):
        own, by = q[at_q], step[at_v]
        if body.joint.of_kind.pose:
            turned = rotation.quaternion_product(rotation.quaternion_exp(by[:3]), own[:4])
            parts += [rotation.normalised(turned), own[4:] + by[3:]]
        else:
            parts.append(own + by)
    return concatenate(parts)


def unit_quaternions(forest: Forest, q: Array) -> Array:
    """Return positions with quaternions scaled to unit length."""
    found = q.copy()
    for turned, _ in forest.quaternions:
        found[turned] = rotation.normalised(q[turned])
    return found


def position_rates(forest: Forest, q: Array, qd: Array) -> Array:
    """Return dq/dt, (n_q,), of which the part of a quaternion is half the product of the angular velocity with it."""
    parts, done = [], 0
    for turned, turning in forest.quaternions:
        parts += [
            qd[done : turning.start],
            0.5 * rotation.quaternion_product(concatenate([[0.0], qd[turning]]), q[turned]),
        ]
        done = turning.stop
    return concatenate([*parts, qd[done:]])


def by_positions(forest: Forest, q: Array, by_turns: Array) -> Array:
    """Return the gradient with respect to positions, (n_q,), from that in the coordinates of qd, (n_v,)."""
    scaled = by_turns.copy()
    for _, turning in forest.quaternions:  # position_rates / |half a unit quaternion|^2
        scaled[turning] = 4.0 * by_turns[turning]
    return position_rates(forest, q, scaled)


def rates_of_positions(forest: Forest, q: Array, rates: Array) -> Array:
    """Return qd, (n_v,), from dq/dt, (n_q,): the inverse of `position_rates`, also of quaternions of other lengths."""
    parts, done = [], 0
    for at, _ in forest.quaternions:
        turned = q[at]
        back = concatenate([turned[:1], -turned[1:]]) / (turned @ turned)
        parts += [rates[done : at.start], 2.0 * rotation.quaternion_product(rates[at], back)[1:]]
        done = at.stop
    return concatenate([*parts, rates[done:]])


def displacement(forest: Forest, before: Array, after: Array) -> Array:
    """Return the step from some positions to others, (n_v,), for `displaced`."""
    parts = []
    for body, at in zip(forest.bodies, forest.positions, strict=True):
        old, new = before[at], after[at]
        if body.joint.of_kind.pose:
            there, here = rotation.from_quaternion(new[:4]), rotation.from_quaternion(old[:4])
            parts += [rotation.log(there @ here.T), new[4:] - old[4:]]
        else:
            parts.append(new - old)
    return concatenate(parts)


def damping_torques(forest: Forest, qd: Array) -> Array:
    """Return damping qd, (n_v,)."""
    parts = [body.joint.damping * qd[at] for body, at in zip(forest.bodies, forest.velocities, strict=True)]
    return concatenate([0.0 * x if len(x) == 6 else x for x in parts])


def spring_torques(forest: Forest, q: Array) -> Array:
    """Return stiffness (q - rest) of the springs in the joints, (n_v,)."""
    parts = []
    for body, at_q, at_v in zip(forest.bodies, forest.positions, forest.velocities, strict=True):
        joint = body.joint
        stretched = joint.stiffness * (q[at_q] - joint.rest) if joint.stiffness else np.zeros(at_v.stop - at_v.start)
        parts.append(stretched)
    return concatenate(parts)


def _changes_shape(one: LimbArm, varied: Mapping[str, Array]) -> bool:
    """Return whether varied frames are within a limb, which then is not taken as an arm."""
    return "joint_pose" in varied or ("grasp_pose" if one.is_b else "tip_pose") in varied


def _body(body: ForestBody, k: int, varied: Mapping[str, Array]) -> ForestBody:
    own = {name: varied[name][k] for name in ("armature", "damping") if name in varied}
    joint = changed(body.joint, **own, placement=_moved(body.joint.placement, "joint_pose", varied, k))
    return changed(body, link=varied_body(body.link, "link", varied, k), joint=joint)


def _moved(pose: Pose, name: str, varied: Mapping[str, Array], row: int) -> Pose:
    """Return a pose turned from the left, and shifted, by a tangent that is zero but may vary."""
    if name not in varied:
        return pose
    turn, shift = varied[name][row][:3], varied[name][row][3:]
    return Pose.unchecked(pose.R + skew(turn) @ pose.R, pose.p + shift)
