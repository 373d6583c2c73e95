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
from holdfast.dynamics.closed.measurement import ANGULAR, Measurement, size_at_centre
from holdfast.dynamics.closed.object_filter import LEAST_MOBILE, by_rows, own_size
from holdfast.dynamics.closed.object_motion import FreeBody, acceleration_at_C, object_motion
from holdfast.dynamics.closed.rigid_step import last_rigid_step, rigid_step
from holdfast.dynamics.closed.row_steps import row_steps
from holdfast.model.checks import ROTATION_TOLERANCE
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, minimum, sqrt, where
from holdfast.spatial.spatial_vector import shift_wrench

DENSE = {"P": (upper_count(6),)}
FACTORS = {"D": (6,), "w": (6, 6)}
SIZES = {"kept": (), "weakest": (), "own": (3,), "size": (3,)}
SEEN_RIGID = {"noise": (upper_count(6),), "measured": (6,), "extent": (4,)}


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
        body = object_motion(held, frame, twist, np.zeros(6)).free
        return (frame.R, body.centripetal, body.acceleration, freedoms, 1.0, *_beginning(body, dense))

    return stage(
        "object",
        text,
        [
            {"object_mass": (), "object_com": (3,), "object_inertia": (3, 3)},
            {"object_pose": (7,), "object_twist": (6,)},
        ],
        [(), ("R", "centripetal", "x'", "kept'", "weakest'", *_begun(dense))],
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
        body = object_motion(held, frame, none, none).free
        return (frame.R, body.centripetal, none, 0.0, 1.0, none, *_beginning(body, dense))

    within: list[dict[str, Shape]] = [
        {"object_mass": (), "object_com": (3,), "object_inertia": (3, 3)},
        {"object_pose": (7,)},
    ]
    found = ("R", "centripetal", "x'", "kept'", "weakest'", "no_wrench")
    return stage("resting_object", text, within, [(), (*found, *_begun(dense))])


def _beginning(body: FreeBody, dense: bool) -> tuple[Array, ...]:
    """Return where the mass centre is, how mobile object and arms are at the least, and the mobility to begin with."""
    start = (upper(body.mobility.dense()),) if dense else (array(body.D), array(body.w))
    return body.centre, own_size(body), LEAST_MOBILE * own_size(body), *start


def _begun(dense: bool) -> tuple[str, ...]:
    return ("centre", "own", "size'", *(f"{k}'" for k in _mobility(dense)))


def most_mobile() -> Stage:
    """Return the stage that takes one more arm into the size of the most mobile one."""

    def text(size: Array, extent: Array) -> tuple[Array]:
        return (maximum(size, size_at_centre(extent)),)

    return stage("most_mobile", text, [{"size": (3,), "extent": (4,)}], [("size'",)])


def rigid_arm() -> Stage:
    """Return the stage of one rigid grasp in the filter: out with x and P, back with s."""

    def text(x: Array, P: Array, kept: Array, weakest: Array, own: Array, size: Array, *seen: Array) -> Phases:
        m, size = rigid_measurement(*seen), minimum(own, size)
        x, P, step = rigid_step(x, symmetric(P), m, size)
        after = minimum(size, size_at_centre(m.extent))
        (s,) = yield x, upper(P), kept[()] + step.kept, minimum(weakest[()], step.weakest), after
        from_arm = step.back(s)
        return s + from_arm, from_arm

    given = {"x": (6,)} | DENSE | SIZES | SEEN_RIGID
    outward = ("x'", "P'", "kept'", "weakest'", "size'")
    return stage("rigid_arm", text, [given, {"s": (6,)}], [outward, ("s'", "from_arm")])


def rigid_measurement(noise: Array, measured: Array, extent: Array) -> Measurement:
    """Return the measurement of an arm that holds rigidly."""
    return Measurement(np.eye(6), symmetric(noise), measured, extent, ANGULAR, 6, True)


def rows_arm(kind: str, joint_count: int) -> Stage:
    """Return the stage of one grasp taken by its rows: out with x and the factors of P, back with s."""
    angular = tuple(ANGULAR[i] for i in Grasp(kind).transmitted)  # type: ignore[arg-type]
    count = len(angular)

    def text(
        x: Array, D: Array, w: Array, kept: Array, weakest: Array, own: Array, size: Array, *seen: Array
    ) -> Phases:
        noise, measured, extent, *rows = seen
        C = rows[0] if rows else np.eye(6)
        m = Measurement(C, symmetric(noise, count), measured, extent, angular, joint_count, kind == "rigid")
        x, P, step = row_steps(x, FactoredMobility(list(D), list(w)), m, minimum(own, size))
        (s,) = yield x, array(P.D), array(P.w), kept[()] + step.kept, minimum(weakest[()], step.weakest)
        from_arm = step.back(s)
        return s + from_arm, from_arm

    given: dict[str, tuple[int, ...]] = {"x": (6,)} | FACTORS | SIZES
    seen = {"noise": (upper_count(count),), "measured": (count,), "extent": (4,)}
    rows: dict[str, tuple[int, ...]] = {} if kind == "rigid" else {"rows": (count, 6)}
    return stage(
        f"rows_{kind}",
        text,
        [given | seen | rows, {"s": (6,)}],
        [("x'", "D'", "w'", "kept'", "weakest'"), ("s'", "from_arm")],
    )


def into_factors() -> Stage:
    """Return the stage between the last rigid step and the first rows."""

    def text(P: Array, own: Array, size: Array) -> tuple[Any, ...]:
        found = factored(symmetric(P), by_rows(minimum(own, size)))
        return array(found.D), array(found.w)

    return stage("into_factors", text, [DENSE | {"own": (3,), "size": (3,)}], [("D'", "w'")])


def verdict(rank: Scalar, generic_rank: Scalar, row_count: int) -> Scalar:
    """Return the status of a rank, as `compiled.result` numbers them.

    0: all is unique. 1: the rank is constantly low. 2: it is low, and the generic rank is not
    known (given as -1). 3: it is lower than in general, a singular configuration.
    """
    low = where(generic_rank < 0.0, 2.0, where(rank < generic_rank, 3.0, 1.0))
    return where(rank < float(row_count), low, 0.0)


TURNING = ("alpha", "object_acceleration", "s'", "rank", "status", "condition")
CONSTANTS = {"gravity": (3,), "generic_rank": ()}
ABOUT_CENTRE = {"object_wrench": (6,), "centre": (3,), "centripetal": (3,)}


def last_rigid_arm(row_count: int) -> Stage:
    """Return the stage where the filter turns round at a rigid grasp (`last_rigid_step`)."""

    def text(gravity: Array, generic_rank: Array) -> Phases:
        x, P, kept, weakest, own, size, *seen, w, centre, centripetal = yield ()
        m = rigid_measurement(*seen)
        about = shift_wrench(-centre, w)
        turn = last_rigid_step(x, symmetric(P), m, minimum(own, size), about)
        rank, least = kept[()] + turn.kept, minimum(weakest[()], turn.weakest)
        alpha = acceleration_at_C(centre, centripetal, turn.acceleration)
        return (*_turned(alpha, gravity, about + turn.wrench, rank, generic_rank, row_count, least), turn.wrench)

    given = {"x": (6,)} | DENSE | SIZES | SEEN_RIGID | ABOUT_CENTRE
    return stage("last_rigid_arm", text, [CONSTANTS, given], [(), (*TURNING, "from_arm")])


def turning_point(row_count: int) -> Stage:
    """Return the stage where the filter turns round after rows, or without any arm."""

    def text(gravity: Array, generic_rank: Array) -> Phases:
        x, kept, weakest, D, w, wrench, centre, centripetal = yield ()
        about = shift_wrench(-centre, wrench)
        alpha = x + FactoredMobility(list(D), list(w)).apply(about)
        alpha = acceleration_at_C(centre, centripetal, alpha)
        return _turned(alpha, gravity, about, kept[()], generic_rank, row_count, weakest[()])

    given = {"x": (6,), "kept": (), "weakest": ()} | FACTORS | ABOUT_CENTRE
    return stage("turning_point", text, [CONSTANTS, given], [(), TURNING])


def _turned(
    alpha: Array, gravity: Array, s: Array, rank: Scalar, generic_rank: Array, row_count: int, weakest: Scalar
) -> tuple[Any, ...]:
    """Return what is known where the filter turns round, as `TURNING` names it."""
    acceleration = alpha + concatenate([np.zeros(3), gravity])
    return alpha, acceleration, s, rank, verdict(rank, generic_rank[()], row_count), 1.0 / weakest


def _mobility(dense: bool) -> tuple[str, ...]:
    return tuple(DENSE if dense else FACTORS)
