"""The fastest timing of a path under limits on forces, by reachability.

Along a path s, with a = s'' and b = s'^2, all accelerations, wrenches and torques are affine in (x, a, b), where x are
the internal forces. In an interval, a is linear in s. The limits are imposed at its ends and in its middle, each with
its own x:

    backward  top_i = max b  subject to  (x, a, b) in limits_i, (x', a', b') in limits_i+1, b' <= top_i+1
    forward   b'_i = max b'  subject to  the same at b = b_i,             with b' = b + D (a + a')

Where holding is possible, the limits are convex sets in (x, a, b) with a = b = 0 inside, so that every b from 0 to
top_i can be continued to rest, and a slower motion of the same shape, lambda (a, b) with lambda < 1, is possible, too.

Between these limits are passed by their curvature, of second order in D. The least violation v at places
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
from holdfast.forces.certificate import MENTIONED_SHARE
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.path_interval import IMPOSED, LATER, Interval, durations, peak
from holdfast.forces.path_point import OF_RATE, PASSED_BETWEEN, PathPoint
from holdfast.forces.programmes import Solved
from holdfast.spatial.scalar import Array

INSIDE = 3  # places between two nodes at which limits are measured
MOST_ROUNDS = 20
LEAST_WIDTH = 1 / 16  # of intervals that are halved, as a share of the narrowest at first
STANDS = 1e-9  # share of its scale below which s'^2 is rounding
END_HALVINGS = 3
NEARLY_KNOWN, KNOWN = 0.1, 1e-3  # relative change of speeds with dampers, to refine and to end
LOST_TIME, LOST_BY_SLOWNESS = 5e-4, 5e-5  # shares of the whole time for which an interval is halved
BELOW_TOP = 1.0 - 1e-7  # share of the largest b that is used: at it, the only choice left is hard to find


class Timing(NamedTuple):
    """The fastest timing of a path.

    Attributes:
        u: (nodes,) shares of the path.
        b: (nodes,) s'^2.
        a: (intervals, 2) s'' at both ends of each interval.
        top: (nodes,) largest b from which the path can be continued to rest.
        most: (nodes,) largest b within the limits at each node by itself.
        limited_by: of each interval, the names of the limits that matter, by their shares.
        room: (intervals,) force by which all limits on forces could be tightened everywhere in it [N].
    """

    u: Array
    b: Array
    a: Array
    top: Array
    most: Array
    limited_by: list[dict[str, float]]
    room: Array


class Profile(NamedTuple):
    """The speeds of the last passes.

    Attributes:
        b: (nodes,) s'^2.
        motion: (intervals, 2) mean and half the change of s''.
        top: (nodes,) largest b from which the path can be continued to rest.
        limited_by: of each interval, the names of the limits that matter, by their shares.
        forces: of each interval, internal forces where limits are imposed, if they are known.
    """

    b: Array
    motion: Array
    top: Array
    limited_by: list[dict[str, float]]
    forces: list[Array | None]

    @property
    def a(self) -> Array:
        """s'' at both ends of each interval, (intervals, 2)."""
        return self.motion[:, :1] + self.motion[:, 1:] * (-1.0, 1.0)


def fastest_timing(point_at: Callable[[float], PathPoint], nodes: Array, damped: bool = False) -> Timing:
    """Return the fastest timing from rest to rest.

    Args:
        point_at: the limits at a share of the path.
        nodes: (m,) nodes to begin with; intervals in which limits bend much are halved.
        damped: whether there are dampers.

    Raises:
        StateError: somewhere the limits cannot be kept even at rest, or no limit bounds the speed.
    """
    point_at = functools.cache(point_at)
    largest, violations = functools.cache(Interval.largest), functools.cache(Interval.violations)
    parts = [_interval(point_at, float(u), float(v)) for u, v in pairwise(_graded(nodes))]
    least, why, known = LEAST_WIDTH * float(np.diff(nodes).min()), "", not damped
    for _ in range(MOST_ROUNDS):
        profile = _reached(parts, largest)
        courses = np.c_[profile.motion, profile.b[:-1]].tolist()
        if damped:
            rates = [tuple(part.rates_with(*y)[list(IMPOSED)].tolist()) for part, y in zip(parts, courses, strict=True)]
            change = np.abs(np.array(rates) - [part.rates for part in parts]).max() / np.max(rates)
            near = change < NEARLY_KNOWN
            parts = [replace(part, rates=each, tangent=near) for part, each in zip(parts, rates, strict=True)]
            if not near:
                continue
            known = change < KNOWN
        times = durations(
            np.array([part.width for part in parts]),
            np.sqrt(profile.b[:-1]) + np.sqrt(profile.b[1:]),
            2.0 * profile.motion[:, 1],
        )
        slow = _lost(parts, profile, times) > LOST_TIME * times.sum()
        passed = []
        for part, y, x in zip(parts, courses, profile.forces, strict=True):
            simply = None if x is None else part.violations_with(x, *y)
            passed.append(violations(part, *y) if simply is None or peak(simply) > PASSED_BETWEEN else simply)
        peaks = np.array([peak(one) for one in passed])
        slow &= [part.width > least for part in parts]
        if peaks.max() <= PASSED_BETWEEN and known and not slow.any():
            ends = [parts[0].points[0], *(part.points[-1] for part in parts)]
            u, most = (np.array(x) for x in zip(*((one.u, one.fastest()) for one in ends), strict=True))
            return Timing(u, profile.b, profile.a, profile.top, most, profile.limited_by, -peaks)
        refined = []
        for part, y, one, most, time, halved in zip(parts, courses, passed, peaks, times, slow, strict=True):
            slower = part.slower * (1.0 if most <= PASSED_BETWEEN else part.possible_share(one))
            lost = (1.0 - np.sqrt(slower)) * time
            if halved or (lost > LOST_BY_SLOWNESS * times.sum() and part.width > least):
                refined += _halves(point_at, part, part.rates_with(*y) if damped else None)
            else:
                refined.append(part if slower == part.slower else replace(part, slower=slower))
        worst, parts = parts[int(np.argmax(peaks))], refined
        why = (
            f"time_path: between s = {worst.points[0].s:g} and {worst.points[-1].s:g} limits are passed by"
            f" {peaks.max():.2g} N; try more nodes"
        )
    raise StateError(why or "time_path: the speeds that the dampers permit were not found; try less damping")


def _interval(point_at: Callable[[float], PathPoint], first: float, last: float) -> Interval:
    """Return an interval, with the largest b lowered by as much as it sags between places, by second differences."""
    points = [point_at(float(u)) for u in np.linspace(first, last, INSIDE + 2)]
    for point in (points[0], points[-1]):
        point.require_held()
    most = np.array([point.most for point in points])
    if np.isfinite(most).all():
        sag = np.pad(np.maximum(0.0, np.diff(most, 2)) / 8.0, 1, mode="edge")
        most = np.maximum(most - sag, 0.5 * most)
    return Interval(points, most, 1.0)


def _graded(nodes: Array) -> Array:
    """Return nodes with further ones near both ends, where the speed changes most."""
    nearer = 0.5 ** np.arange(END_HALVINGS, 0, -1)
    first, last = nodes[0] + nearer * (nodes[1] - nodes[0]), nodes[-1] - nearer[::-1] * (nodes[-1] - nodes[-2])
    return np.concatenate([nodes[:1], first, nodes[1:-1], last, nodes[-1:]])


def _lost(parts: Sequence[Interval], profile: Profile, times: Array) -> Array:
    """Return by how much longer intervals take than what bounds them seems to allow, (intervals,).

    These are the rates there, and the accelerations beside them, where forces bound those.
    """
    b = profile.b
    by_rates = [sum(x for name, x in one.items() if name.endswith(OF_RATE)) for one in profile.limited_by]
    by_forces = np.array([sum(one.values()) for one in profile.limited_by]) > 2.0 * np.array(by_rates)
    a = np.where(by_forces[:, None], profile.a, np.nan)
    before, after = np.append(a[0, 0], a[:, 1]), np.append(a[:, 0], a[-1, 1])
    lost = []
    for i, part in enumerate(parts):
        way = np.linspace(0.0, part.width, len(part.points))
        bounds = part.most, b[i] + 2.0 * before[i] * way, b[i + 1] - 2.0 * after[i + 1] * (part.width - way)
        most = np.sqrt(np.maximum(functools.reduce(np.fmin, bounds), 0.0))
        lost.append(times[i] - durations(np.diff(way), most[:-1] + most[1:], np.zeros(len(way) - 1)).sum())
    return np.array(lost)


def _halves(point_at: Callable[[float], PathPoint], part: Interval, rates: Array | None) -> list[Interval]:
    """Return both halves of an interval, with s' at its places where forces of dampers depend on it."""
    found, middle = [], len(part.points) // 2
    for first in (0, middle):
        half = _interval(point_at, part.points[first].u, part.points[first + middle].u)
        if rates is not None:  # between its places, in proportion
            places = first + 0.5 * np.array(IMPOSED)
            half = replace(half, rates=tuple(np.interp(places, np.arange(len(rates)), rates).tolist()))
        found.append(replace(half, tangent=part.tangent))
    return found


