"""Searches for the minimum and for the zero of a function of time within an interval.

Both searches shrink a bracket and need no derivative. A discontinuous slope makes them slower, not wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence

GOLDEN = 0.5 * (3.0 - math.sqrt(5.0))
MOST_EVALUATIONS = 100
EQUAL_VALUES = 1e-13  # values that differ by less (relatively, or absolutely below 1) are considered equal

RealFunction = Callable[[float], float]
Search = Generator[float, float, tuple[float, float]]


def together(
    searches: Sequence[Search], values_at: Callable[[Mapping[int, float]], Sequence[float]]
) -> list[tuple[float, float]]:
    """Return the results of several searches that advance together, so that one call evaluates all their points.

    Args:
        searches: each yields points and receives the values of its function there.
        values_at: returns the values at several points, each given with the number of its search.
    """
    found: dict[int, tuple[float, float]] = {}
    points = {k: next(search) for k, search in enumerate(searches)}
    while points:
        for k, value in zip(list(points), values_at(points), strict=True):
            try:
                points[k] = searches[k].send(value)
            except StopIteration as end:
                found[k] = end.value
                del points[k]
    return [found[k] for k in range(len(searches))]


def search_lowest(a: float, b: float, c: float, precision: float) -> Search:
    """Return a search for the minimum of a function in [a, c] (R. P. Brent, 1973).

    The next point is the vertex of the parabola through the three best points, or a golden section if parabolas do not
    shrink the bracket. The search ends when two parabolas in a row have found no lower value, or when the bracket is as
    small as the precision.

    Args:
        a: the bracket's lower end.
        b: a point between a and c at which the function is not larger than at either end.
        c: the bracket's upper end.
        precision: required precision of the minimum's position.

    Yields:
        Points; the caller sends back the value of the function at each.

    Returns:
        The position of the minimum and the value there.
    """
    points = []
    for place in (a, b, c):
        points.append(((yield place), place))
    (fx, x), (fw, w), (fv, v) = sorted(points)
    moved = before = c - a
    idle = 0
    for _ in range(MOST_EVALUATIONS):
        middle = 0.5 * (a + c)
        if max(x - a, c - x) <= 2.0 * precision or idle == 2:
            break
        step = _parabola_step(x, w, v, fx, fw, fv)
        if step is not None and a < x + step < c and abs(step) < 0.5 * abs(before):
            before, parabolic = moved, True
            if min(x + step - a, c - x - step) < 2.0 * precision:
                step = math.copysign(precision, middle - x)
        else:
            before, parabolic = (c if x < middle else a) - x, False
            step = GOLDEN * before
        moved = math.copysign(max(abs(step), precision), step)
        u = x + moved
        fu = yield u
        idle = idle + 1 if parabolic and abs(fu - fx) <= EQUAL_VALUES * max(1.0, abs(fx)) else 0
        if fu <= fx:
            a, c = (x, c) if u > x else (a, x)
            (v, fv), (w, fw), (x, fx) = (w, fw), (x, fx), (u, fu)
            continue
        a, c = (u, c) if u < x else (a, u)
        if fu <= fw or w == x:
            (v, fv), (w, fw) = (w, fw), (u, fu)
        elif fu <= fv or v in (x, w):
            v, fv = u, fu
    return x, fx


def _parabola_step(x: float, w: float, v: float, fx: float, fw: float, fv: float) -> float | None:
    """Return the distance from x to the vertex of the parabola through three points; None if they are collinear."""
    r, q = (x - w) * (fx - fv), (x - v) * (fx - fw)
    p, bend = (x - v) * q - (x - w) * r, 2.0 * (q - r)
    return -p / bend if bend != 0.0 else None


def crossing(f: RealFunction, a: float, fa: float, b: float, fb: float, precision: float) -> float:
    """Return a point at which f has changed sign between a and b (T. R. Chandrupatla's search, 1997).

    The search uses inverse quadratic interpolation where three points allow it, and bisection elsewhere.

    Args:
        f: the function.
        a: one end.
        fa: f(a).
        b: the other end.
        fb: f(b); exactly one of f(a) and f(b) is negative.
        precision: greatest distance from the zero to the returned point, at which f has the sign of f(b).
    """
    side = fb < 0.0
    good, bad = b, a  # points where f has the sign of f(b), and of f(a)
    x1, f1, x2, f2 = b, fb, a, fa
    t = 0.5
    for _ in range(MOST_EVALUATIONS):
        if abs(bad - good) <= precision:
            break
        x = x1 + t * (x2 - x1)
        if x in (good, bad):
            break  # no float64 lies between them
        fx = f(x)
        if (fx < 0.0) == (f1 < 0.0):
            (x3, f3), (x1, f1) = (x1, f1), (x, fx)
        else:
            (x3, f3), (x2, f2), (x1, f1) = (x2, f2), (x1, f1), (x, fx)
        good, bad = (x, bad) if (fx < 0.0) == side else (good, x)
        t = _inverse_quadratic(x1, f1, x2, f2, x3, f3)
        least = min(0.5, 0.5 * precision / abs(x2 - x1))
        t = min(1.0 - least, max(least, t))
    return good


def _inverse_quadratic(x1: float, f1: float, x2: float, f2: float, x3: float, f3: float) -> float:
    """Return the next point as a fraction of the way from x1 to x2."""
    if f3 in (f1, f2):
        return 0.5
    xi, phi = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
    if not (phi**2 < xi and (1.0 - phi) ** 2 < 1.0 - xi):
        return 0.5
    return f1 / (f2 - f1) * f3 / (f2 - f3) + (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (f3 - f2)
