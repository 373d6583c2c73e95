"""All accelerations, grasp wrenches and torques that fit a chain's state: v = v0 + N x, tau = T v + t.

The unknowns v are the accelerations of a floating base and of all joints, that of the object, and the transmitted
components lambda of the grasp wrenches, f_i = K_i^T lambda_i. They satisfy

    K_i (J_i qdd + Jdot_i qd) = K_i (A_i alpha + a_i - g_i)                   at every grasp
    sum A_i^T K_i^T lambda_i = M(C) (alpha - [0; g]) + b(C) - w               for the object
    (M qdd + C + J^T K^T lambda)_base = 0                                     for a floating base, which has no drive
    S alpha = s                                                               for what is asked of the object

Contacts of the object with the world add their forces to the object's balance, see `touched_object`.

Dense, hence O(n^3), for every chain: trunks, floating bases, redundant joints, singular postures. The wrenches of
bushings and springs and the torques of dampers and joint springs are known, and part of C, b and w.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, needed_wrench, pseudo_gravity
from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.dynamics.constraint import ConstraintRows, constraint_rows, free_wrenches, length_scale
from holdfast.dynamics.inverse import trunk_torques
from holdfast.dynamics.trunk.whole_chain import whole_chain
from holdfast.errors import StateError
from holdfast.forces.affine_map import (
    ACCELERATION_SCALE,
    SMALLEST_FORCE_SCALE,
    UNREACHED,
    AccelerationMap,
    AccelerationTask,
    GraspPlace,
    lost_directions,
    solutions,
)
from holdfast.forces.touched_object import TouchedObject, undetermined
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State


def asked_rows(task: ArrayLike | None) -> Array:
    """Return the checked rows (r, 6) of what is asked of an object; all six for None.

    Raises:
        StateError: the shape is wrong.
    """
    rows = np.eye(6) if task is None else checks.numbers(task, None, "task", StateError)
    if rows.ndim != 2 or rows.shape[1] != 6:
        raise StateError(f"task: expected shape (r, 6), got shape {rows.shape}")
    return rows


class WorldForces(NamedTuple):
    """The forces of the world on the object, and what is asked of them.

    Attributes:
        touched: the contacts.
        rows: (r, size) rows on the unknown forces.
        values: (r,) their values [N].
    """

    touched: TouchedObject
    rows: Array
    values: Array


class ScaledEquations(NamedTuple):
    """The equations E v = e in scaled unknowns and rows, and the unscaled map to torques.

    Attributes:
        E: (rows, m) matrix for v / scales.
        e: (rows,) right side.
        scales: (m,) size of each unknown.
        object_rows: the rows of the object's balance, whose scale is `row_scale`.
        row_scale: (6,) factor of these rows.
        task_rows: the rows of what is asked.
        T: (n, m).
        t: (n,).
        unfelt: number of independent forces that no joint feels; rows make them zero or smallest.
        touched: the contacts with the world, if any.
        demands: the rows of what is asked of their forces.
    """

    E: Array
    e: Array
    scales: Array
    object_rows: slice
    row_scale: Array
    task_rows: slice
    T: Array
    t: Array
    unfelt: int
    touched: TouchedObject | None
    demands: slice


def motion_without_torques(chain: ClosedChain, state: State, inputs: Inputs) -> ChainMotion:
    """Return the chain's motion for shaped inputs, of which the torques are asked."""
    return chain_motion(chain, state, np.zeros(chain.joint_count), inputs)


def force_scale(motion: ChainMotion, alpha: Array) -> float:
    """Return F0, the size of the needed wrench with moments divided by L, at least 1 N."""
    length = length_scale([c.offset for c in motion.contacts])
    return max(SMALLEST_FORCE_SCALE, float(np.linalg.norm(needed_wrench(motion, alpha) / np.repeat([length, 1.0], 3))))


