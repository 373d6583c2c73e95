"""The motion of a forest: what every body, closure and coupling brings into its equations, from the world outward.

zeta(k)    acceleration of body k minus [0; g] while no joint accelerates; that of a free body is -[0; g]
beta(k)    what the joints add, beta(k) = phi^T beta(p) + H qdd; the true acceleration of a free body

All quantities are in world axes about the point of a body, which is its frame's origin, or the mass centre of a free
body, where its inertia has two blocks. A closure reads K (phi_b^T beta_b - phi_a^T beta_a) = r.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.model.forest import Closure, Forest, ForestBody
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.spatial_vector import acceleration_gradient, centripetal, shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6, mirrored
from holdfast.spatial.vector import cross

_NONE = np.zeros(3)


class Carrier(NamedTuple):
    """A frame from which bodies and closures lead on: that of a body, or the world, which may be made to move.

    Attributes:
        frame: its pose in the world.
        centre: (3,) from the frame's origin to the point of the body [m].
        twist: (6,) twist of that point.
        zeta: (6,) its acceleration minus [0; g], while no joint accelerates.
    """

    frame: Pose
    centre: Array
    twist: Array
    zeta: Array

    @property
    def point(self) -> Array:
        """The point of the body in the world, (3,) [m]."""
        return self.frame.p + self.centre

    def twist_at(self, l: Array) -> Array:
        """Return the twist at l from the point (6,)."""
        return shift_twist(l, self.twist)

    def zeta_at(self, l: Array) -> Array:
        """Return the acceleration zeta at l from the point (6,)."""
        return shift_twist(l, self.zeta) + concatenate([_NONE, centripetal(self.twist[:3], l)])


class BodyMotion(NamedTuple):
    """A body at one instant.

    Attributes:
        at: its frame, point, twist and zeta.
        reach: (3,) from the point of its parent, or the world's origin, to its own [m].
        H: (6, m) motion of the body per joint rate.
        inertia: M(k).
        load: (6,) M zeta + b minus external wrenches; those of a free body are not included.
        torque: (m,) torques of the joint, without those of dampers.
        armature: (m,) inertia of the drives.
        wrench: (6,) external wrench on a free body; 0 for others.
    """

    at: Carrier
    reach: Array
    H: Array
    inertia: Symmetric6
    load: Array
    torque: Array
    armature: Array
    wrench: Array

    @property
    def floats(self) -> bool:
        """Whether the body is free."""
        return self.H.shape[1] == 6

    def true_acceleration(self, beta: Array, gravity: Array) -> Array:
        """Return the acceleration of the frame's origin, (6,), from beta at the point.

        Args:
            beta: (6,) acceleration that the joints add.
            gravity: (3,).
        """
        l = -self.at.centre
        centripetal_part = concatenate([_NONE, centripetal(self.at.twist[:3], l)])
        if self.floats:
            return shift_twist(l, beta) + centripetal_part
        return self.at.zeta + beta + concatenate([_NONE, gravity])

    def point_acceleration(self, alpha: Array) -> Array:
        """Return beta of a free body, (6,), from the true acceleration of its frame's origin."""
        return shift_twist(self.at.centre, alpha) + concatenate([_NONE, centripetal(self.at.twist[:3], self.at.centre)])

    def of_frame(self, rates: Array) -> Array:
        """Return rates in the coordinates of qd, (m,); those of a free body are given at its mass centre."""
        return shift_twist(-self.at.centre, rates) if self.floats else rates


class ClosureMotion(NamedTuple):
    """A closure at one instant.

    Attributes:
        contact: its kinematics, as of a grasp.
        tip: pose of the frame on body a in the world.
        K: (rows, 6) transmitted directions at the contact point.
        on_a: (rows, 6) -K phi_a^T, rows at the point of body a.
        on_b: (rows, 6) K phi_b^T, rows at the point of body b.
        r: (rows,) right-hand side.
    """

    contact: Contact
    tip: Pose
    K: Array
    on_a: Array
    on_b: Array
    r: Array

    def in_position(self) -> ClosureMotion:
        """Return the closure with its position rows, fewer than its velocity rows if it is nonholonomic, and r = 0."""
        rows = self.contact.grasp.of_kind.position_rows
        kept = [k for k, row in enumerate(self.contact.rows) if row in rows]
        found = self._replace(K=self.K[kept], on_a=self.on_a[kept], on_b=self.on_b[kept], r=np.zeros(len(kept)))
        return found._replace(contact=replace(self.contact, rows=rows))


class ForestMotion(NamedTuple):
    """A forest at one instant.

    Attributes:
        forest: the forest.
        bodies: its bodies.
        closures: its closures.
        coupled: per coupling, the right-hand side of its row.
    """

    forest: Forest
    bodies: list[BodyMotion]
    closures: list[ClosureMotion]
    coupled: list[Scalar]

    def at_rest_with(
        self, gaps: list[Array], coupled: list[Scalar], torques: list[Array] | None = None
    ) -> ForestMotion:
        """Return the forest at rest, without wrenches and gravity, with other right-hand sides of its rows.

        Args:
            gaps: per closure, (rows,) right-hand sides.
            coupled: per coupling, the right-hand side.
            torques: per body, (m,) torques, of a free body (6,) a wrench about its mass centre; None for none.
        """
        none, bodies = np.zeros(6), []
        for body, torque in zip(self.bodies, torques or [0.0 * b.torque for b in self.bodies], strict=True):
            given = {"wrench": torque, "torque": none} if body.floats else {"wrench": none, "torque": torque}
            bodies.append(body._replace(load=none, **given))
        closures = [c._replace(r=r) for c, r in zip(self.closures, gaps, strict=True)]
        return self._replace(bodies=bodies, closures=closures, coupled=coupled)


