"""One arm's step of the object's filter, rigid or row by row, against the dense formulas."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast.dynamics.closed.factored_mobility import factored
from holdfast.dynamics.closed.filter_updates import independent_rows, parallel_sum, row_sums, terminal_sum
from holdfast.dynamics.closed.measurement import Measurement
from tests.dynamics.problems import relative_gap

seeds = pytest.mark.parametrize("seed", range(8))


def definite(rng, n: int, rank: int | None = None) -> np.ndarray:
    """Return a random positive semidefinite matrix."""
    X = rng.normal(size=(n, rank or n + 3))
    return X @ X.T


def drawn(seed: int, rows: int, rank: int | None = None):
    """Return x with two columns X, P, an arm's measurement, the size of P, a wrench s and accelerations beta."""
    rng = np.random.default_rng(seed)
    P = definite(rng, 6)
    C = np.eye(6) if rows == 6 else rng.normal(size=(rows, 6))
    R, r = definite(rng, rows, rank), rng.normal(size=rows)
    extent, angular = np.array([np.trace(R), np.trace(R), np.trace(R), 1.0]), (True,) * (rows - 1) + (False,)
    X = rng.normal(size=(rows, 2))
    m = Measurement(C, R, r, X, extent, angular, most=rank or rows, carried=rows == 6)
    x, X, beta = rng.normal(size=6), rng.normal(size=(6, 2)), rng.normal(size=2)
    return x, X, P, m, np.full(3, np.trace(P)), rng.normal(size=6), beta


def expected(x, X, P, m: Measurement, s, beta):
    """Return x, X, P, load and inertia of the columns, and C^T lambda by NumPy: S = R + C P C^T."""
    C, S = m.C, m.R + m.C @ P @ m.C.T
    E = m.X - C @ X
    nu, columns = np.linalg.solve(S, m.r - C @ x), np.linalg.solve(S, E)
    gain = np.linalg.solve(S, C @ P)
    wrench = C.T @ (nu + columns @ beta - gain @ s)
    return x + P @ C.T @ nu, X + P @ C.T @ columns, P - P @ C.T @ gain, E.T @ nu, E.T @ columns, wrench


def gaps(got, P, want) -> list[float]:
    """Return the differences, relative to the larger of what is wanted and P."""
    pairs = zip(got, want, strict=True)
    return [float(np.abs(a - b).max() / max(np.abs(b).max(), np.abs(P).max())) for a, b in pairs]


@seeds
@pytest.mark.parametrize("rank", [None, 4, 1])
def test_parallel_sum(seed, rank):
    """The parallel sum P (P + R)^-1 R, also of a singular R: six rows at once, for any right-hand side."""
    x, X, P, m, size, s, beta = drawn(seed, 6, rank)
    included, step = parallel_sum(X, P, m, size)
    got_x, load, nu = step.forward(x, m.r)
    got = got_x, included.X, included.P, load, included.N, step.back(s, nu, beta)
    assert max(gaps(got, P, expected(x, X, P, m, s, beta))) < 1e-9
    np.testing.assert_array_equal(included.P, included.P.T)
    assert included.kept == 6
    assert 0 < included.weakest <= 1


@seeds
@pytest.mark.parametrize("rank", [None, 4, 1])
def test_terminal_sum(seed, rank):
    """The last arm in fewer operations: acceleration, wrench and the load of the external wrench w = s."""
    x, X, P, m, size, w, beta = drawn(seed, 6, rank)
    included, step = terminal_sum(X, P, m, size)
    load, kept = step.forward(x, m.r, w)
    alpha, wrench = step.back(kept, beta)
    x_after, X_after, P_after, load_after, N, last = expected(x, X, P, m, w, beta)
    want = P_after, load_after - X_after.T @ w, N, x_after + X_after @ beta + P_after @ w, last
    assert max(gaps((included.P, load, included.N, alpha, wrench), P, want)) < 1e-9


@seeds
@pytest.mark.parametrize(("rows", "rank"), [(5, None), (4, None), (3, None), (5, 3), (4, 1)])
def test_row_sums(seed, rows, rank):
    """Independent rows one by one give the same; rows along which the arm cannot move included."""
    x, X, P, m, size, s, beta = drawn(seed, rows, rank)
    included, step = row_sums(X, factored(P, np.diag(P)), m, m.pivot_sizes(size), m.typical_pivots(size))
    got_x, load, nu = step.forward(x, m.r)
    got = got_x, included.X, included.P.dense(), load, included.N, step.back(s, nu, beta)
    assert max(gaps(got, P, expected(x, X, P, m, s, beta))) < 1e-9
    assert included.kept == rows
    assert min(included.P.D) >= 0


@seeds
@pytest.mark.parametrize("rank", [None, 3])
def test_independent_rows(seed, rank):
    """sum c c^T / d is C^T R^-1 C: the rows carry the same information, null pivots last."""
    _, _, _, m, size, _, _ = drawn(seed, 5, rank)
    scale = m.pivot_sizes(size)
    found = independent_rows(m, scale, m.typical_pivots(size))
    assert int((np.array(found.d) > 1e-12).sum()) == (rank or 5)
    assert all(x == 0.0 for x in found.d[rank or 5 :])
    np.testing.assert_allclose(sorted(found.sizes[:, 0]), sorted(scale), rtol=1e-15)
    if rank is None:
        information = sum(np.outer(row, row) / x for x, row in zip(found.d, found.C, strict=True))
        assert relative_gap(information, m.C.T @ np.linalg.solve(m.R, m.C)) < 1e-8


def test_rows_seen_before():
    """A second arm that says the same and cannot yield adds no rank and no force of its own."""
    x, X, P, m, size, s, beta = drawn(0, 4)
    hard = replace(m, R=np.zeros((4, 4)), r=m.C @ np.arange(6.0), X=m.C @ np.ones((6, 2)))
    sizes = hard.pivot_sizes(size), hard.typical_pivots(size)
    once, first = row_sums(X, factored(P, np.diag(P)), hard, *sizes)
    twice, second = row_sums(once.X, once.P, hard, *sizes)
    x1 = first.forward(x, hard.r)[0]
    x2, _, nu = second.forward(x1, hard.r)
    assert (once.kept, twice.kept) == (4, 0)
    np.testing.assert_array_equal(twice.P.dense(), once.P.dense())
    np.testing.assert_allclose(x2, x1, atol=1e-12)
    np.testing.assert_allclose(m.C @ x1, hard.r, atol=1e-9)
    np.testing.assert_array_equal(second.back(s, nu, beta), np.zeros(6))


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