def acceleration_map(
    motion: ChainMotion,
    asked: AccelerationTask,
    *,
    free_unfelt: bool = False,
    force: float | None = None,
    world: WorldForces | None = None,
) -> AccelerationMap:
    """Return all motions and wrenches with the asked acceleration. O(n^3).

    Args:
        motion: the chain's motion without torques.
        asked: what is asked of the object.
        free_unfelt: whether wrenches that no joint feels and that do not move the object may be chosen; otherwise they
            are the smallest, as in forward dynamics.
        force: F0 [N]; by default `force_scale` for the asked acceleration.
        world: the forces of the world on the object; None without.

    Raises:
        StateError: the arms cannot give the object this acceleration.
    """
    force = force_scale(motion, asked.smallest) if force is None else force
    equations = _equations(motion, asked, force, free_unfelt, world)
    v0, N = _solved(equations, equations.e, motion)
    return _map(motion, v0, N, equations, force)


def scaled_map(
    motion: ChainMotion,
    held: AccelerationTask,
    more: Array,
    *,
    payload: bool = False,
    free_unfelt: bool = False,
    force: float | None = None,
    world: WorldForces | None = None,
) -> tuple[AccelerationMap, Array]:
    """Return the map for sigma = 0, and the change of v0 per unit of sigma, (m,).

    The object's acceleration is `held` + sigma `more`; or, with `payload`, its inertia is multiplied by sigma at the
    acceleration `held`, all of which is asked then.

    Args:
        motion: the chain's motion without torques.
        held: what is asked at sigma = 0.
        more: (r,) change of the asked values per sigma.
        payload: whether sigma multiplies the object's inertia.
        free_unfelt: as in `acceleration_map`.
        force: F0 [N]; by default `force_scale` for sigma = 1.
        world: as in `acceleration_map`.

    Raises:
        StateError: the arms cannot give the object these accelerations.
    """
    force = force_scale(motion, held._replace(values=held.values + more).smallest) if force is None else force
    equations = _equations(motion, held, force, free_unfelt, world)
    e, change = equations.e.copy(), np.zeros_like(equations.e)
    change[equations.task_rows] = more
    if payload:
        body, rows = motion.body, equations.object_rows
        weight = body.inertia.apply(held.smallest - pseudo_gravity(motion.chain)) + body.bias
        equations.E[rows, motion.chain.velocity_count - 6 : motion.chain.velocity_count] = 0.0  # alpha is asked
        e[rows], change[rows] = -equations.row_scale * body.wrench, equations.row_scale * weight
    v0, N = _solved(equations, e, motion)
    v1, _ = _solved(equations, change, motion)
    return _map(motion, v0, N, equations, force), v1


def _map(motion: ChainMotion, v0: Array, N: Array, equations: ScaledEquations, force: float) -> AccelerationMap:
    chain, length = motion.chain, float(length_scale([c.offset for c in motion.contacts]))
    alpha = slice(chain.velocity_count - 6, chain.velocity_count)
    ends = alpha.stop + np.cumsum([0, *(len(c.rows) for c in motion.contacts)])
    grasps = tuple(
        GraspPlace(name, c, slice(int(a), int(b)), chain.names.index(name), motion.arms[name].known)
        for name, c, (a, b) in zip(chain.grasps, motion.contacts, pairwise(ends), strict=True)
    )
    rows = len(chain.arms)
    return AccelerationMap(
        chain,
        grasps,
        v0,
        N,
        equations.T,
        equations.t,
        length,
        force,
        equations.unfelt,
        rows,
        alpha,
        equations.touched,
    )


