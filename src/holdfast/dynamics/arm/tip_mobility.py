"""The mobility at the tip, Lambda(0) = J M^-1 J^T, by the recursion (6.10)."""

from __future__ import annotations

from holdfast.dynamics.arm.articulated import Filter
from holdfast.dynamics.arm.forward_kinematics import Kinematics
from holdfast.dynamics.arm.joint_map import expand
from holdfast.model.arm import Arm
from holdfast.spatial.symmetric import Symmetric6, zero6


def tip_mobility(arm: Arm, at: Kinematics, filter: Filter) -> Symmetric6:
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
