"""A five-bar linkage in two coordinates, in the complex plane, to any number of digits.

Coordinates are the attitudes phi_1, phi_2 of the left arm's links; the right arm's follow from
where its tip is (two circles). A vector fixed in a link of attitude phi is z e^(i phi) and
moves at i phi' z e^(i phi). Newton's and Euler's laws along the linkage's two ways of moving
are what is solved: no spatial operators, no constraint forces, no projection.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np

from tests.systems.five_bar import FiveBar

DIGITS = 30
ROWS = 12  # of the extrapolation: order 24
# turns e^(i phi) of the links, their rates along both ways of moving, their rates -> generalised forces, two
Pulls = Callable[[list, list, list], list]


class Motion:
    """A linkage through time, to 30 digits."""

    def __init__(self, bar: FiveBar, angles, rates, pulls: Pulls | None = None):
        """Start at attitudes [rad] and rates [rad/s] of the left arm's links, two each."""
        self.bar, self.pulls = bar, pulls
        self.context: Any = mpmath.mp.clone()  # the process-wide setting stays as it was
        self.context.dps = DIGITS
        self.start = np.array([self.context.mpf(x) for x in (*angles, *rates)])

    def after(self, duration: float, steps: int) -> np.ndarray:
        """Return (phi_1, phi_2, phi_1', phi_2') after a time, by so many equal steps."""
        step = self.context.mpf(duration) / steps
        return integrated(lambda y: rate(self.bar, y, self.context, self.pulls), self.start, step, steps, ROWS)

    def links(self, y: np.ndarray) -> tuple[list[float], list[float]]:
        """Return attitudes [rad] and rates [rad/s] of all four links."""
        turns = attitudes(self.bar, y[:2], self.context)
        found = [float(self.context.arg(turn)) for turn in turns]
        return found, [float(x) for x in spins(self.bar, y, self.context)]


def attitudes(bar: FiveBar, phi, context: Any) -> list:
    """Return e^(i phi) of the four links, in the arithmetic of an mpmath context."""
    first, second = (context.expj(x) for x in phi)
    third, fourth = (context.mpf(b.length) for b in bar.bars[2:])
    reach = first * bar.bars[0].length + second * across(bar) - bar.span
    distance = abs(reach)
    bend = context.acos((third**2 + distance**2 - fourth**2) / (2 * third * distance))
    elbow = reach / distance * context.expj(bend)
    return [first, second, elbow, (reach - third * elbow) / fourth]


def across(bar: FiveBar) -> complex:
    """Return the right contact from the left outer joint, in the outer link's axes [m]."""
    return bar.bars[1].length - bar.left + bar.right


def spins(bar: FiveBar, y: np.ndarray, context: Any) -> list:
    """Return the rates of the four links for y = (phi_1, phi_2, phi_1', phi_2') [rad/s]."""
    ways = _ways(_loop(bar, attitudes(bar, y[:2], context)))
    return [ways[0][j] * y[2] + ways[1][j] * y[3] for j in range(4)]


def rate(bar: FiveBar, y: np.ndarray, context: Any, pulls: Pulls | None = None) -> np.ndarray:
    """Return y' of y = (phi_1, phi_2, phi_1', phi_2') under gravity, and what else pulls along both ways of moving."""
    e = attitudes(bar, y[:2], context)
    loop = _loop(bar, e)
    ways, s = _ways(loop), spins(bar, y, context)
    # the loop's acceleration is sum (i phi'' - phi'^2) z = 0; with phi_1'' = phi_2'' = 0:
    held = [0, 0, *_closing(loop, -1j * sum(w * w * z for w, z in zip(s, loop, strict=True)))]
    M, load = [[0, 0], [0, 0]], [0, 0] if pulls is None else pulls(e, ways, s)
    for mass, inertia, link, arms in _bodies(bar):
        zs = [arm * turn for arm, turn in zip(arms, e, strict=True)]
        moving = [sum(1j * u * z for u, z in zip(way, zs, strict=True)) for way in ways]
        weighed = sum((1j * a - w * w) * z for a, w, z in zip(held, s, zs, strict=True)) + 9.81j
        for k in (0, 1):
            load[k] -= mass * (moving[k].conjugate() * weighed).real + inertia * ways[k][link] * held[link]
            for j in (0, 1):
                M[k][j] += mass * (moving[k].conjugate() * moving[j]).real + inertia * ways[k][link] * ways[j][link]
    pivot = M[0][0] * M[1][1] - M[0][1] * M[1][0]
    return np.array(
        [*y[2:], (M[1][1] * load[0] - M[0][1] * load[1]) / pivot, (M[0][0] * load[1] - M[1][0] * load[0]) / pivot]
    )


