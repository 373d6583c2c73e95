"""The motion of a forest: what every body, closure and coupling brings into its equations, from the world outward.

zeta(k)    acceleration of body k minus [0; g] while no joint accelerates; that of a free body is -[0; g]
beta(k)    what the joints add, beta(k) = phi^T beta(p) + H qdd; the true acceleration of a free body

All quantities are in world axes about the point of a body, which is its frame's origin, or the mass centre of a free
body, where its inertia has two blocks. A closure reads K (phi_b^T beta_b - phi_a^T beta_a) = r.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.closed.object_motion import FreeBody, free_body
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.model.closure import Closure
from holdfast.model.forest import Forest, ForestBody, Topology
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.spatial_vector import acceleration_gradient, centripetal, shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6
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
        free: a free body by itself, if its mobility about its mass centre is at hand.
    """

    at: Carrier
    reach: Array
    H: Array
    inertia: Symmetric6
    load: Array
    torque: Array
    armature: Array
    wrench: Array
    free: FreeBody | None = None

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
        true = self.at.zeta + beta + concatenate([_NONE, gravity])
        if not self.floats:
            return true
        l = -self.at.centre
        return shift_twist(l, true) + concatenate([_NONE, centripetal(self.at.twist[:3], l)])

    def at_rest(self) -> BodyMotion:
        """Return the body at rest, without torques, wrenches and gravity."""
        none, free = np.zeros(6), None if self.free is None else self.free.at_rest()
        still = self.at._replace(zeta=none)
        return self._replace(at=still, load=none, torque=0.0 * self.torque, wrench=none, free=free)

    def point_acceleration(self, alpha: Array) -> Array:
        """Return beta of a free body, (6,), from the true acceleration of its frame's origin."""
        return shift_twist(self.at.centre, alpha) + concatenate([_NONE, centripetal(self.at.twist[:3], self.at.centre)])

    def of_frame(self, rates: Array) -> Array:
        """Return rates in the coordinates of qd, (m,); those of a free body are given at its mass centre."""
        return shift_twist(-self.at.centre, rates) if self.floats else rates


class ClosureMotion(NamedTuple):
    """A closure at one instant: K (phi_b^T beta_b - phi_a^T beta_a) = r with r = K (g + zeta_a - zeta_b).

    Attributes:
        contact: its kinematics, as of a grasp.
        tip: pose of the frame on body a in the world.
        l_a, l_b: (3,) from the points of the bodies to the contact point [m].
        g: (6,) as of the contact.
        zeta_a, zeta_b: (6,) accelerations at the contact point while no joint accelerates.
    """

    contact: Contact
    tip: Pose
    l_a: Array
    l_b: Array
    g: Array
    zeta_a: Array
    zeta_b: Array

    @property
    def K(self) -> Array:
        """(rows, 6) transmitted directions at the contact point."""
        return self.contact.K

    @property
    def on_a(self) -> Array:
        """(rows, 6) -K phi_a^T, rows at the point of body a."""
        return -array([shift_wrench(self.l_a, k) for k in self.K]).reshape(-1, 6)

    @property
    def on_b(self) -> Array:
        """(rows, 6) K phi_b^T, rows at the point of body b."""
        return array([shift_wrench(self.l_b, k) for k in self.K]).reshape(-1, 6)

    @property
    def r(self) -> Array:
        """(rows,) right-hand side."""
        return self.contact.transmitted(self.g + self.zeta_a - self.zeta_b)

    def at_rest_with(self, r: Array) -> ClosureMotion:
        """Return the closure at rest with another right-hand side."""
        none = np.zeros(6)
        return self._replace(g=r @ self.K, zeta_a=none, zeta_b=none)

    def in_position(self) -> ClosureMotion:
        """Return the closure with its position rows, fewer than its velocity rows if it is nonholonomic, and r = 0."""
        still = self.at_rest_with(np.zeros(len(self.contact.rows)))
        return still._replace(contact=replace(self.contact, rows=self.contact.grasp.of_kind.position_rows))


