"""Kinematics and mass matrix of one arm, for users: the functions of `arm` with checked arguments."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


def tip_pose(arm: Arm, q: ArrayLike) -> Pose:
    """Return the pose of an arm's tip frame in the world. O(N).

    Args:
        arm: the arm.
        q: (N,) joint positions, base to tip [rad or m].

    Raises:
        StateError: the number of positions is wrong, or they are not finite.
    """
    return _configuration(arm, q).tip


def link_poses(arm: Arm, q: ArrayLike) -> list[Pose]:
    """Return the pose of every link frame in the world, base to tip; its origin lies on the link's joint. O(N).

    Args:
        arm: the arm.
        q: (N,) joint positions, base to tip [rad or m].

    Raises:
        StateError: the number of positions is wrong, or they are not finite.
    """
    return link_frames(_configuration(arm, q))


def link_frames(at: Kinematics) -> list[Pose]:
    """Return the pose of every link frame of a configuration in the world."""
    return [Pose.unchecked(R, at.tip.p - reach) for R, reach in zip(at.R, at.reach, strict=True)]


@np.errstate(all="ignore")  # what overflows is refused
def tip_jacobian(arm: Arm, q: ArrayLike) -> Array:
    """Return J (6, N) with [omega; v] = J qd of the tip frame about its origin, world axes: J = B^T phi^T H^T (5.1b).

    This is Pinocchio's LOCAL_WORLD_ALIGNED Jacobian with the angular and linear halves exchanged; `linear_first(J,
    axis=0)` converts it. O(N).

    Args:
        arm: the arm.
        q: (N,) joint positions, base to tip [rad or m].

    Raises:
        StateError: the number of positions is wrong, or they are not finite or so large that their squares overflow.
    """
    return checks.finite(np.asarray(jacobian(arm, _configuration(arm, q)), dtype=float), "tip Jacobian")


@np.errstate(all="ignore")  # what overflows is refused
def joint_mass_matrix(arm: Arm, q: ArrayLike) -> Array:
    """Return the mass matrix M (N, N): 1/2 qd^T M qd is the arm's kinetic energy, armatures included (5.1a). O(N^2).

    Args:
        arm: the arm, alone.
        q: (N,) joint positions, base to tip [rad or m].

    Raises:
        StateError: the number of positions is wrong, or they are not finite or so large that their squares overflow.
    """
    return checks.finite(np.asarray(mass_matrix(arm, _configuration(arm, q))[0], dtype=float), "joint mass matrix")


def _configuration(arm: Arm, q: ArrayLike) -> Kinematics:
    checks.instance(arm, Arm, "arm")
    return forward_kinematics(arm, checks.numbers(q, (arm.joint_count,), "q", StateError))
