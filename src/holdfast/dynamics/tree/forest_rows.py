"""The constraint of a forest on its rates as a dense matrix, G qdd = r, for checks and for forces that are not unique.

Every column is that of a joint rate; the rates of a free body are those of its mass centre. Sizes of entries are never
scaled to one, because a row or a column of a closure in a right-angled posture may consist of rounding alone.
"""

from __future__ import annotations

from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution, in_range
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, sqrt, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench

NULL_COLUMN = 1e-12  # columns that are smaller, relative to their unit, are zero


class ForestRows(NamedTuple):
    """The constraint of a forest.

    Attributes:
        G: (rows, n_v) rows of closures in order, then of couplings.
        r: (rows,) right-hand side.
        closures: per closure, its rows.
        couplings: per coupling, its row.
        jacobians: per body, the motion of its point per joint rate, (6, n_v).
    """

    G: Array
    r: Array
    closures: list[slice]
    couplings: list[int]
    jacobians: list[Array]

    def on_qd(self, motion: ForestMotion) -> Array:
        """Return the rows on qd, (rows, n_v), in which the rates of free bodies are those of their frames."""
        found = self.G.copy()
        for body, at in zip(motion.bodies, motion.forest.velocities, strict=True):
            if body.floats:
                found[:, at] = array([shift_wrench(body.at.centre, row) for row in self.G[:, at]]).reshape(-1, 6)
        return found


def forest_rows(motion: ForestMotion) -> ForestRows:
    """Return the constraint of a forest, O(bodies * n_v)."""
    forest, n = motion.forest, motion.forest.velocity_count
    jacobians: list[Array] = []
    for k, (body, part) in enumerate(zip(motion.bodies, forest.velocities, strict=True)):
        parent = forest.bodies[k].parent
        under = np.zeros((n, 6)) if parent is None else jacobians[parent].T
        carried = array([shift_twist(body.reach, column) for column in under])
        jacobians.append(np.concatenate([carried[: part.start], body.H.T, carried[part.stop :]]).T)
    blocks, r, closures, start = [np.zeros((0, n))], [], [], 0
    for c, closure in zip(motion.closures, forest.closures, strict=True):
        rows = c.on_b @ jacobians[closure.b]
        blocks.append(rows if closure.a is None else rows + c.on_a @ jacobians[closure.a])
        r.append(c.r)
        closures.append(slice(start, start + len(c.K)))
        start += len(c.K)
    for coupling in forest.couplings:
        units = [c * np.eye(n)[forest.velocities[k].start + component] for k, component, c in coupling.terms]
        blocks.append(array(units).sum(axis=0)[None])
        r.append(np.zeros(1))
    couplings = list(range(start, start + len(forest.couplings)))
    return ForestRows(np.concatenate(blocks), concatenate(r), closures, couplings, jacobians)


def turning(motion: ForestMotion) -> Array:
    """Return whether each rate is an angular velocity, (n_v,)."""
    return array([turns for body in motion.forest.bodies for turns in body.joint.of_kind.turning])


def reach(motion: ForestMotion) -> Scalar:
    """Return the longest distance of bodies from their parents and of closures from their bodies [m]."""
    lengths = [b.reach for b in motion.bodies if not b.floats] + [c.contact.offset for c in motion.closures]
    longest = sqrt(reduce(maximum, [l @ l for l in lengths], 0.0))
    return where(longest > 0.0, longest, 1.0)


def lever_lengths(motion: ForestMotion) -> Array:
    """Return by which lengths the loads of joints are divided to be forces, (n_v,): `reach` for torques, else 1."""
    length = reach(motion)
    return array([length if turns else 1.0 for turns in turning(motion)])


class ForceMetric(NamedTuple):
    """The metric in which forces that are not unique are smallest.

    Attributes:
        length: L, the rms distance of the closures' points from their centroid [m].
        weights: (6,) of the squares of the entries of a wrench.
        couplings: per coupling, the weight of the square of its multiplier.
    """

    length: Scalar
    weights: Array
    couplings: list[Scalar]


def force_metric(motion: ForestMotion) -> ForceMetric:
    """Return the metric of forces; see `least_forces`."""
    forest, turns = motion.forest, turning(motion)
    pairs = zip(forest.closures, motion.closures, strict=True)
    L = length_scale([motion.bodies[c.b].at.frame.p + m.contact.offset for c, m in pairs])
    couplings = []
    for coupling in forest.couplings:
        of = [forest.velocities[k].start + component for k, component, _ in coupling.terms]
        loads = [c / L if turns[i] else c for i, (_, _, c) in zip(of, coupling.terms, strict=True)]
        couplings.append(sum(load * load for load in loads))
    return ForceMetric(L, array([*3 * [1.0 / (L * L)], 1.0, 1.0, 1.0]), couplings)


def least_forces(
    motion: ForestMotion, rows: ForestRows, wrenches: list[Array], multipliers: list[Scalar], rank: int
) -> tuple[list[Array], list[Scalar]]:
    """Return the smallest wrenches of closures and multipliers of couplings with the same effect.

    They minimise sum |m/L|^2 + |f|^2 over closures plus sum (c lambda)^2 over coupled joints, divided by L^2 for those
    that turn, with L the rms distance of the closures' points from their centroid. With this metric C C^T of lambda,
    they are the part of C^T lambda in the range of E = C^-1 G.

    Args:
        motion: the forest's motion.
        rows: its constraint.
        wrenches: per closure, (6,).
        multipliers: per coupling.
        rank: rank of G.
    """
    weighed = weighed_rows(motion, rows)
    along = [c.K @ f for c, f in zip(motion.closures, wrenches, strict=True)]
    forces = [*along, *(array([x]) for x in multipliers)]
    sizes = [C.T @ f for C, f in zip(weighed.factors, forces, strict=True)]
    smallest = in_range(weighed.E, concatenate(sizes), rank)
    ends = np.cumsum([0, *(len(x) for x in sizes)]).tolist()
    pairs = zip(weighed.factors, pairwise(ends), strict=True)
    found = [back_substitution(factor, smallest[start:end]) for factor, (start, end) in pairs]
    count = len(motion.closures)
    return [f @ c.K for f, c in zip(found[:count], motion.closures, strict=True)], [f[0] for f in found[count:]]


class WeighedRows(NamedTuple):
    """The rows in the metric of forces.

    Attributes:
        factors: per closure and per coupling, the lower triangular C of its metric C C^T.
        E: (rows, n_v) C^-1 G, without columns that are only rounding.
    """

    factors: list[Array]
    E: Array


def weighed_rows(motion: ForestMotion, rows: ForestRows) -> WeighedRows:
    """Return the rows in the metric of `force_metric`."""
    metric = force_metric(motion)
    factors = [cholesky((c.K * metric.weights) @ c.K.T) for c in motion.closures]
    factors += [array([[sqrt(weight)]]) for weight in metric.couplings]
    parts = [*rows.closures, *(slice(k, k + 1) for k in rows.couplings)]
    E = np.concatenate(
        [rows.G[:0], *(forward_substitution(C, rows.G[at]) for C, at in zip(factors, parts, strict=True))]
    )
    unit = [maximum(reach(motion), metric.length) if turn else 1.0 for turn in turning(motion)]
    felt = [where(column @ column > (NULL_COLUMN * u) ** 2, column, 0.0) for column, u in zip(E.T, unit, strict=True)]
    return WeighedRows(factors, array(felt).T)