def still_world(gravity: Array) -> Carrier:
    """Return the world at rest, in which gravity is an upward acceleration."""
    return Carrier(Pose.identity(), _NONE, np.zeros(6), concatenate([_NONE, -gravity]))


def moving_world(point: Array, twist: Array, zeta: Array) -> Carrier:
    """Return the world as it moves with a prescribed base.

    Args:
        point: (3,) the base's origin [m].
        twist: (6,) its twist.
        zeta: (6,) its acceleration minus [0; g].
    """
    at_base = Carrier(Pose.identity(), _NONE, twist, zeta)
    return Carrier(Pose.identity(), _NONE, at_base.twist_at(-point), at_base.zeta_at(-point))


def forest_motion(
    forest: Forest,
    q: Array,
    qd: Array,
    torque: Array,
    wrenches: Array,
    under: Mapping[int, Carrier] | None = None,
    behind: Mapping[int, Carrier] | None = None,
) -> ForestMotion:
    """Return the motion of all bodies and closures, O(bodies + closures).

    Args:
        forest: the forest.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        torque: (n_v,) torques without those of dampers; for a free body a wrench about its frame's origin.
        wrenches: (bodies, 6) external wrenches about the frames' origins, world axes.
        under: by body on a joint to the world, what it stands on if that moves.
        behind: by closure with the world, what it is fixed to if that moves.
    """
    world, under, behind = still_world(forest.gravity), under or {}, behind or {}
    bodies: list[BodyMotion] = []
    parts = zip(forest.bodies, forest.positions, forest.velocities, wrenches, strict=True)
    for k, (body, at_q, at_v, wrench) in enumerate(parts):
        parent = under.get(k, world) if body.parent is None else bodies[body.parent].at
        moved = _floating if body.joint.of_kind.floats else _on_joint
        bodies.append(moved(body, parent, q[at_q], qd[at_v], torque[at_v], wrench))
    closures = [
        _closure(c, behind.get(i, world) if c.a is None else bodies[c.a].at, bodies[c.b].at)
        for i, c in enumerate(forest.closures)
    ]
    return ForestMotion(forest, bodies, closures, [0.0 for _ in forest.couplings])


def _on_joint(body: ForestBody, parent: Carrier, q: Array, qd: Array, torque: Array, wrench: Array) -> BodyMotion:
    joint, w, none = body.joint, parent.twist[:3], np.zeros(6)
    axes = parent.frame.R @ joint.placement.R
    Q, d = joint.displacement(q)
    from_frame = parent.frame.R @ joint.placement.p + axes @ d
    frame, l = Pose.unchecked(axes @ Q, parent.frame.p + from_frame), from_frame - parent.centre
    H = np.concatenate([axes @ joint.rate_map[:3], axes @ joint.rate_map[3:]])
    rates = H @ qd
    coriolis = concatenate([cross(w, rates[:3]), 2.0 * cross(w, rates[3:])])
    zeta = parent.zeta_at(l) + coriolis
    at = Carrier(frame, _NONE, parent.twist_at(l) + rates, zeta)
    inertia, turning = body.link.spatial_inertia.moved(frame.R, _NONE), at.twist[:3]
    load = inertia.wrench(zeta, turning, acceleration_gradient(zeta[:3], turning)) - wrench
    armature = np.full(len(qd), joint.armature)
    return BodyMotion(at, l, H, inertia.symmetric(), load, torque, armature, none)


def _floating(body: ForestBody, world: Carrier, q: Array, qd: Array, torque: Array, wrench: Array) -> BodyMotion:
    link = body.link
    R, p = body.joint.displacement(q)
    centre = R @ link.com
    at = Carrier(Pose.unchecked(R, p), centre, shift_twist(centre, qd), world.zeta)
    turning = mirrored(R @ link.inertia @ R.T)
    inertia = Symmetric6(turning, np.zeros((3, 3)), link.mass * np.eye(3))
    gyroscopic = cross(qd[:3], turning @ qd[:3])
    load = concatenate([gyroscopic, link.mass * world.zeta[3:]])
    pushed = shift_wrench(-centre, wrench + torque)
    return BodyMotion(at, p + centre, np.eye(6), inertia, load, np.zeros(6), np.zeros(6), pushed)


def _closure(closure: Closure, a: Carrier, b: Carrier) -> ClosureMotion:
    reach = a.frame.R @ closure.tip.p
    tip, l_a = Pose.unchecked(a.frame.R @ closure.tip.R, a.frame.p + reach), reach - a.centre
    c = contact(closure.grasp, b.frame, b.twist_at(-b.centre), tip, a.twist_at(l_a))
    l_b, K = c.offset - b.centre, c.K
    on_a, on_b = (array([shift_wrench(l, k) for k in K]).reshape(-1, 6) for l in (l_a, l_b))
    return ClosureMotion(c, tip, K, -on_a, on_b, K @ (c.g + a.zeta_at(l_a) - b.zeta_at(l_b)))
