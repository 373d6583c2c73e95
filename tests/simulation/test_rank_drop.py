"""Where matrices along a path lose rank: built from singular values that are known functions."""

import numpy as np
import pytest

from holdfast.simulation.singular_configuration import ConstraintFactors, rank_drop

ROWS, COLUMNS = 11, 9


def path(values, seed=0, turning=1.0):
    """Return factors of matrices with given singular values, their vectors turning smoothly; and how often asked."""
    random = np.random.default_rng(seed)
    left, right = (random.normal(size=(n, n)) for n in (ROWS, COLUMNS))
    left, right = left - left.T, right - right.T

    def turned(skew, t):
        w, V = np.linalg.eig(turning * t * skew / np.linalg.norm(skew))
        return ((V * np.exp(w)) @ np.linalg.inv(V)).real

    def factors(t):
        s = np.array(values(t))
        U, V = turned(left, t), turned(right, t)
        U, s, Vt = np.linalg.svd(U[:, : len(s)] * s @ V[:, : len(s)].T, full_matrices=False)
        return ConstraintFactors(U, s / s[0], Vt)

    return factors


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("at", [0.013, 0.31, 0.5, 0.72, 0.998])
def test_one_value_passes_through_zero(seed, at):
    found = rank_drop(path(lambda t: [3.0, 1.0 + t, 0.5, 0.2 * (t - at) * (2 + t)], seed), 0.0, 1.0, 4)
    assert found is not None and found.through
    assert found.at == pytest.approx(at, abs=1e-9) and found.rank == 3


@pytest.mark.parametrize("seed", range(5))
def test_several_pass_through_zero_at_once(seed):
    """An even number of them changes no determinant's sign."""
    found = rank_drop(path(lambda t: [3.0, 1.0, 0.4 * (t - 0.3), -0.2 * (t - 0.3)], seed), 0.0, 1.0, 4)
    assert found is not None and found.through
    assert found.at == pytest.approx(0.3, abs=1e-8) and found.rank == 2


def test_the_first_of_two():
    found = rank_drop(path(lambda t: [3.0, 1.0, 0.4 * (t - 0.3), 0.2 * (t - 0.4)]), 0.0, 1.0, 4)
    assert found is not None and found.at == pytest.approx(0.3, abs=1e-8) and found.rank == 3


def test_zero_is_touched():
    found = rank_drop(path(lambda t: [3.0, 1.0, 0.5, 0.7 * (t - 0.4) ** 2]), 0.0, 1.0, 4)
    assert found is not None and not found.through
    assert found.at == pytest.approx(0.4, abs=1e-3) and found.rank == 3


@pytest.mark.parametrize("least", [1e-3, 1e-2, 0.1])
def test_a_dip_above_zero(least):
    values = path(lambda t: [3.0, 1.0, 0.5, np.hypot(least, t - 0.4)])
    assert rank_drop(values, 0.0, 1.0, 4) is None


def test_vectors_that_turn():
    """Singular values that change places, and subspaces that turn by a radian, are no loss of rank."""
    for seed in range(20):
        values = path(lambda t: [1.0, 0.5 + t, 0.9 - t / 2, 0.3 + 0.1 * np.sin(9 * t)], seed, turning=2.0)
        assert rank_drop(values, 0.0, 1.0, 4) is None
