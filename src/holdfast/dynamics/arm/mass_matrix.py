"""The joint mass matrix, computed with composite bodies: M = H phi M phi^T H^T + armature (5.1a)."""

from __future__ import annotations

from holdfast.dynamics.arm.forward_kinematics import Kinematics, expand, project
from holdfast.model.arm import Arm
from holdfast.spatial.inertia import NO_INERTIA, RigidInertia
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import rotate, shift_wrench


def mass_matrix(arm: Arm, at: Kinematics) -> tuple[Array, Array, RigidInertia]:
    """Return the mass matrix, the base wrenches for unit joint accelerations, and the inertia with locked joints.

    Column k follows from the wrench that accelerates all bodies beyond joint k with qdd_k = 1, by projecting it onto
    the joints before. O(N^2).

    Returns:
        A tuple of three: the symmetric mass matrix (N, N) [kg m^2, kg m, kg]; a matrix (6, N) whose column k is the
        wrench of the base on the first link for qdd_k = 1, about that link's origin, in its axes; and the inertia of
        all links with locked joints, about the base origin, in base axes.
    """
    N = arm.joint_count
    entries: list[list[object]] = [[0.0] * N for _ in range(N)]
    at_first = []
    composite = NO_INERTIA
    for k in reversed(range(N)):
        joint = arm.joints[k]
        composite = arm.links[k].spatial_inertia.plus(composite)
        F = composite.apply(expand(joint, 1.0))
        entries[k][k] = project(joint, F) + joint.armature
        for j in reversed(range(k)):
            F = shift_wrench(at.l[j + 1], rotate(at.E[j + 1], F))
            entries[j][k] = entries[k][j] = project(arm.joints[j], F)
        at_first.insert(0, F)
        composite = composite.moved(at.E[k], at.l[k])
    return array(entries).reshape(N, N), array(at_first).reshape(N, 6).T, composite
