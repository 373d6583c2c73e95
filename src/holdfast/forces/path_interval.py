"""An interval of a timed path, in which s'' is linear in s.

With the mean m of s'' and half its change d, a = m + d (2 r - 1) at the share r of an interval of width D, and

    b = b_0 + 2 D m r - 2 D d r (1 - r),      b_1 = b_0 + 2 D m.

Limits are convex in (x, a, b), so what holds at both ends and in the middle holds between them up to the curvature of
the limits' rows and of b, both of second order in D. Torques at each of these places use forces x of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from holdfast.forces.limit_rows import Limit
from holdfast.forces.path_point import NO_COST, PASSED_BETWEEN, PathPoint
from holdfast.forces.programmes import Solved, answer, posed
from holdfast.spatial.scalar import Array

IMPOSED = (0, 2, 4)  # of the five places of an interval, those at which limits on forces are imposed
LATER = "later speed"
UNEVEN_PRICE = 1e-2  # price of a change of s'' in an interval, relative to what it gains
LEAST_CONTROL = 0.1  # share of the mean of both ends, below which b's middle control point does not sink
FASTER = 2.0  # multiple of `rates` up to which dampers are taken as linear in b
SLOWEST, LEAST_CHANGE = 0.5, 1e-3  # smallest lambda of a round, and smallest change


@dataclass(frozen=True, eq=False)
class Interval:
    """The limits of an interval in the unknowns y = (x, .., t, m, d, b), with an x for each of `IMPOSED`, and t >= |d|.

    Attributes:
        points: both ends, and the places between them.
        most: (places,) largest b there within rate limits, lowered by as much as it sags between them.
        slower: lambda, by which limits on forces shrink in a and b.
        rates: s' at `IMPOSED`, next to which c is linear in b; 0 for c = 0.
        tangent: whether c is (rate + b / rate) / 2, which is nearer to sqrt(b), or b / rate, which is right at rest.
    """

    points: Sequence[PathPoint]
    most: Array
    slower: float
    rates: tuple[float, ...] = (0.0,) * len(IMPOSED)
    tangent: bool = False

    @property
    def width(self) -> float:
        """D."""
        return self.points[-1].u - self.points[0].u

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.parts[-1].stop + 4

    @property
    def imposed(self) -> list[PathPoint]:
        """The places at which limits on forces are imposed, with forces of their own."""
        return [self.points[k] for k in IMPOSED]

    @property
    def parts(self) -> list[slice]:
        """Where y has x of each of these."""
        ends = np.cumsum([0, *(point.free for point in self.imposed)]).tolist()
        return [slice(*pair) for pair in pairwise(ends)]

    @property
    def force(self) -> float:
        """The largest F0 of these."""
        return max(point.found.force for point in self.imposed)

    @property
    def _linear_at(self) -> list[float]:
        """`rates`, those above 0 raised to a share of the largest: c by b next to almost 0 would bind all others."""
        least = max(self.rates) / FASTER
        return [max(rate, least) if rate > 0.0 else 0.0 for rate in self.rates]

    def motion(self) -> Array:
        """Return the matrices from (m, d, b) to (a, b) at all places, (places, 2, 3)."""
        r, D = np.linspace(0.0, 1.0, len(self.points)), self.width
        a = np.stack([np.ones_like(r), 2.0 * r - 1.0, np.zeros_like(r)], axis=1)
        b = np.stack([2.0 * D * r, -2.0 * D * r * (1.0 - r), np.ones_like(r)], axis=1)
        return np.stack([a, b], axis=1)

    @cached_property
    def unit(self) -> float:
        """The a that takes F0 at one of `IMPOSED`; without limits on forces, what gives b its largest value."""
        of_a = max(
            (np.abs(one.G[:, -3]).max() / one.weight for point in self.imposed for one in point.forces), default=0.0
        )
        return self.force / of_a if of_a > 0.0 else float(self.most.min()) / (2.0 * self.width)

    def limits(self) -> list[Limit]:
        """Return the limits on forces at `IMPOSED`, and those on rates everywhere."""
        motion, found = self.motion(), []
        for k, x, rate in zip(IMPOSED, self.parts, self._linear_at, strict=True):
            part = 0.5 if self.tangent else 1.0  # of c, by b; the rest is constant
            by_b = np.array([0.0, part / rate if rate > 0.0 else 0.0])
            for limit in self.points[k].forces:
                G = np.zeros((len(limit.h), self.size))
                G[:, x] = limit.G[:, :-3]
                G[:, -3:] = (limit.G[:, -3:-1] + limit.G[:, -1:] * by_b) @ motion[k] / self.slower
                found.append(limit._replace(G=G, h=limit.h - (1.0 - part) * rate * limit.G[:, -1]))
        for point, to, most in zip(self.points, motion, self.most, strict=True):
            if point.rate is not None:
                G = np.zeros((1, self.size))
                G[:, -3:] = to[1:]
                found.append(point.rate._replace(G=G, h=np.array([most])))
        return found

    def _along(self, m: float, d: float, b: float) -> Array:
        """Return a and b at all places, (places, 2)."""
        there = self.motion() @ (m, d, b)
        return np.column_stack([there[:, 0], np.maximum(there[:, 1], 0.0)])

    def rates_with(self, m: float, d: float, b: float) -> Array:
        """Return s' at all places."""
        return np.sqrt(self._along(m, d, b)[:, 1])

    def violations(self, m: float, d: float, b: float) -> Array:
        """Return by how much limits on forces have to be passed at all places [N]."""
        there = self._along(m, d, b)
        return np.array([point.violation(*one) for point, one in zip(self.points, there.tolist(), strict=True)])

    def violations_with(self, x: Array, m: float, d: float, b: float) -> Array:
        """Return by how much limits on forces are passed at all places with wrenches between those of `IMPOSED` [N].

        Args:
            x: internal forces there.
            m: mean of a.
            d: half its change.
            b: at the beginning.
        """
        there = self._along(m, d, b)
        known = [
            point.wrenches(x[part], *there[k]) for point, part, k in zip(self.imposed, self.parts, IMPOSED, strict=True)
        ]
        from scipy.interpolate import interp1d  # imported here because it takes half a second

        between = interp1d(IMPOSED, known, axis=0)(np.arange(len(self.points)))
        return np.array(
            [point.violation_with(f, *one) for point, f, one in zip(self.points, between, there, strict=True)]
        )

    def possible_share(self, passed: Array) -> float:
        """Return lambda for violations (places,) at lambda = 1."""
        bulge = np.pad(above(passed), 1)
        goal = np.minimum(0.0, 0.5 * PASSED_BETWEEN - np.maximum(bulge[:-1], bulge[1:]))
        at_rest = np.array([point.at_rest for point in self.points])
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(passed > goal, (goal - at_rest) / (passed - at_rest), 1.0).min()
        return min(max(float(share), SLOWEST), 1.0 - LEAST_CHANGE)

    def largest(self, top: float, b: float | None = None) -> tuple[Solved, list[str]]:
        """Return y with the largest b, or for a given b > 0 with the largest m; and the names of the limits.

        Args:
            top: largest b at the end of the interval; 0 for rest.
            b: at its beginning, if it is given.
        """
        limits, D = self.limits(), self.width
        t, m, d, at = np.eye(self.size)[-4:]
        unit = self.unit / self.force
        middle, mean = D * (m - d) + at, D * m + at  # b is a parabola through its ends that these three control
        bounds = [(LEAST_CONTROL * mean - middle, 0.0, 2.0 * D * unit), (d - t, 0.0, unit), (-d - t, 0.0, unit)]
        way, others = (at if b is None else m), [*np.eye(self.size)[:-4], d]
        price = UNEVEN_PRICE * (2.0 * D if b is None else 1.0)
        if b is None:
            bounds.append((-at, 0.0, 2.0 * D * unit))
        if b is None and top == 0.0:
            way = way - m / (2.0 * D)
        else:
            end = 2.0 * D * m + at
            limits.append(Limit("", LATER, "", 2.0 * D * unit, end[None], np.array([top])))
            bounds.append((-end, 0.0, 2.0 * D * unit))
            if b is None:
                others.append(m)
        for at_end, rate in zip((at, 2.0 * D * m + at), (self._linear_at[0], self._linear_at[-1]), strict=True):
            if rate > 0.0:
                bounds.append((at_end, FASTER**2 * rate**2, FASTER**2 * rate**2 / self.force))
        limits += [Limit("", "", "", weight, G[None], np.array([h])) for G, h, weight in bounds]
        columns = np.column_stack([*others, t + price * way])
        y = self.points[0].found._replace(v0=(b or 0.0) * at, N=columns, force=self.force)  # y in place of v
        return answer(posed("scale", y, limits, NO_COST, v1=way)), [limit.name for limit in limits]


def above(passed: Array) -> Array:
    """Return by how much values rise between two places above both, by a parabola, (places - 1,)."""
    curve = np.pad(np.maximum(0.0, -np.diff(passed, 2)), 1)
    bulge = np.maximum(curve[:-1], curve[1:]) / 8.0
    slope = np.abs(np.diff(passed)) / np.where(bulge > 0.0, 4.0 * bulge, 1.0)
    return bulge * np.maximum(0.0, 1.0 - slope) ** 2


def durations(widths: Array, rates: Array, changes: Array) -> Array:
    """Return the times of intervals, 2 D / (s'_0 + s'_1) atanh(z) / z with z^2 = (a_1 - a_0) D / (s'_0 + s'_1)^2.

    z^2 may be negative.
    """
    square = changes * widths / rates**2
    z = np.sqrt(np.abs(square))
    far = np.where(square > 0.0, np.arctanh(np.minimum(z, 1.0)), np.arctan(z)) / np.where(z > 0.0, z, 1.0)
    return 2.0 * widths / rates * np.where(z < 1e-4, 1.0 + square / 3.0, far)


def peak(passed: Array) -> float:
    """Return the largest of values, also between them."""
    return float((np.maximum(passed[:-1], passed[1:]) + above(passed)).max())
