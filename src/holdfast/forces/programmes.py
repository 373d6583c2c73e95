"""Questions about the forces of a chain as cone programmes in x, v = v0 + N x, in units of F0.

    effort     min cost                                     within the limits
    elastic    min cost + price v + v^2 / 2, v >= 0         every limit gives way by its weight times v
    violation  min v                                        likewise, v of any sign: -v is the common margin
    margin     max t                                        conditions of grasps >= t
    peak       min r                                        |tau_j| <= r effort_j
    scale      max sigma                                    v = v0 + v1 sigma + N x

The last four have no cost, so their values are exact; the torques that go with a value are those of least cost that
reach it up to `RELAXED`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from holdfast.errors import StateError
from holdfast.forces.affine_map import ACCELERATION_SCALE, UNREACHED, AccelerationMap, AccelerationTask
from holdfast.forces.cone_solver import ConeAnswer, ConeProgramme, Cones, Verdict, solve
from holdfast.forces.limit_rows import Limit
from holdfast.forces.limits import ForceCost
from holdfast.model import checks
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate

Form = Literal["effort", "elastic", "violation", "margin", "peak", "scale"]

COSTLY = ("effort", "elastic")
RELAXED = 1e-6  # of a value that the torques of least cost may miss
UNSEEN = 1e-12  # singular values of the limits' rows below this, relative to the largest, count as zero


class Solved(NamedTuple):
    """The answer to a programme.

    Attributes:
        verdict: how the search ended.
        v: (m,) unknowns of the map.
        extra: v [F0], t [F0], r or sigma; 0 for an effort.
        value: cost; or that number for a form without a cost.
        parts: multipliers of every limit, (r,) each, in units of F0 times its weight.
        dual_residual: largest entry of G'z.
        residual: relative residual of the answer.
    """

    verdict: Verdict
    v: Array
    extra: float
    value: float
    parts: list[Array]
    dual_residual: float
    residual: float


class Costs(NamedTuple):
    """The cost 1/2 |Q v + r|^2."""

    Q: Array
    r: Array


def costs(found: AccelerationMap, cost: ForceCost, asked: AccelerationTask | None = None) -> Costs:
    """Return the rows of a cost.

    Args:
        found: the map.
        cost: the cost.
        asked: what is asked and gives way, with its weights.

    Raises:
        StateError: a shape is wrong.
    """
    chain, size = found.chain, len(found.v0)
    root = np.sqrt(cost.effort_weights(chain))
    rows, rest = [root[:, None] * found.T], [root * found.t]
    wish = np.zeros((found.wrench_rows, 6)) if cost.wish is None else cost.wish
    wish = checks.numbers(wish, (found.wrench_rows, 6), "cost: wish", StateError)
    for one in found.grasps:
        c = one.contact
        weight = cost.wrench / found.force / np.array(c.grasp.of_kind.row_scales(found.length))
        of_one = np.zeros((len(weight), size))
        of_one[:, one.part] = np.diag(weight)
        rows.append(of_one)
        rest.append(-weight * (c.K @ rotate(c.frame, wish[one.row])))
    if found.touched is not None:
        of_world = np.zeros((found.touched.size, size))
        of_world[:, found.touch] = cost.wrench / found.force * np.eye(found.touched.size)
        rows.append(of_world)
        rest.append(np.zeros(found.touched.size))
    wished = np.zeros(chain.joint_count) if cost.joint_acceleration is None else cost.joint_acceleration
    wished = checks.numbers(wished, (chain.joint_count,), "cost: joint_acceleration", StateError)
    moving = np.eye(found.qdd.stop, size)  # a floating base, too
    rows.append(cost.acceleration / ACCELERATION_SCALE * moving)
    rest.append(-cost.acceleration / ACCELERATION_SCALE * np.r_[np.zeros(found.base.stop), wished])
    if asked is not None:
        of_task = np.zeros((len(asked.rows), size))
        of_task[:, found.wanted] = asked.rows
        rows.append(of_task)
        rest.append(-asked.values)
    return Costs(np.vstack(rows), np.concatenate(rest))


class Posed(NamedTuple):
    """A question as a cone programme.

    Attributes:
        form: what is asked.
        programme: the programme.
        start: (m,) v at x = 0.
        columns: (m, k) change of v per unknown; that of the form's own number is 0 but for sigma.
        places: the rows of every limit.
        constant: what the cost has beyond that of the programme.
    """

    form: Form
    programme: ConeProgramme
    start: Array
    columns: Array
    places: list[slice]
    constant: float


def posed(
    form: Form,
    found: AccelerationMap,
    limits: Sequence[Limit],
    of: Costs,
    *,
    price: float = 0.0,
    v1: Array | None = None,
) -> Posed:
    """Return a question as a programme; the form's own number, if it has one, is the last unknown.

    Args:
        form: what is asked.
        found: the map.
        limits: the limits.
        of: the cost, of which forms without one make no use.
        price: price of the violation, for "elastic".
        v1: (m,) change of v0 per unit of sigma, for "scale".
    """
    own = [] if form == "effort" else [np.zeros(len(found.v0)) if v1 is None else v1]
    columns = np.column_stack([found.N, *own])
    G, h, cones, places = _stacked(limits, found, columns, form)
    k = columns.shape[1]
    P, c, constant = np.zeros((k, k)), np.zeros(k), 0.0
    if form in COSTLY:
        A, b = of.Q @ columns, of.r + of.Q @ found.v0
        P, c, constant = A.T @ A, A.T @ b, 0.5 * float(b @ b)
    if form == "elastic":
        P[-1, -1] = 1.0
    if form != "effort":
        c[-1] = {"elastic": price, "violation": 1.0, "peak": 1.0}.get(form, -1.0)
    checks.finite(np.concatenate([P.ravel(), c, G.ravel(), h]), "limits and costs")
    return Posed(form, ConeProgramme(P, c, G, h, cones), found.v0, columns, places, constant)


def answer(to: Posed) -> Solved:
    """Return the solution of a programme."""
    done = solve(to.programme) if to.form in COSTLY else _without_cost(to.programme)
    x = np.zeros(len(done.x)) if done.verdict is Verdict.UNBOUNDED else done.x
    extra = 0.0 if to.form == "effort" else float(x[-1])
    left = to.programme.G.T @ done.z
    return Solved(
        done.verdict,
        to.start + to.columns @ x,
        extra,
        done.value + to.constant if to.form in COSTLY else extra,
        [done.z[rows] for rows in to.places],
        float(np.abs(left if to.form == "effort" else left[:-1]).max(initial=0.0)),
        done.residual,
    )


def at_value(
    form: Form,
    extra: float,
    found: AccelerationMap,
    limits: Sequence[Limit],
    of: Costs,
    *,
    v1: Array | None = None,
) -> Solved:
    """Return the solution of least cost that reaches the number `extra` of a form without a cost, up to `RELAXED`."""
    slack = RELAXED * max(1.0, abs(extra))
    given = extra + (slack if form in ("violation", "peak") else -slack)
    shifted = found if v1 is None else found._replace(v0=found.v0 + given * v1)
    moved = [_given_way(limit, form, given, found.force) for limit in limits]
    return answer(posed("effort", shifted, moved, of))


def _given_way(limit: Limit, form: Form, extra: float, force: float) -> Limit:
    """Return a limit at a given number of a form."""
    h = limit.h.copy()
    h[0] += extra * _slope(limit, form, force) - _without(limit, form)
    return limit._replace(h=h)


def _slope(limit: Limit, form: Form, force: float) -> float:
    """Return by how much s_0 grows per unit of the form's number."""
    if form in ("violation", "elastic"):
        return limit.weight * force
    if form == "margin":
        return -force if limit.by_margin else 0.0
    return limit.bound if form == "peak" else 0.0


