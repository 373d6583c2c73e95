"""Small factorisations against NumPy, with null pivots, and on other scalars; elimination of badly scaled systems."""

import mpmath
import numpy as np
import pytest

from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.spatial.linalg import (
    back_substitution,
    cholesky,
    forward_substitution,
    gauss_solve,
    in_range,
    ldl,
    ldl_solve,
    least_solution,
)
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


@pytest.mark.parametrize("n", [1, 2, 5, 12, 40])
def test_random(n):
    """The solution of a general system, pivots found wherever they are."""
    rng = np.random.default_rng(n)
    A, x = rng.normal(size=(n, n)), rng.normal(size=n)
    A[0, 0] = 0.0 if n > 1 else 1.0
    solution, nullity = gauss_solve(A, A @ x)
    assert nullity == 0
    np.testing.assert_allclose(solution, x, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_badly_scaled(seed):
    """Rows and columns in wild units (1e-12 to 1e12) cost no digits and are not called null."""
    rng = np.random.default_rng(seed)
    n = 10
    A, x = rng.normal(size=(n, n)) + 5 * np.eye(n), rng.uniform(1, 2, n)
    rows, columns = 10.0 ** rng.uniform(-12, 12, size=(2, n))
    solution, nullity = gauss_solve((A * columns) * rows[:, None], rows * (A @ x))
    assert nullity == 0
    np.testing.assert_allclose(solution * columns, x, rtol=1e-11)


def test_arguments_are_kept():
    """Neither the matrix nor the right-hand side is written to."""
    A, b = np.array([[0.0, 2.0], [4.0, 1.0]]), np.array([2.0, 5.0])
    copies = A.copy(), b.copy()
    np.testing.assert_allclose(gauss_solve(A, b)[0], [1.0, 1.0])
    np.testing.assert_array_equal(A, copies[0])
    np.testing.assert_array_equal(b, copies[1])


@pytest.mark.parametrize(("n", "nullity"), [(1, 1), (4, 1), (6, 3), (12, 5), (5, 5)])
def test_singular(n, nullity):
    """The nullity of a symmetric matrix of known rank is counted."""
    for seed in range(6):
        X = np.random.default_rng(seed).integers(-3, 4, size=(n, n - nullity)).astype(float)
        A = X @ X.T
        assert gauss_solve(A, np.ones(n))[1] == n - (np.linalg.matrix_rank(A) if n > nullity else 0)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_shift_matrix(n):
    """Ones above the diagonal: rank n - 1, so one null pivot, though no column starts with one."""
    assert gauss_solve(np.eye(n, k=1), np.zeros(n))[1] == 1


def test_many_digits_by_elimination():
    """Pivots are chosen by value; the arithmetic is the scalars' own."""
    with mpmath.workdps(60):
        n = 10
        A = np.array([[mpmath.mpf(1) / (i + j + 1) for j in range(n)] for i in range(n)])
        x = np.array([mpmath.mpf(k + 1) for k in range(n)])
        solution, nullity = gauss_solve(A, A @ x)
        assert nullity == 0
        assert max(abs(solution - x)) < mpmath.mpf(10) ** -40


@pytest.mark.parametrize(("m", "n", "rank"), [(1, 1, 1), (7, 4, 4), (4, 7, 4), (8, 9, 5), (5, 5, 0), (15, 10, 8)])
def test_part_in_range(m, n, rank):
    """As numpy's pseudo-inverse has it, however long the columns and however nearly some lie in one plane."""
    random = np.random.default_rng(m + n)
    A = random.normal(size=(m, rank)) @ random.normal(size=(rank, n))
    A[:, -1] = 0.0 if rank < n else A[:, -1]
    A[:, : n // 2] *= 1e-5
    b, sizes = random.normal(size=m), np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    expected = (A / sizes) @ (np.linalg.pinv(A / sizes, rcond=1e-10) @ b)
    assert np.abs(in_range(A, b, rank) - expected).max() < 1e-13


@pytest.mark.parametrize("apart", [1e-3, 1e-6])
def test_part_in_a_range_that_is_nearly_lost(apart):
    """Columns that differ by little span a plane as exactly as they are given; a trace of a third one is left out."""
    random = np.random.default_rng(0)
    basis, _ = np.linalg.qr(random.normal(size=(9, 3)))
    a, c, e = basis.T
    b = random.normal(size=9)
    found = in_range(np.array([a, a + apart * c, a - apart * c + 1e-14 * e]).T, b, 2)
    assert np.abs(found - (a @ b) * a - (c @ b) * c).max() < 1e-15 / apart + 1e-13 / apart


@pytest.mark.parametrize(("m", "n"), [(1, 1), (6, 7), (7, 3), (6, 12)])
def test_smallest_least_squares(m, n):
    """Solutions of all ranks are those of a singular value decomposition, also where they are traced."""
    random = np.random.default_rng(m + n)
    program = trace(lambda A, b: (least_solution(A, b),), [(m, n), (m,)])
    for rank in range(min(m, n) + 1):
        for _ in range(5):
            A, b = random.normal(size=(m, rank)) @ random.normal(size=(rank, n)), random.normal(size=m)
            expected = np.linalg.pinv(A, rcond=1e-6) @ b
            for found in (least_solution(A, b), interpret(program, A, b)[0]):
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * max(1.0, np.abs(expected).max()))
