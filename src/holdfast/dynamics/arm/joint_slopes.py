"""How an arm's torques change with its joints while all else is held, by composite bodies: O(N^2) numbers in O(N^2).

Twists, wrenches and inertias of all links are taken in world axes about one point, where the tip is. The links before
a joint carry its axis S along; it changes at Psi_dot = v x S, with Psi_ddot = a x S + v x Psi_dot. All bodies beyond
joint i taken as one have the inertia I, the velocity-dependent B and need the wrench f. Then for joints j <= i

    dT_j/dq_i  = S_j.(I Psi_ddot_i + 2 B Psi_dot_i + S_i x* f)      dT_j/dqd_i = 2 S_j.(I Psi_dot_i + B S_i)
    dT_i/dq_j  = S_i.(I Psi_ddot_j + 2 B Psi_dot_j)                 dT_i/dqd_j = 2 S_i.(I Psi_dot_j + B S_j)

(S. Singh, R. P. Russell and P. M. Wensing, Efficient Analytical Derivatives of Rigid-Body Dynamics Using Spatial
Vector Algebra, 2022; J. Carpentier and N. Mansard, Analytical Derivatives of Rigid Body Dynamics Algorithms, 2018).
B has few numbers: of particles m at r that move at u, B x = [(tr C - C) w; w x p] with x = [w; v], C = sum m u r^T and
p = sum m u. Wrenches from outside keep their axes while the links turn, and so does that of the tip.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.motion import ArmInputs
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.spatial_vector import acceleration_gradient, shift_twist, shift_wrench
from holdfast.spatial.symmetric import mirrored
from holdfast.spatial.vector import cross, outer, skew


class JointSlope(NamedTuple):
    """Derivatives by one joint's position, or by its rate; joint accelerations, base and all wrenches are held.

    Attributes:
        torque: (N,) of all joints' torques, those of dampers and springs apart.
        base: (6,) of the base's wrench on the arm about the base origin, world axes.
        turn: (3,) how the tip turns, world axes.
        shift: (3,) how the tip point moves.
        twist: (6,) of the tip point's twist.
        acceleration: (6,) of the tip point's acceleration.
    """

    torque: Array
    base: Array
    turn: Array
    shift: Array
    twist: Array
    acceleration: Array


class Masses(NamedTuple):
    """What bodies have about the tip, world axes: sums over their particles m at r, which move at u and accelerate.

    Attributes:
        m: sum m.
        h: (3,) sum m r.
        Q: (3, 3) sum m r r^T.
        p: (3,) sum m u.
        C: (3, 3) sum m u r^T.
        f: (6,) the wrench that they need, with the tip's and without what acts on the links from outside.
        D: (3, 3) with F, how f differs as its outside part keeps its axes: turning links by w adds [D w; F x w] to
            the change of a wrench that turns with them.
        F: (3,) the force of that outside part of f.
    """

    m: Scalar
    h: Array
    Q: Array
    p: Array
    C: Array
    f: Array
    D: Array
    F: Array

    def plus(self, other: Masses) -> Masses:
        """Return both together."""
        return Masses(*(a + b for a, b in zip(self, other, strict=True)))

    def inertia(self) -> RigidInertia:
        """Return their inertia."""
        return RigidInertia(self.m, self.h, np.trace(self.Q) * np.eye(3) - self.Q)


def joint_slopes(given: ArmInputs, at: Kinematics, qdd: Array, f: Array) -> tuple[list[JointSlope], list[JointSlope]]:
    """Return the derivatives by all joints' positions, and by their rates. O(N^2).

    Args:
        given: the arm and what it is given.
        at: its configuration.
        qdd: (N,) joint accelerations.
        f: (6,) of the arm on the object about the tip point, world axes.
    """
    S = list(jacobian(given.arm, at).T)
    before, after = motions(given, at, S, qdd)
    none = np.zeros(3)
    beyond = Masses(0.0, none, np.zeros((3, 3)), none, np.zeros((3, 3)), f, skew(f[:3]), f[3:])
    found: list[OfJoint] = []
    for k in reversed(range(len(S))):
        beyond = moving_link(given, at, k, *after[k]).plus(beyond)
        found.insert(0, of_joint(S[k], *before[k], beyond))
    v, a = after[-1] if after else before[-1]
    w_tip, u, lever = v[:3], v[3:], at.from_base
    alpha, point = a[:3], a[3:] + cross(w_tip, u)
    by_q, by_qd = [], []
    for i, one in enumerate(found):
        w, s, slow, quick = one.S[:3], one.S[3:], one.slow, one.quick
        torque = [S_j @ one.by_q for S_j in S[: i + 1]]
        torque += [o.IS @ quick + 2.0 * (o.BS @ slow[:3]) + o.DS @ w for o in found[i + 1 :]]
        twist = slow + concatenate([cross(w, w_tip), cross(w, u)])
        turning = quick[:3] - cross(w_tip, slow[:3]) + cross(w, alpha)
        moving = quick[3:] + 2.0 * cross(slow[:3], u) + cross(w, point)
        by_q.append(
            JointSlope(array(torque), shift_wrench(lever, one.by_q), w, s, twist, concatenate([turning, moving]))
        )
        torque = [2.0 * (S_j @ one.by_qd) for S_j in S[: i + 1]]
        torque += [2.0 * (o.IS @ slow + o.BS @ w) for o in found[i + 1 :]]
        acceleration = concatenate([2.0 * slow[:3] + cross(w, w_tip), 2.0 * (slow[3:] + cross(w, u))])
        base = shift_wrench(lever, 2.0 * one.by_qd)
        by_qd.append(JointSlope(array(torque), base, np.zeros(3), np.zeros(3), one.S, acceleration))
    return by_q, by_qd


Motion = tuple[Array, Array]  # twist and acceleration, (6,) each


def motions(given: ArmInputs, at: Kinematics, S: list[Array], qdd: Array) -> tuple[list[Motion], list[Motion]]:
    """Return twist and acceleration, as spatial vectors about the tip, before every joint and after it.

    The linear part of such an acceleration is that of the body's point less w x v.
    """
    w = given.base_twist[:3]
    field = given.base_acceleration - concatenate([np.zeros(3), cross(w, given.base_twist[3:])])
    v, a = (shift_twist(at.from_base, x) for x in (given.base_twist, field))
    before, after = [(v, a)], []
    for axis, rate, acceleration in zip(S, given.qd, qdd, strict=True):
        a = a + acceleration * axis + rate * crossed(v, axis)
        v = v + rate * axis
        after.append((v, a))
        before.append((v, a))
    return before, after


def crossed(v: Array, x: Array) -> Array:
    """Return v x x: how fast a twist x changes that is carried along at v, (6,)."""
    return concatenate([cross(v[:3], x[:3]), cross(v[:3], x[3:]) + cross(v[3:], x[:3])])


def moving_link(given: ArmInputs, at: Kinematics, k: int, v: Array, a: Array) -> Masses:
    """Return what link k has about the tip while it moves at v and accelerates at a."""
    inertia, R, r = given.arm.links[k].spatial_inertia, at.R[k], -at.reach[k]
    turned = R @ inertia.h
    m, h = inertia.m, turned + inertia.m * r
    own = mirrored(0.5 * np.trace(inertia.I) * np.eye(3) - inertia.I)
    Q = mirrored(R @ own @ R.T + outer(turned, r) + outer(r, h))
    w, u = v[:3], v[3:]
    C, p = outer(u, h) + skew(w) @ Q, m * u + cross(w, h)
    K, point = acceleration_gradient(a[:3], w), a[3:] + cross(w, u)
    N = outer(point, h) + K @ Q
    moment = array([N[2, 1] - N[1, 2], N[0, 2] - N[2, 0], N[1, 0] - N[0, 1]])
    f, D, F = concatenate([moment, m * point + K @ h]), np.zeros((3, 3)), np.zeros(3)
    if given.link_wrenches is not None:
        n, F = -given.link_wrenches[k][:3], -given.link_wrenches[k][3:]
        f, D = f + shift_wrench(r, concatenate([n, F])), skew(n) + skew(r) @ skew(F)
    return Masses(m, h, Q, p, C, f, D, F)


class OfJoint(NamedTuple):
    """What the torques of one joint, and those by it, are made of; see the module's text.

    Attributes:
        S: (6,) axis.
        slow, quick: (6,) Psi_dot, Psi_ddot.
        IS: (6,) I S.
        BS: (3,) the angular part of B^T S, all of it that is not zero.
        DS: (3,) how S feels that wrenches from outside keep their axes, by the turn of the links.
        by_q, by_qd: (6,) how the wrench of all beyond changes; by qd half of it.
    """

    S: Array
    slow: Array
    quick: Array
    IS: Array
    BS: Array
    DS: Array
    by_q: Array
    by_qd: Array


def of_joint(S: Array, v: Array, a: Array, beyond: Masses) -> OfJoint:
    """Return a joint's own part.

    Args:
        S: its axis.
        v: twist of the link before.
        a: its acceleration.
        beyond: all bodies after it.
    """
    w, s, inertia = S[:3], S[3:], beyond.inertia()
    slow = crossed(v, S)
    quick = crossed(a, S) + crossed(v, slow)
    E, f = np.trace(beyond.C) * np.eye(3) - beyond.C, beyond.f

    def momenta(x: Array) -> Array:
        return concatenate([E @ x, cross(x, beyond.p)])

    turning = concatenate([cross(w, f[:3]) + cross(s, f[3:]) + beyond.D @ w, cross(w, f[3:] - beyond.F)])
    by_q = inertia.apply(quick) + momenta(2.0 * slow[:3]) + turning
    by_qd = inertia.apply(slow) + momenta(w)
    BS, DS = w @ E + cross(beyond.p, s), w @ beyond.D + cross(s, beyond.F)
    return OfJoint(S, slow, quick, inertia.apply(S), BS, DS, by_q, by_qd)