def _without(limit: Limit, form: Form) -> float:
    """Return the part of s_0 that the form's number replaces."""
    return limit.bound if form == "peak" else 0.0


def _stacked(
    limits: Sequence[Limit], found: AccelerationMap, columns: Array, form: Form
) -> tuple[Array, Array, Cones, list[slice]]:
    """Return G, h and K of all limits in units of F0 times their weights, and the rows of each limit."""
    lines, cones = ([limit for limit in limits if (len(limit.h) == 1) == single] for single in (True, False))
    size = max((len(limit.h) for limit in cones), default=1)
    priced = int(form == "elastic")  # v >= 0
    total = priced + len(lines) + size * len(cones)
    starts = {id(limit): priced + i for i, limit in enumerate(lines)}
    starts |= {id(limit): priced + len(lines) + size * i for i, limit in enumerate(cones)}
    places = [slice(starts[id(limit)], starts[id(limit)] + len(limit.h)) for limit in limits]
    G, h = np.zeros((total, len(found.v0))), np.zeros(total)
    slopes = np.zeros(total)
    for limit, rows in zip(limits, places, strict=True):
        unit = 1.0 / (limit.weight * found.force)
        G[rows], h[rows] = unit * limit.G, unit * limit.h
        h[rows.start] -= unit * _without(limit, form)
        slopes[rows.start] = unit * _slope(limit, form, found.force)
    right, G = h - G @ found.v0, G @ columns
    if form not in ("effort", "scale"):
        G[:, -1] = -slopes
    if priced:
        G[0, -1] = -1.0
    return G, right, Cones(priced + len(lines), len(cones), size), places


def _without_cost(of: ConeProgramme) -> ConeAnswer:
    """Return the solution for a linear cost; of directions without effect on any limit nothing is chosen."""
    _, c, G, h, cones = of
    sizes = np.linalg.norm(G, axis=0)
    unit = 1.0 / np.where(sizes > 0.0, sizes, 1.0)
    _, s, Vt = np.linalg.svd(G * unit, full_matrices=False)
    basis = Vt[s > UNSEEN * s.max(initial=0.0)].T
    seen = unit[:, None] * basis
    left = c * unit - basis @ (basis.T @ (c * unit))
    if np.abs(left).max(initial=0.0) > UNREACHED * np.abs(c * unit).max():  # the value itself meets no limit
        return ConeAnswer(Verdict.UNBOUNDED, np.zeros(len(c)), h, np.zeros(len(h)), -np.inf, 0.0, 0)
    done = solve(ConeProgramme(np.zeros((seen.shape[1],) * 2), seen.T @ c, G @ seen, h, cones))
    return done._replace(x=seen @ done.x)
