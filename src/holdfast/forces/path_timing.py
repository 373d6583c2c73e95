"""The fastest timing of a path under limits on forces, by reachability.

Along a path s, with a = s'' and b = s'^2, all accelerations, wrenches and torques are affine in (x, a, b), where x are
the internal forces. In an interval of width D, a is constant, and b grows by 2 D a. The limits are imposed at both of
its ends, each with its own x:

    backward  top_i = max b  subject to  (x, a, b) in limits_i, (x', a, b + 2 D a) in limits_i+1, b + 2 D a <= top_i+1
    forward   a_i = max a    subject to  the same at b = b_i

Where holding is possible, the limits are convex sets in (x, a, b) with a = b = 0 inside, so that every b from 0 to
top_i can be continued to rest, and a slower motion of the same shape, lambda (a, b) with lambda < 1, is possible, too.

Between the ends limits are passed by the curvature of their rows, of second order in D. The least violation v at places
there, with forces of their own, and the bulge between places by second differences, are measured; the interval is then
halved, or slowed down by the lambda for which v, convex in lambda, is at most minus the bulge.

Reference:
    H. Pham, Q.-C. Pham, A new approach to time-optimal path parameterization based on reachability analysis, IEEE
    Transactions on Robotics, 2018.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from holdfast.errors import StateError
from holdfast.forces.acceleration_map import (
    ACCELERATION_SCALE,
    UNREACHED,
    AccelerationMap,
    ObjectTask,
    acceleration_map,
    motion_without_torques,
)
from holdfast.forces.certificate import MENTIONED_SHARE, certificate
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.limit_rows import Limit, limit_rows
from holdfast.forces.limits import ForceLimits
from holdfast.forces.programmes import Costs, Solved, answer, posed
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import State, shaped_inputs

INSIDE = 3  # places between two nodes at which limits are measured
PASSED_BETWEEN = 5e-4  # N by which limits may be passed there
MOST_ROUNDS = 20
SLOWEST, LEAST_CHANGE = 0.5, 1e-3  # smallest lambda of a round, and smallest change
HALVED_BELOW, HALVED_BELOW_WIDTH = 0.99, 1 / 16  # lambda, and least share of the width, of intervals that are halved
BELOW_TOP = 1.0 - 1e-7  # share of the largest b that is used: at it, the only choice left is hard to find
NO_COST = Costs(np.zeros((0, 0)), np.zeros(0))
OF_RATE, LATER = "rate", "later speed"


class PathPoint(NamedTuple):
    """The limits at a place of a path, in the unknowns y = (x, a, b).

    Attributes:
        u: the share of the path.
        s: the place, for messages.
        found: the map at rest.
        limits: the limits, s = h - G y; the last is that of the joint that reaches its rate limit first, if any.
        at_rest: least violation of limits on forces at rest, negative if there is room [N].
    """

    u: float
    s: float
    found: AccelerationMap
    limits: list[Limit]
    at_rest: float = -np.inf

    @property
    def free(self) -> int:
        """Number of internal forces x."""
        return self.limits[0].G.shape[1] - 2 if self.limits else 0

    @property
    def forces(self) -> list[Limit]:
        """The limits without that of rates."""
        return [limit for limit in self.limits if limit.what != OF_RATE]


def path_point(
    chain: ClosedChain, u: float, s: float, state: State, joints: Array, acceleration: Array, limits: ForceLimits
) -> PathPoint:
    """Return the limits at a place of a path. O(n^3).

    Args:
        chain: the chain.
        u: the share of the path.
        s: the place.
        state: the closed state there with s' = 1.
        joints: (n,) second derivatives of the joint positions by s; what the grasps contradict is projected out.
        acceleration: (6,) acceleration of C with s' = 1 and s'' = 0, world axes.
        limits: the limits.

    Raises:
        StateError: the arms cannot give the object this motion, or the limits cannot be kept even at rest.
    """
    still = replace(state, qd=np.zeros_like(state.qd), object_twist=np.zeros(6))
    rest, moving = (motion_without_torques(chain, one, shaped_inputs(chain, None)) for one in (still, state))
    held = acceleration_map(rest, ObjectTask(np.eye(6), np.zeros(6)))
    by_a = acceleration_map(rest, ObjectTask(np.eye(6), state.object_twist), force=held.force)
    by_b = acceleration_map(moving, ObjectTask(np.eye(6), acceleration), force=held.force)
    U, size, Vt = np.linalg.svd(held.N[held.qdd], full_matrices=True)
    rank = int((size > UNREACHED * ACCELERATION_SCALE).sum())
    to_joints = held.N @ (Vt[:rank].T / size[:rank]) @ U[:, :rank].T  # accelerations of joints that the grasps permit
    x = held.N @ Vt[rank:].T
    v0, va, vb = (
        v + to_joints @ (qdd - v[held.qdd])
        for v, qdd in (
            (held.v0, np.zeros(len(joints))),
            (by_a.v0 - held.v0, state.qd),
            (by_b.v0 - held.v0, joints),
        )
    )
    rows = zip(limit_rows(held, still, limits), limit_rows(by_b, state, limits), strict=True)
    found = [
        one._replace(
            G=np.column_stack([one.G @ x, one.G @ va, one.G @ vb - (moved.h - one.h)]),
            h=one.h - one.G @ v0,
        )
        for one, moved in rows
    ]
    point = PathPoint(u, s, held, [*found, *_rate_limit(chain, state.qd, held.force, x.shape[1])])
    return point._replace(at_rest=_held(point))


def _rate_limit(chain: ClosedChain, slopes: Array, force: float, free: int) -> list[Limit]:
    """Return b <= (rate / |q'|)^2 of the joint that allows least."""
    rates = np.array([joint.rate_limit for joint in chain.all_joints])
    with np.errstate(divide="ignore", invalid="ignore"):
        most = np.where(slopes == 0.0, np.inf, (rates / np.abs(slopes)) ** 2)
    j = int(np.argmin(most))
    if not np.isfinite(most[j]):
        return []
    return [Limit(chain.joint_names()[j], OF_RATE, "", most[j] / force, np.eye(1, free + 2, free + 1), most[j : j + 1])]


class Timing(NamedTuple):
    """The fastest timing of a path.

    Attributes:
        u: (nodes,) shares of the path.
        b: (nodes,) s'^2.
        a: (intervals,) s''.
        top: (nodes,) largest b from which the path can be continued to rest.
        limited_by: of each interval, the names of the limits that matter, by their shares.
        room: (intervals,) force by which all limits on forces could be tightened everywhere in it [N].
    """

    u: Array
    b: Array
    a: Array
    top: Array
    limited_by: list[dict[str, float]]
    room: Array


class Interval(NamedTuple):
    """The limits of an interval in the unknowns y = (x, x', a, b) of both ends, with b at its beginning.

    Attributes:
        points: both ends, and the places between them.
        slower: lambda, by which limits on forces shrink in a and b.
    """

    points: Sequence[PathPoint]
    slower: float

    @property
    def width(self) -> float:
        """D."""
        return self.points[-1].u - self.points[0].u

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.points[0].free + self.points[-1].free + 2

    @property
    def force(self) -> float:
        """The larger F0."""
        return max(self.points[0].found.force, self.points[-1].found.force)

    def limits(self) -> list[Limit]:
        """Return the limits at both ends, and those of rates between them."""
        first = self.points[0].free
        places = [slice(0, first), *[slice(0, 0)] * INSIDE, slice(first, self.size - 2)]
        found = []
        for k, (point, x) in enumerate(zip(self.points, places, strict=True)):
            along = 2.0 * self.width * k / (len(self.points) - 1)
            for limit in point.limits if k in (0, len(self.points) - 1) else point.limits[len(point.forces) :]:
                G = np.zeros((len(limit.h), self.size))
                G[:, x] = limit.G[:, :-2] if x.stop > x.start else 0.0
                G[:, -2:] = limit.G[:, -2:] @ np.array([[1.0, 0.0], [along, 1.0]])
                G[:, -2:] /= 1.0 if limit.what == OF_RATE else self.slower
                found.append(limit._replace(G=G))
        return found

    def violations(self, a: float, b: float) -> Array:
        """Return by how much limits on forces have to be passed at all places of the interval [N]."""
        ends = np.linspace(b, b + 2.0 * self.width * a, len(self.points))
        return np.array(
            [
                _least_violation(point, a, x).extra * point.found.force if point.forces else -np.inf
                for point, x in zip(self.points, ends, strict=True)
            ]
        )

    def possible_share(self, passed: Array) -> float:
        """Return lambda for violations (places,) at lambda = 1."""
        above = np.pad(_above(passed), 1)
        goal = np.minimum(0.0, 0.5 * PASSED_BETWEEN - np.maximum(above[:-1], above[1:]))
        at_rest = np.array([point.at_rest for point in self.points])
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(passed > goal, (goal - at_rest) / (passed - at_rest), 1.0).min()
        return min(max(float(share), SLOWEST), 1.0 - LEAST_CHANGE)

    def largest(self, top: float, b: float | None = None) -> tuple[Solved, list[str]]:
        """Return y with the largest b, or for a given b > 0 with the largest a; and the names of the limits.

        Args:
            top: largest b at the end of the interval; 0 for rest.
            b: at its beginning, if it is given.
        """
        limits, later = self.limits(), np.array([2.0 * self.width, 1.0])
        steepest = max((np.abs(one.G[:, -2]).max() / (one.weight * self.force) for one in limits), default=0.0)
        scale = 2.0 * self.width / max(steepest, 1e-300) / self.force  # in which b is compared
        end = np.concatenate([np.zeros(self.size - 2), later])[None]
        way, others = np.eye(self.size)[-1 if b is None else -2], [*np.eye(self.size)[:-2]]
        if b is None and top == 0.0:
            way = way - np.eye(self.size)[-2] / later[0]
        else:
            limits += [Limit("", LATER, "", scale, end, np.array([top])), Limit("", "", "", scale, -end, np.zeros(1))]
            if b is None:
                others.append(np.eye(self.size)[-2])
        if b is None:
            limits.append(Limit("", "", "", scale, -np.eye(self.size)[-1:], np.zeros(1)))
        start = (0.0 if b is None else b) * np.eye(self.size)[-1]
        columns = np.array(others).reshape(-1, self.size).T
        y = self.points[0].found._replace(v0=start, N=columns, force=self.force)  # y in place of v
        return answer(posed("scale", y, limits, NO_COST, v1=way)), [limit.name for limit in limits]


def fastest_timing(point_at: Callable[[float], PathPoint], nodes: Array) -> Timing:
    """Return the fastest timing from rest to rest.

    Args:
        point_at: the limits at a share of the path.
        nodes: (m,) nodes to begin with; intervals in which limits bend much are halved.

    Raises:
        StateError: somewhere the limits cannot be kept even at rest, or no limit bounds the speed.
    """
    point_at = functools.cache(point_at)
    parts = [_interval(point_at, float(u), float(v)) for u, v in pairwise(nodes)]
    least = HALVED_BELOW_WIDTH * float(np.diff(nodes).min())
    why = ""
    for _ in range(MOST_ROUNDS):
        b, a, top, limited_by = _reached(parts)
        passed = [part.violations(*start) for part, *start in zip(parts, a, b[:-1], strict=True)]
        peaks = np.array([(np.maximum(one[:-1], one[1:]) + _above(one)).max() for one in passed])
        if peaks.max() <= PASSED_BETWEEN:
            ends = np.array([parts[0].points[0].u, *(part.points[-1].u for part in parts)])
            return Timing(ends, b, a, top, limited_by, -peaks)
        refined = []
        for part, one, peak in zip(parts, passed, peaks, strict=True):
            slower = part.slower if peak <= PASSED_BETWEEN else part.slower * part.possible_share(one)
            if slower < HALVED_BELOW and part.width > least:
                first, middle, last = (
                    point.u for point in (part.points[0], part.points[len(part.points) // 2], part.points[-1])
                )
                refined += [_interval(point_at, first, middle), _interval(point_at, middle, last)]
            else:
                refined.append(part._replace(slower=slower))
        worst, parts = parts[int(np.argmax(peaks))], refined
        why = (
            f"time_path: between s = {worst.points[0].s:g} and {worst.points[-1].s:g} limits are passed by"
            f" {peaks.max():.2g} N; try more nodes"
        )
    raise StateError(why)


def _interval(point_at: Callable[[float], PathPoint], first: float, last: float) -> Interval:
    """Return an interval, with the largest b lowered by as much as it sags between places, by second differences."""
    points = [point_at(float(u)) for u in np.linspace(first, last, INSIDE + 2)]
    most = np.array([one.limits[-1].h[0] if len(one.limits) > len(one.forces) else np.inf for one in points])
    if np.isfinite(most).all():
        sag = np.pad(np.maximum(0.0, np.diff(most, 2)) / 8.0, 1, mode="edge")
        lower = np.maximum(most - sag, 0.5 * most)
        points = [
            one._replace(limits=[*one.forces, one.limits[-1]._replace(h=lower[k : k + 1])])
            for k, one in enumerate(points)
        ]
    return Interval(points, 1.0)


def _above(passed: Array) -> Array:
    """Return by how much values rise between two places above both, by a parabola, (places - 1,)."""
    curve = np.pad(np.maximum(0.0, -np.diff(passed, 2)), 1)
    bulge = np.maximum(curve[:-1], curve[1:]) / 8.0
    slope = np.abs(np.diff(passed)) / np.where(bulge > 0.0, 4.0 * bulge, 1.0)
    return bulge * np.maximum(0.0, 1.0 - slope) ** 2


def _reached(parts: Sequence[Interval]) -> tuple[Array, Array, Array, list[dict[str, float]]]:
    """Return b, a, the largest b of all nodes, and what limits each interval, by a backward and a forward pass."""
    count = len(parts)
    top, slope, before = np.zeros(count + 1), np.zeros(count), [{}] * count
    for i in reversed(range(count)):
        done, names = parts[i].largest(float(top[i + 1]))
        if done.verdict is not Verdict.OPTIMAL:
            raise StateError(_not_found(done.verdict, parts[i]))
        slope[i], top[i] = done.v[-2], max(float(done.v[-1]), 0.0)
        before[i] = _shares(done, names)
    b, a, limited_by = np.zeros(count + 1), np.zeros(count), []
    for i, part in enumerate(parts):
        share = b[i] / top[i] if top[i] > 0.0 else 0.0
        a[i], shares = share * slope[i], before[i]  # possible, since the limits are convex
        if top[i + 1] > 0.0:
            done, names = part.largest(float(top[i + 1]), float(b[i]))
            if done.verdict is Verdict.OPTIMAL and done.v[-2] >= a[i]:
                a[i], shares = done.v[-2], _shares(done, names)
                if max(shares, key=lambda name: shares[name], default="") == LATER:
                    shares = before[i + 1]
        b[i + 1] = min(max(b[i] + 2.0 * part.width * a[i], 0.0), BELOW_TOP * top[i + 1])
        a[i] = (b[i + 1] - b[i]) / (2.0 * part.width)
        mentioned = {name: x for name, x in shares.items() if name not in ("", LATER) and x >= MENTIONED_SHARE}
        limited_by.append(dict(sorted(mentioned.items(), key=lambda pair: -pair[1])))
    return b, a, top, limited_by


def _shares(done: Solved, names: list[str]) -> dict[str, float]:
    """Return the multipliers by name, relative to their sum."""
    total, found = sum(float(part[0]) for part in done.parts), dict.fromkeys((name.strip() for name in names), 0.0)
    for name, part in zip(names, done.parts, strict=True):
        found[name.strip()] += float(part[0]) / total
    return found


def _least_violation(point: PathPoint, a: float, b: float) -> Solved:
    """Return by how much limits on forces have to be passed at a place, negative if there is room."""
    start = np.concatenate([np.zeros(point.free), [a, b]])
    y = point.found._replace(v0=start, N=np.eye(point.free + 2)[:, :-2])
    return answer(posed("violation", y, point.forces, NO_COST))


def _held(point: PathPoint) -> float:
    """Return the violation at rest [N].

    Raises:
        StateError: the object cannot be held.
    """
    if not point.forces:
        return -np.inf
    done, force = _least_violation(point, 0.0, 0.0), point.found.force
    lack = -np.inf if done.verdict is Verdict.UNBOUNDED else done.extra * force
    if lack > PASSED_BETWEEN:
        words = [limit.words for limit in point.forces]
        proof = certificate(words, done.parts, lack, done.dual_residual * force)
        raise StateError(f"the object cannot even be held there: {proof.words}")
    return lack


def _not_found(verdict: Verdict, part: Interval) -> str:
    """Return why there is no largest speed."""
    if verdict is Verdict.UNBOUNDED:
        return (
            f"time_path: no limit bounds the speed at s = {part.points[0].s:g}; try effort limits or rate limits of"
            " joints"
        )
    return (
        f"time_path: from s = {part.points[0].s:g} to {part.points[-1].s:g} the limits leave no room that rounding does"
        " not hide; try more nodes, or wider limits"
    )
