"""The largest least of several margins: by hand, against a search that knows no calculus, and at infinity."""

import numpy as np
import pytest

from holdfast.forces.cone_program import AffineMargin, largest_least

MU = 0.5


def friction(f, N) -> list[AffineMargin]:
    """Return a ball contact's margins for a force f + N z."""
    f, N = np.asarray(f, dtype=float), np.asarray(N, dtype=float)
    return [
        AffineMargin(MU * f[2], MU * N[2], f[:2], N[:2]),
        AffineMargin(f[2], N[2], np.zeros(1), 0 * N[:1]),
    ]


def strength(force, f, N) -> AffineMargin:
    """Return the margin of a force limit."""
    return AffineMargin(force, np.zeros(np.shape(N)[1]), np.asarray(f, dtype=float), np.asarray(N, dtype=float))


def searched(margins: list[AffineMargin], k: int, seed: int) -> float:
    """Return the best of many random steps of falling length."""
    rng = np.random.default_rng(seed)

    def least(z):
        return np.min([m.c + z @ m.a - np.linalg.norm(m.b + z @ m.B.T, axis=1) for m in margins], axis=0)

    best, z, reach = -np.inf, np.zeros(k), 100.0
    while reach > 1e-6:
        tried = np.vstack([z, z + reach * rng.normal(size=(400, k))])
        values = least(tried)
        reach *= 2.0 if values.max() > best + 1e-3 * reach else 0.5
        best, z = max(best, values.max()), tried[values.argmax()]
    return best


@pytest.mark.parametrize("seed", range(8))
def test_against_a_search(seed):
    """No random step finds more, and the best of them comes as near as it can."""
    rng = np.random.default_rng(seed)
    k, margins = 1 + seed % 3, []
    for i in range(1 + seed % 4):
        f, N = 10 * rng.normal(size=3), rng.normal(size=(3, k))
        margins += [strength(60.0, f, N)] if i == 0 else friction(f, N)
    found, best = largest_least(margins), searched(margins, k, seed)
    assert best <= found + 1e-8 * 60
    assert best == pytest.approx(found, abs=1e-3)


@pytest.mark.parametrize(("slope", "best"), [(-1e-4, -1.0), (0.0, -1.0), (1e-4, np.inf)])
def test_along_the_cone(slope, best):
    """Along the cone's edge a margin approaches a bound it never reaches; a little inside it grows for ever."""
    margins = friction([3.0, -2.0, 4.0], [[MU * (1 - slope)], [0.0], [1.0]])
    assert largest_least(margins) == pytest.approx(best, abs=0.05 if slope else 1e-4)


def test_nothing_to_choose():
    """Margins that no internal force changes are what they are, directions without effect notwithstanding."""
    fixed = strength(5.0, [3.0, 0, 0], np.zeros((3, 4)))
    assert largest_least([fixed]) == 2.0
    assert largest_least([fixed, *friction([0, 0, 9.0], np.eye(3, 4))]) == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_scales(size):
    """Newtons or meganewtons: the answer scales with the forces."""
    rng = np.random.default_rng(3)
    f, N = rng.normal(size=3), rng.normal(size=(3, 2))
    unit = largest_least([*friction(f, N), strength(4.0, f, N)])
    scaled = largest_least([*friction(size * f, N), strength(4.0 * size, size * f, N)])
    assert scaled == pytest.approx(size * unit, rel=1e-8)
