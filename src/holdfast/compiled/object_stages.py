"""The object's filter as stages: the object itself, then arm after arm, out and back."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from holdfast.compiled.arm_stages import Phases
from holdfast.compiled.packing import symmetric, upper, upper_count
from holdfast.compiler.program import Shape
from holdfast.compiler.stage import Stage, stage
from holdfast.dynamics.closed.factored_mobility import FactoredMobility, factored
from holdfast.dynamics.closed.measurement import LIGHTEST_OBJECT, Measurement, object_share
from holdfast.dynamics.closed.object_motion import object_motion
from holdfast.dynamics.closed.rigid_step import last_rigid_step, rigid_step
from holdfast.dynamics.closed.row_steps import row_steps
from holdfast.model.checks import ROTATION_TOLERANCE
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, minimum, sqrt, where

DENSE = {"P": (upper_count(6),)}
FACTORS = {"D": (6,), "w": (6, 6)}


def unit_pose(wxyz_xyz: Array, unused: Iterable[Scalar] = ()) -> Pose:
    """Return a pose; not-a-number if its quaternion is not of unit length within 1e-6.

    So it is where its origin, or what else is not needed, is not finite: no result would tell.
    """
    length = sqrt(wxyz_xyz[:4] @ wxyz_xyz[:4])
    length = where(abs(length - 1.0) <= ROTATION_TOLERANCE, length, float("nan"))
    for x in (*wxyz_xyz[4:], *unused):
        length = where(abs(x) < float("inf"), length, float("nan"))
    return Pose.unchecked(rotation.from_quaternion(wxyz_xyz[:4] / length), wxyz_xyz[4:])


def held_object(dense: bool, freedoms: int) -> Stage:
    """Return the stage of the object alone: where the filter begins.

    Args:
        dense: whether the mobility begins as a matrix, for a rigid step, or in factors.
        freedoms: contact freedoms, which count as rank from the start.
    """

    def text(mass: Scalar, com: Array, inertia: Array) -> Phases:
        held = HeldObject(mass[()], inertia, com, physical=False)
        pose, twist = yield ()
        frame = unit_pose(pose, twist[3:])
        body = object_motion(held, frame, twist, np.zeros(6))
        mobility = body.mobility.dense()
        size = np.diag(mobility)
        D, w = body.mobility_factors
        start = (upper(mobility),) if dense else (array(D), array(w))
        return (frame.R, upper(mobility), size, body.free_acceleration, freedoms, 1.0, LIGHTEST_OBJECT, *start)

    return stage(
        "object",
        text,
        [
            {"object_mass": (), "object_com": (3,), "object_inertia": (3, 3)},
            {"object_pose": (7,), "object_twist": (6,)},
        ],
        [(), ("R", "mobility", "size", "x'", "kept'", "weakest'", "share'", *(f"{k}'" for k in _mobility(dense)))],
    )


def resting_object(dense: bool) -> Stage:
    """Return the stage of the object alone in a projection: at rest, with nothing acting on it.

    Args:
        dense: whether the mobility begins as a matrix, for a rigid step, or in factors.
    """

    def text(mass: Scalar, com: Array, inertia: Array) -> Phases:
        held = HeldObject(mass[()], inertia, com, physical=False)
        (pose,) = yield ()
        none = np.zeros(6)
        frame = Pose.unchecked_seven(pose)
        body = object_motion(held, frame, none, none)
        mobility = body.mobility.dense()
        D, w = body.mobility_factors
        start = (upper(mobility),) if dense else (array(D), array(w))
        return (frame.R, upper(mobility), np.diag(mobility), none, 0.0, 1.0, LIGHTEST_OBJECT, none, *start)

    within: list[dict[str, Shape]] = [
        {"object_mass": (), "object_com": (3,), "object_inertia": (3, 3)},
        {"object_pose": (7,)},
    ]
    found = ("R", "mobility", "size", "x'", "kept'", "weakest'", "share'", "no_wrench")
    return stage("resting_object", text, within, [(), (*found, *(f"{k}'" for k in _mobility(dense)))])


def share() -> Stage:
    """Return the stage that takes one more arm into the scale of pivots."""
    return stage(
        "share", lambda share, ratio: (object_share(share[()], ratio[()]),), [{"share": (), "ratio": ()}], [("share'",)]
    )


def rigid_arm() -> Stage:
    """Return the stage of one rigid grasp in the filter: out with x and P, back with s."""

    def text(x: Array, P: Array, kept: Array, weakest: Array, share: Array, *seen: Array) -> Phases:
        noise, measured, size = seen
        R = symmetric(noise)
        m = Measurement(np.eye(6), R, measured, size, 6, True)
        x, P, step = rigid_step(x, symmetric(P), m, np.diag(R) + share[()] * size)
        (s,) = yield x, upper(P), kept[()] + step.kept, minimum(weakest[()], step.weakest)
        from_arm = step.back(s)
        return s + from_arm, from_arm

    given = {"x": (6,)} | DENSE | {"kept": (), "weakest": (), "share": ()}
    seen = {"noise": (upper_count(6),), "measured": (6,), "size": (6,)}
    return stage(
        "rigid_arm", text, [given | seen, {"s": (6,)}], [("x'", "P'", "kept'", "weakest'"), ("s'", "from_arm")]
    )


def rows_arm(kind: str, joint_count: int) -> Stage:
    """Return the stage of one grasp taken by its rows: out with x and the factors of P, back with s."""
    count = len(Grasp(kind).transmitted)  # type: ignore[arg-type]

    def text(x: Array, D: Array, w: Array, kept: Array, weakest: Array, share: Array, *seen: Array) -> Phases:
        noise, measured, size, *rows = seen
        R = symmetric(noise, count)
        C = rows[0] if rows else np.eye(6)
        m = Measurement(C, R, measured, size, joint_count, kind == "rigid")
        x, P, step = row_steps(x, FactoredMobility(list(D), list(w)), m, np.diag(R) + share[()] * size)
        (s,) = yield x, array(P.D), array(P.w), kept[()] + step.kept, minimum(weakest[()], step.weakest)
        from_arm = step.back(s)
        return s + from_arm, from_arm

    given: dict[str, tuple[int, ...]] = {"x": (6,)} | FACTORS | {"kept": (), "weakest": (), "share": ()}
    seen = {"noise": (upper_count(count),), "measured": (count,), "size": (count,)}
    rows: dict[str, tuple[int, ...]] = {} if kind == "rigid" else {"rows": (count, 6)}
    return stage(
        f"rows_{kind}",
        text,
        [given | seen | rows, {"s": (6,)}],
        [("x'", "D'", "w'", "kept'", "weakest'"), ("s'", "from_arm")],
    )


def into_factors() -> Stage:
    """Return the stage between the last rigid step and the first rows."""

    def text(P: Array) -> tuple[Any, ...]:
        found = factored(symmetric(P))
        return array(found.D), array(found.w)

    return stage("into_factors", text, [DENSE], [("D'", "w'")])


def verdict(rank: Scalar, generic_rank: Scalar, row_count: int) -> Scalar:
    """Return the status of a rank, as `compiled.result` numbers them.

    0: all is unique. 1: the rank is constantly low. 2: it is low, and the generic rank is not
    known (given as -1). 3: it is lower than in general, a singular configuration.
    """
    low = where(generic_rank < 0.0, 2.0, where(rank < generic_rank, 3.0, 1.0))
    return where(rank < float(row_count), low, 0.0)


TURNING = ("alpha", "object_acceleration", "s'", "rank", "status", "condition")
CONSTANTS = {"gravity": (3,), "generic_rank": ()}


def last_rigid_arm(row_count: int) -> Stage:
    """Return the stage where the filter turns round at a rigid grasp (`last_rigid_step`)."""

    def text(gravity: Array, generic_rank: Array) -> Phases:
        x, P, kept, weakest, share, noise, measured, size, w = yield ()
        R = symmetric(noise)
        m = Measurement(np.eye(6), R, measured, size, 6, True)
        turn = last_rigid_step(x, symmetric(P), m, np.diag(R) + share[()] * size, w)
        alpha, rank = turn.acceleration, kept[()] + turn.kept
        return (
            alpha,
            alpha + concatenate([np.zeros(3), gravity]),
            w + turn.wrench,
            rank,
            verdict(rank, generic_rank[()], row_count),
            1.0 / minimum(weakest[()], turn.weakest),
            turn.wrench,
        )

    given = {"x": (6,)} | DENSE | {"kept": (), "weakest": (), "share": ()}
    seen = {"noise": (upper_count(6),), "measured": (6,), "size": (6,), "object_wrench": (6,)}
    return stage("last_rigid_arm", text, [CONSTANTS, given | seen], [(), (*TURNING, "from_arm")])


def turning_point(row_count: int) -> Stage:
    """Return the stage where the filter turns round after rows, or without any arm."""

    def text(gravity: Array, generic_rank: Array) -> Phases:
        x, kept, weakest, wrench, D, w = yield ()
        alpha = x + FactoredMobility(list(D), list(w)).apply(wrench)
        rank = kept[()]
        status = verdict(rank, generic_rank[()], row_count)
        return alpha, alpha + concatenate([np.zeros(3), gravity]), wrench, rank, status, 1.0 / weakest[()]

    given = {"x": (6,), "kept": (), "weakest": (), "object_wrench": (6,)} | FACTORS
    return stage("turning_point", text, [CONSTANTS, given], [(), TURNING])


def _mobility(dense: bool) -> tuple[str, ...]:
    return tuple(DENSE if dense else FACTORS)
