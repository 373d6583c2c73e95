"""Bierman's update is P - k k^T / sigma, without the subtraction."""

import mpmath
import numpy as np
import pytest

from holdfast.dynamics.closed.factored_mobility import FactoredMobility, updated
from tests.systems.problems import relative_gap


def drawn(seed: int, spread: float = 0.0) -> tuple[np.random.Generator, FactoredMobility]:
    """Return a random mobility; its factors spread over 10^+-spread."""
    rng = np.random.default_rng(seed)
    D = list(10.0 ** rng.uniform(-spread, spread, 6))
    return rng, FactoredMobility(D, list(rng.normal(size=(6, 6))))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [0.0, 1e-3, 1.0, 1e3])
def test_update(seed, noise):
    """P - k k^T / sigma, k = P c, sigma = c P c + d; with d = 0 the row is held fast."""
    rng, P = drawn(seed)
    c = rng.normal(size=6)
    after, k, sigma, alive = updated(P, c, noise, 0.0)
    dense = P.dense()
    assert alive
    assert relative_gap(k, dense @ c) < 1e-13
    assert sigma == pytest.approx(c @ dense @ c + noise, rel=1e-13)
    assert np.abs(after.dense() - (dense - np.outer(k, k) / sigma)).max() < 1e-13 * np.abs(dense).max()
    assert np.abs(P.apply(c) - dense @ c).max() < 1e-13 * np.abs(dense @ c).max()
    assert min(after.D) >= 0
    if noise == 0.0:
        assert np.abs(after.dense() @ c).max() < 1e-13 * np.abs(dense).max()


@pytest.mark.parametrize("seed", range(4))
def test_no_digits_are_lost(seed):
    """A mobility spread over 16 decades, measured by stiff rows: 1e-11 of the 80-digit answer."""
    rng, P = drawn(seed, spread=8.0)
    rows, noises = rng.normal(size=(6, 6)), 10.0 ** rng.uniform(-8, 0, 6)
    with mpmath.workdps(80):
        exact = mpmath.zeros(6)
        for D, w in zip(P.D, P.w, strict=True):
            exact += mpmath.mpf(D) * mpmath.matrix(w) * mpmath.matrix(w).T
        for c, d in zip(rows, noises, strict=True):
            k = exact * mpmath.matrix(c)
            exact -= k * k.T / ((mpmath.matrix(c).T * k)[0] + mpmath.mpf(d))
        expected = np.array(exact.tolist(), dtype=float)
    for c, d in zip(rows, noises, strict=True):
        P, *_ = updated(P, c, d, 0.0)
    # entry by entry, in the units of its row and column
    size = np.sqrt(np.diag(expected))
    assert np.abs((P.dense() - expected) / np.outer(size, size)).max() < 1e-11
