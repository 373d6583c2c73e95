"""Small factorisations against NumPy, with null pivots, and on other scalars."""

import mpmath
import numpy as np
import pytest

from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution, ldl, ldl_solve
from tests.spatial.dual import duals, slopes_of

sizes = pytest.mark.parametrize("n", [1, 2, 3, 6, 12])


def definite(n: int, seed: int = 0) -> np.ndarray:
    """Return a well conditioned positive definite matrix."""
    X = np.random.default_rng(seed).normal(size=(n, n + 3))
    return X @ X.T


def deficient(n: int, rank: int, seed: int = 0) -> np.ndarray:
    """Return a positive semidefinite matrix of a rank, exact: its entries are small integers."""
    X = np.random.default_rng(seed).integers(-4, 5, size=(n, rank)).astype(float)
    return X @ X.T


def exact(matrix, scalar) -> np.ndarray:
    """Return the matrix with entries of another kind."""
    return np.vectorize(scalar, otypes=[object])(matrix)


@sizes
def test_cholesky(n):
    """C C^T = S, C lower triangular with positive diagonal: NumPy's factor."""
    S = definite(n)
    C = cholesky(S)
    np.testing.assert_array_equal(C, np.tril(C))
    np.testing.assert_allclose(C, np.linalg.cholesky(S), rtol=1e-12, atol=1e-12)


@sizes
@pytest.mark.parametrize("columns", [(), (4,)])
def test_triangular_solves(n, columns):
    """L y = b and L^T x = b, for one right-hand side and for several."""
    L, b = np.linalg.cholesky(definite(n)), np.random.default_rng(n).normal(size=(n, *columns))
    np.testing.assert_allclose(forward_substitution(L, b), np.linalg.solve(L, b), rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(back_substitution(L, b), np.linalg.solve(L.T, b), rtol=1e-10, atol=1e-11)


@sizes
@pytest.mark.parametrize("columns", [(), (4,)])
def test_ldl(n, columns):
    """L D L^T = S with unit diagonal; solving inverts S; nothing is dropped."""
    S, b = definite(n), np.random.default_rng(n).normal(size=(n, *columns))
    factors = ldl(S, np.diag(S))
    np.testing.assert_allclose((factors.L * factors.pivots) @ factors.L.T, S, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(np.diag(factors.L), np.ones(n))
    np.testing.assert_allclose(factors.pivots * factors.inverse_pivots, np.ones(n), rtol=1e-15)
    assert factors.kept == n
    assert factors.weakest == pytest.approx((factors.pivots / np.diag(S)).min(), rel=1e-12)
    np.testing.assert_allclose(ldl_solve(factors, b), np.linalg.solve(S, b), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("n", "rank"), [(3, 1), (6, 3), (6, 5), (9, 4), (4, 0)])
def test_masked_pivots(n, rank):
    """The rank is counted, dropped pivots are 0 both ways, and S x = b is solved where it can be."""
    for seed in range(5):
        S = deficient(n, rank, seed)
        true_rank = int(np.linalg.matrix_rank(S))
        factors = ldl(S, np.diag(S))
        assert factors.kept == true_rank
        dropped = factors.pivots == 0
        assert dropped.sum() == n - true_rank
        np.testing.assert_array_equal(factors.inverse_pivots[dropped], 0)
        b = S @ np.random.default_rng(seed).normal(size=n)
        np.testing.assert_allclose(S @ ldl_solve(factors, b), b, atol=1e-9 * max(1.0, np.abs(b).max()))


def test_scale_decides_what_is_null():
    """A pivot counts against the size its row had before; the tolerance is relative."""
    S = np.diag([1.0, 1e-13, 1e-20])
    assert ldl(S, np.ones(3)).kept == 1
    assert ldl(S, np.array([1.0, 1e-13, 1e-20])).kept == 3
    assert ldl(S, np.ones(3), 1e-15).kept == 2
    assert ldl(S, np.array([1.0, 1e-5, 1e-20])).weakest == pytest.approx(1e-8)


def test_negative_pivots_are_dropped():
    """Rounding can leave a pivot a little below zero: it is null, never a division by it."""
    factors = ldl(np.array([[1.0, 1.0], [1.0, 1.0 - 1e-15]]), np.ones(2))
    assert factors.kept == 1
    assert factors.inverse_pivots[1] == 0.0


def test_many_digits():
    """On 60-digit scalars Hilbert's matrix, hopeless in floats, is solved to 40 digits."""
    with mpmath.workdps(60):
        n = 12
        S = np.array([[mpmath.mpf(1) / (i + j + 1) for j in range(n)] for i in range(n)])
        x = exact(np.arange(1, n + 1), mpmath.mpf)
        for solution in (
            ldl_solve(ldl(S, np.diag(S), 1e-50), S @ x),
            back_substitution(cholesky(S), forward_substitution(cholesky(S), S @ x)),
        ):
            assert max(abs(solution - x)) < mpmath.mpf(10) ** -40


def test_derivatives():
    """d(S^-1 b) = S^-1 (db - dS S^-1 b): factorising and solving run on other scalars."""
    rng = np.random.default_rng(7)
    S, dS, b, db = definite(6), definite(6, 1), *rng.normal(size=(2, 6))
    given, wanted = duals(S, dS), np.linalg.solve(S, db - dS @ np.linalg.solve(S, b))
    by_ldl = ldl_solve(ldl(given, np.diag(given)), duals(b, db))
    C = cholesky(given)
    by_cholesky = back_substitution(C, forward_substitution(C, duals(b, db)))
    for x in (by_ldl, by_cholesky):
        np.testing.assert_allclose(slopes_of(x), wanted, rtol=1e-9, atol=1e-9)
