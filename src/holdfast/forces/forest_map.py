"""All motions and forces of a chain that is answered as a forest, as an affine set (`affine_map`).

    G qdd = r                                   at grasps, loops and couplings
    (M qdd + h - G^T lambda)_P = 0              for free bodies and joints without a drive
    S (J qdd + b) = s                           for what is asked of a frame
    tau = (M qdd + h - G^T lambda)_A            of the drives

The forces that nothing feels, G^T lambda = 0, are the smallest, as in forward dynamics. Dense, hence O(n^3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.tree.forest_rows import force_metric, turning
from holdfast.dynamics.tree.mechanism_terms import joint_rows
from holdfast.errors import StateError
from holdfast.forces.affine_map import (
    ACCELERATION_SCALE,
    SMALLEST_FORCE_SCALE,
    AccelerationMap,
    AccelerationTask,
    GraspPlace,
    lost_directions,
    solutions,
)
from holdfast.forces.forest_equations import ForestEquations
from holdfast.forces.forest_task import NamedTask, on_accelerations
from holdfast.model import checks
from holdfast.spatial.scalar import Array

MENTIONED = 1e-6  # smaller shares of a direction are not mentioned


class ScaledForest(NamedTuple):
    """The equations E v = e for v / scales.

    Attributes:
        E: (rows, m).
        e: (rows,).
        scales: (m,) size of each unknown.
        task: the rows of what is asked, the last ones.
        unfelt: number of independent forces that nothing feels.
    """

    E: Array
    e: Array
    scales: Array
    task: slice
    unfelt: int


def forest_map(of: ForestEquations, asked: list[NamedTask], force: float) -> AccelerationMap:
    """Return all motions and forces with the asked accelerations. O(n^3).

    Args:
        of: the equations.
        asked: what is asked exactly.
        force: F0 [N], `forest_force`.

    Raises:
        StateError: the chain cannot have these accelerations.
    """
    scaled = _scaled(of, on_accelerations(of, asked), force)
    return _map(of, _solved(of, scaled, scaled.e, asked), scaled, force)


def scaled_forest_map(
    of: ForestEquations, asked: list[NamedTask], force: float, *, payload: bool = False
) -> tuple[AccelerationMap, Array]:
    """Return the map at sigma = 0, and the change of v0 per unit of sigma; see `forest_map`.

    What is asked is multiplied by sigma; or, with `payload`, the inertia of the only object.

    Raises:
        StateError: the chain cannot have these accelerations, or some of that of the payload is not asked.
    """
    held = asked if payload else [one._replace(values=0.0 * one.values) for one in asked]
    scaled = _scaled(of, on_accelerations(of, held), force)
    e, change = scaled.e.copy(), np.zeros(len(scaled.e))
    if payload:
        part, alpha = _payload(of, asked)
        rows = len(of.G) + np.searchsorted(np.flatnonzero(of.passive), np.arange(part.start, part.stop))
        size = np.repeat([1.0 / float(force_metric(of.motion).length), 1.0], 3) / force
        weight = of.M[part, part] @ alpha + of.h[part] + of.pushed[part]
        scaled.E[rows, part] = 0.0  # alpha is asked
        e[rows], change[rows] = size * of.pushed[part], -size * weight
    else:
        change[scaled.task] = np.concatenate([np.zeros(0), *(one.values for one in asked)])
    v1, _ = _solved(of, scaled, change, asked)
    return _map(of, _solved(of, scaled, e, asked), scaled, force), v1


def _payload(of: ForestEquations, asked: list[NamedTask]) -> tuple[slice, Array]:
    """Return the place of the only object's acceleration, and that acceleration, (6,)."""
    objects = of.chain.as_forest.objects
    if len(objects) != 1:
        raise StateError(f"payload: expected False in a chain with {len(objects)} objects; True is for one")
    (name, k), task = *objects.items(), {one.name: one for one in asked}
    if name not in task:
        raise StateError(f"acceleration: expected that of '{name}' for its payload")
    return of.motion.forest.velocities[k], np.linalg.pinv(task[name].rows) @ task[name].values


def forest_force(of: ForestEquations, asked: list[NamedTask]) -> float:
    """Return F0, the size of the wrenches that the objects need, with moments divided by L, at least 1 N.

    Without objects it is the weight of all bodies.
    """
    motion, length = of.motion, float(force_metric(of.motion).length)
    alpha = {one.name: np.linalg.pinv(one.rows) @ one.values for one in asked if len(one.rows)}
    needed = [np.zeros(0)]
    for name, k in of.chain.as_forest.objects.items():
        part = motion.forest.velocities[k]
        wrench = of.M[part, part] @ alpha.get(name, np.zeros(6)) + of.h[part]
        needed.append(wrench / np.repeat([length, 1.0], 3))
    if len(needed) == 1:
        needed.append(sum(body.link.mass for body in motion.forest.bodies) * motion.forest.gravity)
    return max(SMALLEST_FORCE_SCALE, float(np.linalg.norm(np.concatenate(needed))))