def _reached(parts: Sequence[Interval], largest: Callable[..., tuple[Solved, list[str]]]) -> Profile:
    """Return the largest speeds, by a backward and a forward pass."""
    count = len(parts)
    top, motion, before = np.zeros(count + 1), np.zeros((count, 2)), [{}] * count
    for i in reversed(range(count)):
        done, names = largest(parts[i], float(top[i + 1]))
        if done.verdict is not Verdict.OPTIMAL:
            raise StateError(_not_found(done.verdict, parts[i]))
        motion[i], top[i] = done.v[-3:-1], max(float(done.v[-1]), 0.0)
        if top[i] <= STANDS * 2.0 * parts[i].width * parts[i].unit:
            raise StateError(
                f"time_path: at s = {parts[i].points[0].s:g} the limits leave no motion from which the path can be"
                " continued to rest; try wider limits, of accelerations for example"
            )
        before[i] = _shares(done, names)
    forces: list[Array | None] = [None] * count
    b, limited_by = np.zeros(count + 1), []
    for i, part in enumerate(parts):
        motion[i] *= b[i] / top[i] if top[i] > 0.0 else 0.0  # possible, since the limits are convex
        shares = before[i]
        if top[i + 1] > 0.0:
            done, names = largest(part, float(top[i + 1]), float(b[i]))
            if done.verdict is Verdict.OPTIMAL and done.v[-3] >= motion[i, 0]:
                motion[i], shares, forces[i] = done.v[-3:-1], _shares(done, names), done.v[:-4]
                if max(shares, key=lambda name: shares[name], default="") == LATER:
                    shares = before[i + 1]
        b[i + 1] = min(max(b[i] + 2.0 * part.width * motion[i, 0], 0.0), BELOW_TOP * top[i + 1])
        motion[i, 0] = (b[i + 1] - b[i]) / (2.0 * part.width)
        mentioned = {name: x for name, x in shares.items() if name != LATER and x >= MENTIONED_SHARE}
        limited_by.append(dict(sorted(mentioned.items(), key=lambda pair: -pair[1])))
    return Profile(b, motion, top, limited_by, forces)


def _shares(done: Solved, names: list[str]) -> dict[str, float]:
    """Return the multipliers by name, relative to their sum; parts of the programme without a name do not count."""
    found: dict[str, float] = {}
    for name, part in zip(names, done.parts, strict=True):
        if name.strip():
            found[name.strip()] = found.get(name.strip(), 0.0) + float(part[0])
    total = max(sum(found.values()), np.finfo(float).tiny)
    return {name: x / total for name, x in found.items()}


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