class ForestMotion(NamedTuple):
    """A forest at one instant.

    Attributes:
        forest: the forest, or what has its topology and couplings.
        bodies: its bodies; None within limbs.
        closures: its closures.
        coupled: per coupling, the right-hand side of its row.
        limbs: by closure, the limb that it ends; its response is one step.
        lone: limbs without a closure.
        standing: limbs on their bodies, whose part in the virtual power is that of arms (`limb_power`).
    """

    forest: Any
    bodies: list[Any]
    closures: list[ClosureMotion]
    coupled: list[Scalar]
    limbs: Mapping[int, Limb] = MappingProxyType({})
    lone: Sequence[Limb] = ()
    standing: Sequence[Any] = ()

    @property
    def topology(self) -> Topology:
        """Its graph."""
        return self.forest.topology

    @property
    def couplings(self) -> list[Sequence[tuple[int, int, float]]]:
        """Per coupling, its terms."""
        return [coupling.terms for coupling in self.forest.couplings]

    @property
    def all_limbs(self) -> list[Limb]:
        """Limbs with and without a closure."""
        return [*self.limbs.values(), *self.lone]

    def at_rest_with(
        self, gaps: list[Array], coupled: list[Scalar], torques: list[Array] | None = None
    ) -> ForestMotion:
        """Return the forest at rest, without wrenches and gravity, with other right-hand sides of its rows.

        Args:
            gaps: per closure, (rows,) right-hand sides.
            coupled: per coupling, the right-hand side.
            torques: per body, (m,) torques, of a free body (6,) a wrench about its mass centre; None for none.
        """
        bodies = [body and body.at_rest() for body in self.bodies]
        if torques is not None:
            bodies = [
                body and (body._replace(wrench=torque) if body.floats else body._replace(torque=torque))
                for body, torque in zip(bodies, torques, strict=True)
            ]
        closures = [c.at_rest_with(r) for c, r in zip(self.closures, gaps, strict=True)]
        return self._replace(bodies=bodies, closures=closures, coupled=coupled)


class Limb(NamedTuple):
    """A serial arm with its response at its tip, of which at most one closure needs more than its base.

    Attributes:
        on: the body on which it stands; `GROUND` for the world.
        offset: (3,) from the point of that body to its base [m].
        tip: its tip response, with columns if it stands on a body: of its acceleration, or of the joint rates below it.
    """

    on: int
    offset: Array
    tip: TipResponse


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
    within: Container[int] = (),
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
        within: bodies of limbs, for which, and for whose closures, None is returned.
    """
    world, under, behind = still_world(forest.gravity), under or {}, behind or {}
    bodies: list[Any] = []
    parts = zip(forest.bodies, forest.positions, forest.velocities, wrenches, strict=True)
    for k, (body, at_q, at_v, wrench) in enumerate(parts):
        if k in within:
            bodies.append(None)
            continue
        parent = under.get(k, world) if body.parent is None else bodies[body.parent].at
        moved = _floating if body.joint.of_kind.floats else _on_joint
        bodies.append(moved(body, parent, q[at_q], qd[at_v], torque[at_v], wrench))
    closures: list[Any] = []
    for i, c in enumerate(forest.closures):
        a = behind.get(i, world) if c.a is None else bodies[c.a] and bodies[c.a].at
        b = bodies[c.b] and bodies[c.b].at
        closures.append(None if a is None or b is None else _closure(c, a, b))
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
    R, p = body.joint.displacement(q)
    free = free_body(body.link, R, qd[:3])
    at = Carrier(Pose.unchecked(R, p), free.centre, shift_twist(free.centre, qd), world.zeta)
    load = concatenate([cross(qd[:3], free.inertia.aa @ qd[:3]), body.link.mass * world.zeta[3:]])
    pushed = shift_wrench(-free.centre, wrench + torque)
    return BodyMotion(at, p + free.centre, np.eye(6), free.inertia, load, np.zeros(6), np.zeros(6), pushed, free)


def _closure(closure: Closure, a: Carrier, b: Carrier) -> ClosureMotion:
    reach = a.frame.R @ closure.tip.p
    tip, l_a = Pose.unchecked(a.frame.R @ closure.tip.R, a.frame.p + reach), reach - a.centre
    c = contact(closure.grasp, b.frame, b.twist_at(-b.centre), tip, a.twist_at(l_a))
    l_b = c.offset - b.centre
    return ClosureMotion(c, tip, l_a, l_b, c.g, a.zeta_at(l_a), b.zeta_at(l_b))