def _equations(
    motion: ChainMotion, asked: AccelerationTask, force: float, free_unfelt: bool, world: WorldForces | None
) -> ScaledEquations:
    chain, rows = motion.chain, constraint_rows(motion)
    touched = None if world is None else world.touched
    pressed = 0 if touched is None else touched.size
    length = float(length_scale([c.offset for c in motion.contacts]))
    floating = 6 if chain.floats else 0
    first = floating + chain.joint_count
    count, size = len(rows.joints), first + 6 + len(rows.joints) + pressed
    of_grasps, of_world = slice(first + 6, first + 6 + count), slice(size - pressed, size)
    M, bias, base = _masses(motion)
    of_arms = np.hstack([rows.base, rows.joints])

    to_torques = np.zeros((first, size))
    to_torques[:, :first], to_torques[:, of_grasps] = M, of_arms.T
    per_moment = np.repeat([1.0 / length, 1.0], 3) / force
    per_row = np.array([1.0 / scale for c in motion.contacts for scale in c.grasp.of_kind.row_scales(length)])

    grasped = np.hstack([of_arms, rows.object, np.zeros((count, count + pressed))])
    balance = np.zeros((6, size))
    body = motion.body
    balance[:, first : first + 6] = -body.inertia.dense()
    balance[:, of_grasps] = -rows.object.T
    if touched is not None:
        balance[:, of_world] = touched.to_object
    task = np.zeros((len(asked.rows), size))
    task[:, first : first + 6] = asked.rows
    parts = [
        (grasped / per_row[:, None] / ACCELERATION_SCALE, _tip_terms(motion) / per_row / ACCELERATION_SCALE),
        (per_moment[:, None] * balance, per_moment * needed_wrench(motion, np.zeros(6))),
        (per_moment[:floating, None] * to_torques[:floating], -per_moment[:floating] * base),
        (task, asked.values),
    ]
    unfelt = 0
    if not free_unfelt and count:
        parts.append(_least_unfelt(motion, length, size, of_grasps))
        unfelt = len(parts[-1][1])
    if world is not None:
        more, shared = _of_world(motion, world, rows, (per_moment, per_row, force), (first, of_world))
        unfelt += len(more[1][1]) + shared
        parts += more
    ends = np.cumsum([0, *(len(e) for _, e in parts)])
    angular = [ACCELERATION_SCALE / length] * 3 + [ACCELERATION_SCALE] * 3
    joints = [ACCELERATION_SCALE / length if joint.turns else ACCELERATION_SCALE for joint in chain.all_joints]
    scales = np.array([*angular[:floating], *joints, *angular, *(force / per_row), *[force] * pressed])
    return ScaledEquations(
        np.vstack([E for E, _ in parts]) * scales,
        np.concatenate([e for _, e in parts]),
        scales,
        slice(int(ends[1]), int(ends[2])),
        per_moment,
        slice(int(ends[3]), int(ends[4])),
        to_torques[floating:],
        bias,
        unfelt,
        touched,
        slice(int(ends[-1]) - (0 if world is None else len(world.values)), int(ends[-1])),
    )


def _of_world(
    motion: ChainMotion,
    world: WorldForces,
    rows: ConstraintRows,
    units: tuple[Array, Array, float],
    places: tuple[int, slice],
) -> tuple[list[tuple[Array, Array]], int]:
    """Return the equations that contacts with the world add, and the number of ways in which they share a wrench.

    They are for modes that are kept, for forces that no torque decides, and for what is asked of the forces.

    Args:
        motion: the chain's motion.
        world: the forces of the world.
        rows: the grasps' rows.
        units: factors of the object's balance (6,) and of grasp wrenches (rows,), and F0.
        places: the first unknown of the object's acceleration, and the unknowns of the world's forces.
    """
    (per_moment, per_row, force), (first, of_world) = units, places
    touched, size = world.touched, of_world.stop
    kept, values = touched.kept_rows
    keeps = np.zeros((len(kept), size))
    keeps[:, first : first + 6] = kept
    by_joints = np.hstack([rows.base, rows.joints]).T / per_row
    by_joints /= np.maximum(np.linalg.norm(by_joints, axis=1, keepdims=True), 1e-300)
    of_object = force * per_moment[:, None] * np.hstack([-rows.object.T / per_row, touched.to_object])
    felt = np.vstack([np.hstack([by_joints, np.zeros((len(by_joints), touched.size))]), of_object])
    smallest, shared = undetermined(touched, felt)
    least, asked = np.zeros((len(smallest), size)), np.zeros((len(world.values), size))
    least[:, of_world], asked[:, of_world] = smallest / force, world.rows / force
    return [
        (keeps / ACCELERATION_SCALE, values / ACCELERATION_SCALE),
        (least, np.zeros(len(least))),
        (asked, world.values / force),
    ], shared