def _loop(bar: FiveBar, e: list) -> list:
    """Return the vectors once round the loop, which sum to the span."""
    lengths = (bar.bars[0].length, across(bar), -bar.bars[2].length, -bar.bars[3].length)
    return [length * turn for length, turn in zip(lengths, e, strict=True)]


def _ways(loop: list) -> list[list]:
    """Return the four rates of each of the two ways of moving, phi_1' = 1 or phi_2' = 1."""
    return [[1, 0, *_closing(loop, -loop[0])], [0, 1, *_closing(loop, -loop[1])]]


def _closing(loop: list, total) -> tuple:
    """Return the real s, t with s z_3 + t z_4 = total."""
    z, w = loop[2], loop[3]
    area = (z * w.conjugate()).imag
    return (total * w.conjugate()).imag / area, -(total * z.conjugate()).imag / area


def _bodies(bar: FiveBar) -> list[tuple]:
    """Return per body its mass, its inertia, its link, and what each link carries its mass centre by."""
    inner, outer, third, fourth = bar.bars
    return [
        (inner.mass, inner.inertia, 0, (inner.com, 0, 0, 0)),
        (outer.mass, outer.inertia, 1, (inner.length, outer.com, 0, 0)),
        (bar.object_mass, bar.object_inertia, 1, (inner.length, outer.length - bar.left, 0, 0)),
        (third.mass, third.inertia, 2, (0, 0, third.com, 0)),
        (fourth.mass, fourth.inertia, 3, (0, 0, third.length, fourth.com)),
    ]


def integrated(rate: Callable[[np.ndarray], np.ndarray], y: np.ndarray, step, steps: int, rows: int) -> np.ndarray:
    """Return y after some equal steps of y' = rate(y), each of order 2 * rows, to any number of digits.

    The error of Gragg's n substeps holds even powers of 1/n only, so Aitken-Neville's table over
    n = 2, 4, 6 ... gains two orders a row (Bulirsch and Stoer).
    """
    for _ in range(steps):
        y = extrapolated_step(rate, y, step, rows)
    return y


def extrapolated_step(rate: Callable[[np.ndarray], np.ndarray], y: np.ndarray, step, rows: int) -> np.ndarray:
    """Return y one step later, to order 2 * rows; rows * (rows + 1) + 1 evaluations."""
    first, table = rate(y), []
    for j in range(1, rows + 1):
        row = [_gragg(rate, y, first, step, 2 * j)]
        for k, before in enumerate(table, start=1):
            squared = (j * j - (j - k) ** 2) / _exact((j - k) ** 2, step)  # (n_j / n_(j-k))^2 - 1
            row.append(row[-1] + (row[-1] - before) / squared)
        table = row
    return table[-1]


def _gragg(rate: Callable, y: np.ndarray, first: np.ndarray, step, substeps: int) -> np.ndarray:
    """Return the midpoint rule's result after some substeps, smoothed."""
    h = step / substeps
    before, now = y, y + h * first
    for _ in range(substeps - 1):
        before, now = now, before + 2 * h * rate(now)
    return (before + now + h * rate(now)) / 2


def _exact(number: int, like):
    """Return a whole number as a scalar of the same kind."""
    return like * 0 + number
