"""One arm's step of the object's filter, rigid or row by row, against the dense formulas."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast.dynamics.closed.factored_mobility import factored
from holdfast.dynamics.closed.filter_updates import independent_rows, rigid_update, row_updates
from holdfast.dynamics.closed.measurement import Measurement
from tests.dynamics.problems import relative_gap

seeds = pytest.mark.parametrize("seed", range(8))


def definite(rng, n: int, rank: int | None = None) -> np.ndarray:
    """Return a random positive semidefinite matrix."""
    X = rng.normal(size=(n, rank or n + 3))
    return X @ X.T


def drawn(seed: int, rows: int, rank: int | None = None):
    """Return x, P, an arm's measurement, the size of P and a wrench s."""
    rng = np.random.default_rng(seed)
    P = definite(rng, 6)
    C = np.eye(6) if rows == 6 else rng.normal(size=(rows, 6))
    R, r = definite(rng, rows, rank), rng.normal(size=rows)
    extent, angular = np.array([np.trace(R), np.trace(R), np.trace(R), 1.0]), (True,) * (rows - 1) + (False,)
    m = Measurement(C, R, r, extent, angular, most=rank or rows, carried=rows == 6)
    return rng.normal(size=6), P, m, np.full(3, np.trace(P)), rng.normal(size=6)


def expected(x, P, m: Measurement, s):
    """Return x, P and C^T lambda by NumPy: S = R + C P C^T."""
    C, S = m.C, m.R + m.C @ P @ m.C.T
    nu = np.linalg.solve(S, m.r - C @ x)
    gain = np.linalg.solve(S, C @ P)
    return x + P @ C.T @ nu, P - P @ C.T @ gain, C.T @ (nu - gain @ s)


@seeds
@pytest.mark.parametrize("rank", [None, 4, 1])
def test_rigid_update(seed, rank):
    """The parallel sum P (P + R)^-1 R, also of a singular R: six rows at once."""
    x, P, m, size, s = drawn(seed, 6, rank)
    got_x, got_P, step = rigid_update(x, P, m, size)
    for got, want in zip((got_x, got_P, step.back_substitute(s)), expected(x, P, m, s), strict=True):
        assert np.abs(got - want).max() < 1e-9 * max(np.abs(want).max(), np.abs(P).max())
    np.testing.assert_array_equal(got_P, got_P.T)
    assert step.kept == 6
    assert 0 < step.weakest <= 1


@seeds
@pytest.mark.parametrize(("rows", "rank"), [(5, None), (4, None), (3, None), (5, 3), (4, 1)])
def test_row_updates(seed, rows, rank):
    """Independent rows one by one give the same; rows along which the arm cannot move included."""
    x, P, m, size, s = drawn(seed, rows, rank)
    got_x, factors, step = row_updates(x, factored(P, np.diag(P)), m, size)
    for got, want in zip((got_x, factors.dense(), step.back_substitute(s)), expected(x, P, m, s), strict=True):
        assert np.abs(got - want).max() < 1e-9 * max(np.abs(want).max(), np.abs(P).max())
    assert step.kept == rows
    assert min(factors.D) >= 0


@seeds
@pytest.mark.parametrize("rank", [None, 3])
def test_independent_rows(seed, rank):
    """sum c c^T / d is C^T R^-1 C: the rows carry the same information, null pivots last."""
    _, _, m, size, _ = drawn(seed, 5, rank)
    scale = m.pivot_sizes(size)
    d, rows, _ = independent_rows(m, scale, m.typical_pivots(size))
    assert int((np.array(d) > 1e-12).sum()) == (rank or 5)
    assert all(x == 0.0 for x in d[rank or 5 :])
    np.testing.assert_allclose(sorted(rows[:, 7]), sorted(scale), rtol=1e-15)
    if rank is None:
        information = sum(np.outer(row[:6], row[:6]) / x for x, row in zip(d, rows, strict=True))
        assert relative_gap(information, m.C.T @ np.linalg.solve(m.R, m.C)) < 1e-8


def test_rows_seen_before():
    """A second arm that says the same and cannot yield adds no rank and no force of its own."""
    x, P, m, size, s = drawn(0, 4)
    hard = replace(m, R=np.zeros((4, 4)), r=m.C @ np.arange(6.0))
    x1, once, first = row_updates(x, factored(P, np.diag(P)), hard, size)
    x2, twice, second = row_updates(x1, once, hard, size)
    assert (first.kept, second.kept) == (4, 0)
    np.testing.assert_array_equal(twice.dense(), once.dense())
    np.testing.assert_allclose(x2, x1, atol=1e-12)
    np.testing.assert_allclose(m.C @ x1, hard.r, atol=1e-9)
    np.testing.assert_array_equal(second.back_substitute(s), np.zeros(6))


def test_factors():
    """`factored` takes a mobility apart into sum D w w^T, null directions as zeros, the largest first."""
    rng = np.random.default_rng(3)
    for P in (definite(rng, 6), definite(rng, 6, 4), np.zeros((6, 6))):
        F = factored(P, np.full(6, max(1.0, np.trace(P))))
        np.testing.assert_allclose(F.dense(), P, atol=1e-12 * max(1.0, np.abs(P).max()))
        assert min(F.D) >= 0
        assert sorted(F.D, reverse=True) == F.D
        assert sum(D > 0 for D in F.D) == np.linalg.matrix_rank(P)
        f = rng.normal(size=6)
        np.testing.assert_allclose(F.apply(f), P @ f, atol=1e-12 * max(1.0, np.abs(P).max()))
