"""Searches in a bracket: minima and zeros of functions known in closed form."""

import math

import numpy as np
import pytest

from holdfast.simulation.bracket import crossing, search_lowest, together


def counted(f):
    """Return the function, and the list of places it was asked at."""
    asked = []

    def g(x):
        asked.append(x)
        return f(x)

    return g, asked


SHAPES = {  # (f of the distance from its lowest point, how much too high at most, most evaluations)
    "parabola": (lambda d: 3 * d * d - 1, 1e-15, 8),
    "cosine": (lambda d: 0.7 - math.cos(3 * d), 1e-13, 15),
    "skew": (lambda d: math.exp(8 * d) - 8 * d, 1e-11, 25),
    "kink": (lambda d: max(3 * d, -0.5 * d), 1e-6, 60),
    "step and slope": (lambda d: -d if d < 0 else 1 + d, 1e-6, 60),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_lowest(shape):
    """The minimum is found to rounding, at a kink to the precision of its place, in few evaluations."""
    f, most_above, most = SHAPES[shape]
    rng = np.random.default_rng(1)
    for place in rng.uniform(0.1, 0.9, 50):
        g, asked = counted(lambda x, place=place: f(x - place))
        inside = place + rng.uniform(-0.05, 0.0)
        ((x, value),) = together([search_lowest(0.0, inside, 1.0, 1e-7)], lambda places, g=g: [g(places[0])])
        assert value == g(x)
        assert value - f(0.0) <= most_above
        assert len(asked) <= most


@pytest.mark.parametrize("f", [lambda d: d, math.sinh, lambda d: d**3, lambda d: 1.0 if d > 0 else -1.0, math.atan])
@pytest.mark.parametrize("down", [1.0, -1.0])
def test_crossing(f, down):
    """The zero is found to 1e-13 from either end, and the place returned lies on the far side of it."""
    for place in np.random.default_rng(2).uniform(0.05, 0.95, 50):
        g, asked = counted(lambda x, place=place: down * f(x - place))
        for a, b in ((0.0, 1.0), (1.0, 0.0)):
            x = crossing(g, a, g(a), b, g(b), 1e-13)
            assert x == pytest.approx(place, abs=1.1e-13)
            assert (g(x) < 0) == (g(b) < 0)
        assert len(asked) < 150


def test_searches_go_side_by_side():
    """Several at once find what each finds alone, and ask for all their places in one call a round."""
    lows, calls = [0.2, 0.5, 0.9], []

    def values(asked):
        calls.append(len(asked))
        return [(x - lows[k]) ** 2 - k for k, x in asked.items()]

    found = together([search_lowest(0.0, low, 1.0, 1e-7) for low in lows], values)
    assert [x for x, _ in found] == pytest.approx(lows, abs=1e-6)
    assert [value for _, value in found] == pytest.approx([0.0, -1.0, -2.0], abs=1e-12)
    assert calls[0] == 3
    assert len(calls) < 40
    assert together([], values) == []
