"""The Kalman filter of one arm: factorisation, whitening, smoothing, and the mobility at the tip (paper, Sec. 5, 6).

    M = (I + H Phi L) D (I + H Phi L)^T,   (I + H Phi L)^-1 = I - H Psi L    (5.2), (5.3)
    Lambda(0) = J M^-1 J^T, by a recursion                                   (6.10)

The gain here is G(k) = P(k) H^T(k) / D(k); the paper's is L(k) = phi(k+1, k) G(k).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, column, expand, project
from holdfast.model.arm import Arm
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import rotate, shift_twist, shift_wrench, unrotate
from holdfast.spatial.symmetric import Symmetric6, zero6


class ArmFilter(NamedTuple):
    """The factorisation of one arm's mass matrix.

    Attributes:
        D: (N,) articulated inertia about each joint axis, > 0.
        G: per link, (6,) gain P H^T / D, link axes.
        at_base: articulated inertia of the arm at its base, with free joints, about the base origin, base axes.
    """

    D: Array
    G: tuple[Array, ...]
    at_base: Symmetric6


def articulated_filter(arm: Arm, at: Kinematics) -> ArmFilter:
    """Return D and G. One inward sweep, O(N).

    P(k) = phi P_plus phi^T + M(k);  D = H P H^T + armature;  G = P H^T / D;
    P_plus = P - G H P.
    """
    D, G = [], []
    carried = zero6()  # there is nothing beyond the last link
    for joint, link, E, l in reversed(list(zip(arm.joints, arm.links, at.E, at.l, strict=True))):
        P = link.spatial_inertia.symmetric().plus(carried)
        PH = column(joint, P)
        d = project(joint, PH) + joint.armature
        gain = PH / d
        D.insert(0, d)
        G.insert(0, gain)
        carried = P.plus_outer(-gain, PH).rotated(E).inertia_shifted(l)
    return ArmFilter(array(D), tuple(G), carried)


def whiten(
    arm: Arm,
    at: Kinematics,
    filter: ArmFilter,
    torque: Array | None,
    wrenches: tuple[Array, ...] | None,
    tip_wrench: Array | None,
) -> tuple[Array, Array]:
    """Return eps = T - H psi (S L T + p + B f) and the remaining wrench at the base.

    With p = None and f = None this is (I - H Psi L) T (5.9a); with p = M zeta + b it is
    (5.14b); with f it is the curly bracket of (6.17). One inward sweep, O(N).

    Args:
        arm: the arm.
        at: its configuration.
        filter: its factorisation.
        torque: (N,) joint torques T, or None for zero.
        wrenches: per link, bias wrenches p in link axes, or None for zero.
        tip_wrench: (6,) f of the arm on the object about the tip point, in the axes of
            the last link, or None for zero.

    Returns:
        (N,) residuals eps, and (6,) wrench of the base on the arm, about the base
        origin, base axes.
    """
    N = arm.joint_count
    z = np.zeros(6) if tip_wrench is None else shift_wrench(arm.tip.p, tip_wrench)
    eps: list[object] = [0.0] * N
    for k in reversed(range(N)):
        if wrenches is not None:
            z = z + wrenches[k]
        along_joint = project(arm.joints[k], z)
        eps[k] = -along_joint if torque is None else torque[k] - along_joint
        z = shift_wrench(at.l[k], rotate(at.E[k], z + filter.G[k] * eps[k]))
    return array(eps), z


def smooth(arm: Arm, at: Kinematics, filter: ArmFilter, nu: Array, base: Array | None = None) -> tuple[Array, Array]:
    """Return (I - H Psi L)^T nu and the tip acceleration J times it.

    lambda(k) = psi^T lambda(k+1) + H^T nu(k);  out(k) = nu(k) - L^T lambda(k+1)
    (5.10e-g); the tip is B^T psi^T H^T nu. One outward sweep, O(N).

    Args:
        arm: the arm.
        at: its configuration.
        filter: its factorisation.
        nu: (N,) residuals over D.
        base: (6,) acceleration of the base, the first lambda, base axes; None for zero.

    Returns:
        (N,) joint accelerations, and (6,) tip acceleration, in the axes of the last link.
    """
    lam = np.zeros(6) if base is None else base
    out = []
    for joint, E, l, G, nu_k in zip(arm.joints, at.E, at.l, filter.G, nu, strict=True):
        x = unrotate(E, shift_twist(l, lam))
        out_k = nu_k - G @ x
        lam = x + expand(joint, out_k)
        out.append(out_k)
    return array(out), shift_twist(arm.tip.p, lam)


def tip_mobility(arm: Arm, at: Kinematics, filter: ArmFilter) -> Symmetric6:
    """Return Lambda(0) of the tip point in the axes of the last link. One outward sweep, O(N).

    Lambda(k) = psi^T Lambda(k+1) psi + H^T H / D, with psi = phi (I - G H): for
    Z = phi^T Lambda phi and y = Z G this is Z - H^T y^T - y H + (G.y + 1/D) H^T H.
    """
    Y = zero6()  # the mobility of the base is zero
    for joint, E, l, G, D in zip(arm.joints, at.E, at.l, filter.G, filter.D, strict=True):
        Z = Y.mobility_shifted(l).rotated(E.T)
        y = Z.apply(G)
        Y = Z.plus_symmetric_outer(expand(joint, 1.0), expand(joint, 0.5 * (G @ y + 1.0 / D)) - y)
    return Y.mobility_shifted(arm.tip.p)