def _masses(motion: ChainMotion) -> tuple[Array, Array, Array]:
    """Return the mass matrix for [base; joints], the torques without accelerations, and the base's wrench then."""
    chain = motion.chain
    still, none = np.zeros(chain.joint_count), np.zeros((len(chain.arms), 6))
    found = trunk_torques(motion, still, none, np.zeros(6) if chain.floats else None)
    return whole_chain(motion).M, found.tau, found.base[: 6 if chain.floats else 0]


def _tip_terms(motion: ChainMotion) -> Array:
    """Return K (a - g - Jdot qd) of all grasps, the right sides of the grasp equations."""
    terms = [np.zeros(0)]
    for name, c in zip(motion.chain.grasps, motion.contacts, strict=True):
        free_fall = shift_twist(c.offset, -pseudo_gravity(motion.chain))
        terms.append(c.K @ (free_fall + c.a - c.g - motion.arms[name].bias.tip_acceleration))
    return np.concatenate(terms)


def _least_unfelt(motion: ChainMotion, length: float, size: int, of_grasps: slice) -> tuple[Array, Array]:
    """Return rows that make the wrenches without effect zero, in the metric of the force split."""
    unfelt = free_wrenches(motion, length)
    metric = np.tile(np.repeat([length**-2, 1.0], 3), len(motion.contacts))
    K = block_diagonal([c.K for c in motion.contacts])
    rows = np.zeros((unfelt.shape[1], size))
    rows[:, of_grasps] = (metric[:, None] * unfelt).T @ K.T
    return rows, np.zeros(len(rows))


def _solved(equations: ScaledEquations, e: Array, motion: ChainMotion) -> tuple[Array, Array]:
    """Return one solution of the equations and a basis of the others.

    Raises:
        StateError: there is none.
    """
    found = solutions(equations.E, e, equations.scales)
    if found is None:
        raise _impossible(equations, motion)
    return found


def _impossible(equations: ScaledEquations, motion: ChainMotion) -> StateError:
    """Return the error for an acceleration that the arms cannot give, naming arms and directions that are lost."""
    demands = equations.demands
    others = np.delete(equations.E, np.r_[demands], axis=0), np.delete(equations.e, np.r_[demands])
    if demands.stop > demands.start and solutions(*others, equations.scales) is not None:
        return StateError(
            "normal_force: expected forces that the torques can change in this posture with this acceleration, got"
            " others. Try fewer contacts, forces that can balance each other, or limits: least_normal, most_normal"
        )
    chain, rows = motion.chain, constraint_rows(motion)
    stuck = [
        f"arm '{name}' in {lost} of {len(c.rows)} directions"
        for name, c, part in zip(chain.grasps, motion.contacts, rows.slices, strict=True)
        if (lost := len(c.rows) - _rank(np.hstack([rows.joints, rows.base])[part]))
    ]
    alpha = slice(chain.velocity_count - 6, chain.velocity_count)
    directions, _ = lost_directions(equations.E, equations.task_rows, alpha, equations.scales)
    listed = ", ".join(f"[omega_dot; v_dot] = {checks.place(d)}" for d in directions)
    if not chain.grasps:
        why = "no arm holds it"
    elif not directions:
        why = "the velocities of this state demand others"
    else:
        immobile = f": {', '.join(stuck)} cannot move" if stuck else ""
        why = f"they cannot change it along {listed}{immobile}"
    if equations.touched is not None and equations.touched.kept and equations.touched.places:
        why += f"; contacts with the world stay as they are: {', '.join(x.name for x in equations.touched.places[:4])}"
    return StateError(
        f"acceleration: expected one that the arms can give the object in this state; {why}. Try task=, which leaves"
        " directions free, another posture, or holdfast.diagnose"
    )


def _rank(rows: Array) -> int:
    s = np.linalg.svd(rows, compute_uv=False)
    return int((s > UNREACHED * s.max(initial=0.0)).sum())
