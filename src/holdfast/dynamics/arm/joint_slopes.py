"""Derivatives of an arm's torques with respect to its joints, by composite bodies, in O(N^2) for O(N^2) numbers.

Twists, wrenches and inertias of all links are in world axes about one point, the position of the tip. The axis S of a
joint moves with the links before it: its rate is Psi_dot = v x S, with Psi_ddot = a x S + v x Psi_dot. All bodies
beyond joint i together have the inertia I, the velocity-dependent matrix B, and require the wrench f. Then for joints j
<= i

    dT_j/dq_i  = S_j.(I Psi_ddot_i + 2 B Psi_dot_i + S_i x* f)      dT_j/dqd_i = 2 S_j.(I Psi_dot_i + B S_i)
    dT_i/dq_j  = S_i.(I Psi_ddot_j + 2 B Psi_dot_j)                 dT_i/dqd_j = 2 S_i.(I Psi_dot_j + B S_j)

(S. Singh, R. P. Russell and P. M. Wensing, Efficient Analytical Derivatives of Rigid-Body Dynamics Using Spatial
Vector Algebra, 2022; J. Carpentier and N. Mansard, Analytical Derivatives of Rigid Body Dynamics Algorithms, 2018).
B is given by few numbers: for particles of mass m at r with velocity u, B x = [(tr C - C) w; w x p] with x = [w; v],
C = sum m u r^T and p = sum m u. External wrenches and the tip wrench keep their directions in the world when the links
rotate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, jacobian
from holdfast.dynamics.arm.motion import ArmInputs
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.spatial_vector import acceleration_gradient, shift_twist, shift_wrench
from holdfast.spatial.symmetric import mirrored
from holdfast.spatial.vector import axial, cross, outer, skew


class JointSlope(NamedTuple):
    """Derivatives by one joint's position or rate, with constant joint accelerations, base motion and wrenches.

    Attributes:
        torque: (N,) derivative of all joint torques, without those of dampers and springs.
        base: (6,) derivative of the base's wrench on the arm about the base origin, world axes.
        turn: (3,) rotation of the tip, world axes.
        shift: (3,) translation of the tip point.
        twist: (6,) derivative of the tip point's twist.
        acceleration: (6,) derivative of the tip point's acceleration.
    """

    torque: Array
    base: Array
    turn: Array
    shift: Array
    twist: Array
    acceleration: Array


class Masses(NamedTuple):
    """Sums over the particles of some bodies, of mass m at r with velocity u, about the tip and in world axes.

    Attributes:
        m: sum m.
        h: (3,) sum m r.
        Q: (3, 3) sum m r r^T.
        p: (3,) sum m u.
        C: (3, 3) sum m u r^T.
        f: (6,) required wrench, which includes the tip wrench, minus the external wrenches on the links.
        D: (3, 3) and F describe the effect of external wrenches, which do not rotate with the links: for a rotation w
            they add [D w; F x w] to the change of a wrench that rotates with the links.
        F: (3,) the external force in f.
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
        """Return the sums over both sets of bodies."""
        return Masses(*(a + b for a, b in zip(self, other, strict=True)))

    def inertia(self) -> RigidInertia:
        """Return the inertia of the bodies."""
        return RigidInertia(self.m, self.h, np.trace(self.Q) * np.eye(3) - self.Q)


def joint_slopes(given: ArmInputs, at: Kinematics, qdd: Array, f: Array) -> tuple[list[JointSlope], list[JointSlope]]:
    """Return the derivatives by the positions of all joints, and by their rates. O(N^2).

    Args:
        given: the arm, with its state and loads.
        at: its configuration.
        qdd: (N,) joint accelerations.
        f: (6,) wrench of the arm on the object about the tip point, world axes.
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


TwistPair = tuple[Array, Array]  # twist and acceleration, (6,) each


def motions(given: ArmInputs, at: Kinematics, S: list[Array], qdd: Array) -> tuple[list[TwistPair], list[TwistPair]]:
    """Return the twist and the spatial acceleration about the tip of the links before and after every joint.

    The linear part of a spatial acceleration is the acceleration of the body's point minus w x v.
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
    """Return v x x, the rate of a twist x that is fixed in a body with twist v, (6,)."""
    return concatenate([cross(v[:3], x[:3]), cross(v[:3], x[3:]) + cross(v[3:], x[:3])])


def moving_link(given: ArmInputs, at: Kinematics, k: int, v: Array, a: Array) -> Masses:
    """Return the sums of link k about the tip, for its twist v and spatial acceleration a."""
    inertia, R, r = given.arm.links[k].spatial_inertia, at.R[k], -at.reach[k]
    turned = R @ inertia.h
    m, h = inertia.m, turned + inertia.m * r
    own = mirrored(0.5 * np.trace(inertia.I) * np.eye(3) - inertia.I)
    Q = mirrored(R @ own @ R.T + outer(turned, r) + outer(r, h))
    w, u = v[:3], v[3:]
    C, p = outer(u, h) + skew(w) @ Q, m * u + cross(w, h)
    K, point = acceleration_gradient(a[:3], w), a[3:] + cross(w, u)
    N = outer(point, h) + K @ Q
    f, D, F = concatenate([axial(N), m * point + K @ h]), np.zeros((3, 3)), np.zeros(3)
    if given.link_wrenches is not None:
        n, F = -given.link_wrenches[k][:3], -given.link_wrenches[k][3:]
        f, D = f + shift_wrench(r, concatenate([n, F])), skew(n) + skew(r) @ skew(F)
    return Masses(m, h, Q, p, C, f, D, F)


class OfJoint(NamedTuple):
    """The quantities of one joint in the derivatives of torques; see the module's docstring.

    Attributes:
        S: (6,) joint axis.
        slow, quick: (6,) Psi_dot, Psi_ddot.
        IS: (6,) I S.
        BS: (3,) the angular part of B^T S; the linear part is zero.
        DS: (3,) the effect on this joint's torque of external wrenches that do not rotate, per rotation of the links.
        by_q, by_qd: (6,) derivative of the wrench of all bodies beyond by q, and half of that by qd.
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
    """Return the quantities of one joint.

    Args:
        S: its axis.
        v: twist of the link before it.
        a: spatial acceleration of the link before it.
        beyond: sums over all bodies after it.
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
