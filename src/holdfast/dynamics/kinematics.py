"""Kinematics for users: functions of `arm` with checked arguments, and the object's state from the joints (2.8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics, jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.consistency import require_closed
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.model import checks
from holdfast.model.arm import Arm, serial_arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.questions.arrays import Row
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import declare
from holdfast.questions.question import Question, by_arm, of_arms
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, concatenate, each
from holdfast.spatial.spatial_vector import twist_shift
from holdfast.state import Inputs, State, shaped_inputs


class Frames(NamedTuple):
    """Poses of frames in the world.

    Attributes:
        R: (..., 3, 3) rotation matrices from the frames' axes to world axes.
        p: (..., 3) origins of the frames [m].
    """

    R: Array
    p: Array


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
        arm: the arm, which may have branches.
        q: (N,) joint positions in the order of its joints [rad or m]; a spherical joint has four.

    Raises:
        StateError: the number of positions is wrong, or they are not finite.
    """
    checks.instance(arm, Arm, "arm")
    if not arm.is_serial:
        forest = ClosedChain({"arm": arm}).as_forest.forest
        return forest.poses(checks.numbers(q, (forest.position_count,), "q", StateError))
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
    serial_arm(arm, "arm")
    return forward_kinematics(arm, checks.numbers(q, (arm.joint_count,), "q", StateError))


def _each_arm(f: Callable[[Arm, Array], Array], case: VariedCase, arms: Iterable[Arm] | None = None) -> tuple[Array]:
    """Return what a function makes of every arm and its joint positions, one after the other."""
    at = base_kinematics(case.chain, case.state, case.inputs).arms.values() if arms is None else arms
    return (concatenate(each(f, at, [case.state.q[part] for part in case.chain.arm_joints])),)


def _mass_matrices(case: VariedCase) -> tuple[Array]:
    arms = case.chain.arms.values()  # the mass matrix does not depend on where the bases are
    return _each_arm(lambda arm, q: mass_matrix(arm, forward_kinematics(arm, q))[0].ravel(), case, arms)


def _jacobians(case: VariedCase) -> tuple[Array]:
    return _each_arm(lambda arm, q: jacobian(arm, forward_kinematics(arm, q)).ravel(), case)


def _tips(case: VariedCase) -> tuple[Array]:
    return _each_arm(lambda arm, q: _numbers(forward_kinematics(arm, q).tip), case)


def _links(case: VariedCase) -> tuple[Array]:
    return _each_arm(lambda arm, q: concatenate(map(_numbers, link_frames(forward_kinematics(arm, q)))), case)


def _numbers(pose: Pose) -> Array:
    return concatenate([pose.R.ravel(), pose.p])


def _frames(x: Array) -> Frames:
    return Frames(x[..., :9].reshape(*x.shape[:-1], 3, 3), x[..., 9:])


_FRAMES = "axes to world axes by rows, then the origin, frame after frame"

MASS_MATRIX = declare(
    Question(
        "mass_matrix",
        _mass_matrices,
        (
            Row(
                "mass_matrix",
                of_arms(lambda N, _: N * N),
                "kg m^2, kg m, kg",
                "joint mass matrices of the arms, one after the other, by rows",
            ),
        ),
        "the joint mass matrix of every arm, armature included",
        inputs=("q",),
        returns="dict[str, Array]",
        shown=by_arm(lambda N: (N, N)),
    )
)
declare(
    Question(
        "jacobian",
        _jacobians,
        (
            Row(
                "jacobian",
                of_arms(lambda N, _: 6 * N),
                "1, m",
                "Jacobians of the arms' tips, one after the other, by rows",
            ),
        ),
        "the Jacobian of every arm's tip point, [omega; v] = J qd on a base at rest, world axes",
        inputs=("q",),
        parameters=("base_R",),
        depends_on=(),
        returns="dict[str, Array]",
        shown=by_arm(lambda N: (6, N)),
    )
)
declare(
    Question(
        "tip_poses",
        _tips,
        (Row("frame", of_arms(lambda *_: 12), "m", _FRAMES),),
        "the pose of every arm's tip frame in the world",
        inputs=("q",),
        parameters=("base_R", "base_p"),
        depends_on=(),
        returns="dict[str, Frames]",
        shown=by_arm(lambda N: (12,), _frames),
    )
)
declare(
    Question(
        "link_poses",
        _links,
        (Row("frame", of_arms(lambda N, _: 12 * N), "m", _FRAMES),),
        "the poses of every arm's link frames in the world, base to tip; their origins lie on the joints",
        inputs=("q",),
        parameters=("base_R", "base_p"),
        depends_on=(),
        returns="dict[str, Frames]",
        shown=by_arm(lambda N: (N, 12), _frames),
    )
)  # fmt: skip


@np.errstate(all="ignore")  # what overflows is refused
def state_from_joints(
    chain: ClosedChain,
    q: ArrayLike,
    qd: ArrayLike,
    *,
    inputs: Inputs | None = None,
    check: bool = True,
    base_pose: Pose | ArrayLike | None = None,
    base_twist: ArrayLike | None = None,
) -> State:
    """Return the state with the object's pose and twist computed from the joints.

    V(C) = (A^T A)^-1 A^T V(0) (2.8a); the pose follows from the tip of the first grasp. O(n).

    Args:
        chain: a chain with at least one grasp, whose grasps are all rigid.
        q: (n,) joint positions.
        qd: (n,) joint rates.
        inputs: base motion, if the bases move.
        check: refuse joints that violate the grasps.
        base_pose: pose of a trunk's floating base, wxyz_xyz, if there is one.
        base_twist: (6,) twist of its origin, world axes.

    Raises:
        MethodNotApplicable: a grasp is not rigid, or there is none.
        StateError: the joints violate the grasps.
    """
    serial_chain(chain, "chain")
    others = [f"'{name}' is a {grasp.kind} grasp" for name, grasp in chain.grasps.items() if grasp.free]
    if others or not chain.grasps:
        raise MethodNotApplicable(
            f"state_from_joints: needs rigid grasps, but {'; '.join(others[:3]) or 'there is none'}; give the object's"
            " pose, or try holdfast.close"
        )
    given = shaped_inputs(chain, inputs)
    start = State(q, qd, np.r_[1.0, np.zeros(6)], base_pose=base_pose, base_twist=base_twist)
    start.fits(chain)
    arms = chain_motion(chain, start, np.zeros(chain.joint_count), given).arms
    tips = {name: (arms[name].at.tip, arms[name].tip_twist) for name in chain.grasps}
    (first, (tip, _)), *_ = tips.items()
    pose = tip @ chain.grasps[first].frame.inverse()
    A = np.concatenate([twist_shift(pose.R @ grasp.frame.p) for grasp in chain.grasps.values()])
    V = np.concatenate([twist for _, twist in tips.values()])
    checks.finite(np.append(A, V), "state_from_joints")
    state = replace(start, object_pose=pose.wxyz_xyz, object_twist=np.linalg.lstsq(A, V, rcond=None)[0])
    if check:
        require_closed(chain_motion(chain, state, np.zeros(chain.joint_count), given), state)
    return state
