"""Gauss elimination: random, badly scaled and singular systems."""

import mpmath
import numpy as np
import pytest

from holdfast.spatial.linalg import gauss_solve


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


def test_many_digits():
    """Pivots are chosen by value; the arithmetic is the scalars' own."""
    with mpmath.workdps(60):
        n = 10
        A = np.array([[mpmath.mpf(1) / (i + j + 1) for j in range(n)] for i in range(n)])
        x = np.array([mpmath.mpf(k + 1) for k in range(n)])
        solution, nullity = gauss_solve(A, A @ x)
        assert nullity == 0
        assert max(abs(solution - x)) < mpmath.mpf(10) ** -40