def _scaled(of: ForestEquations, asked: AccelerationTask, force: float) -> ScaledForest:
    """Return the equations in scaled unknowns."""
    motion, n, count = of.motion, of.size, len(of.G)
    metric, turns = force_metric(motion), np.array(turning(motion))
    length, size = float(metric.length), n + count
    none = of.unfelt_rows()
    free = np.where(turns, ACCELERATION_SCALE / length, ACCELERATION_SCALE)
    forces = np.array(
        [x for c in motion.closures for x in c.contact.grasp.of_kind.row_scales(length)]
        + [1.0 / np.sqrt(float(x)) for x in metric.couplings]
    )
    E = np.zeros((count + int(of.passive.sum()) + len(none) + len(asked.rows), size))
    closed, carried, unfelt, task = np.split(E, np.cumsum([count, int(of.passive.sum()), len(none)]))
    closed[:, :n] = of.G
    carried[:] = np.hstack([of.M, -of.G.T])[of.passive]
    unfelt[:, n:] = none
    task[:, :n] = asked.rows
    e = np.concatenate([of.r, -of.h[of.passive], np.zeros(len(none)), asked.values])
    scales = np.concatenate([free, force * forces])
    loads = np.where(turns, 1.0 / length, 1.0)[of.passive] / force
    each = np.concatenate([forces / ACCELERATION_SCALE, loads, np.ones(len(none)), np.ones(len(task))])
    return ScaledForest(each[:, None] * E * scales, each * e, scales, slice(len(E) - len(task), len(E)), len(none))


def _map(of: ForestEquations, found: tuple[Array, Array], scaled: ScaledForest, force: float) -> AccelerationMap:
    chain, joints, n = of.chain, joint_rows(of.chain), of.size
    T, t = np.hstack([of.M, -of.G.T])[joints], of.h[joints].copy()
    T[of.passive[joints]], t[of.passive[joints]] = 0.0, 0.0
    grasps = tuple(
        GraspPlace(key, c.contact, slice(n + at.start, n + at.stop), i)
        for key, i in chain.as_forest.closures.items()
        for c, at in ((of.motion.closures[i], of.rows.closures[i]),)
    )
    length, wanted = float(force_metric(of.motion).length), slice(0, n)
    return AccelerationMap(chain, grasps, *found, T, t, length, force, scaled.unfelt, len(grasps), wanted)


def _solved(of: ForestEquations, scaled: ScaledForest, e: Array, asked: list[NamedTask]) -> tuple[Array, Array]:
    """Return one solution of the equations and a basis of the others.

    Raises:
        StateError: there is none.
    """
    found = solutions(scaled.E, e, scaled.scales)
    if found is None:
        raise _impossible(of, scaled, e, asked)
    return found


def _impossible(of: ForestEquations, scaled: ScaledForest, e: Array, asked: list[NamedTask]) -> StateError:
    """Return the error for accelerations that the chain cannot have, naming frames and directions that are lost."""
    before = slice(0, scaled.task.start)
    if solutions(scaled.E[before], e[before], scaled.scales) is None:
        return StateError(
            "acceleration: expected a state in which some accelerations satisfy all grasps, loops and couplings, and"
            " what has no drive is carried; got one without. Try holdfast.diagnose, or a drive (actuated=True)"
        )
    _, lost = lost_directions(scaled.E, scaled.task, slice(0, of.size), scaled.scales)
    each = [*zip(asked, np.split(lost, np.cumsum([len(one.rows) for one in asked])[:-1]), strict=True)]
    whole = [one.name for one, x in each if np.sum(x * x) > len(x) - MENTIONED]  # of which every row is lost
    listed = [f"the acceleration of '{name}' at all" for name in whole]
    for j in range(lost.shape[1]):
        named = [
            f"the acceleration of '{one.name}' along {checks.place(d)}"
            for one, x in each
            if one.name not in whole and np.abs(d := x[:, j] @ one.rows).max(initial=0.0) > MENTIONED
        ]
        listed += [" with ".join(named)] if named else []
    why = f"it cannot change {'; '.join(listed)}" if listed else "the velocities of this state demand others"
    return StateError(
        f"acceleration: expected one that the chain can have in this state; {why}. Try task=, which leaves directions"
        " free, another posture, or holdfast.diagnose"
    )
