"""Omega is the same by matrices and by recursion; it is solved, or refused."""

import numpy as np
import pytest

from holdfast import MethodNotApplicable
from holdfast.dynamics.closed.filtered_arm import filtered_arms
from holdfast.dynamics.closed.omega import Omega, omega_from_matrices, omega_recursive
from holdfast.dynamics.closed.stacked import block_diagonal
from tests.dynamics.closed.answered import nonrigid, rigid
from tests.dynamics.problems import relative_gap


@pytest.mark.parametrize("make", [rigid, nonrigid])
@pytest.mark.parametrize("seed", range(5))
def test_two_ways(make, seed):
    """(4.9c) from matrices and (6.11d, e) from recursions, symmetric, equal to (3.1)."""
    o = make(seed)
    for omega in (omega_from_matrices(o.stacked), omega_recursive(o.stacked, filtered_arms(o.motion))):
        assert relative_gap(omega.matrix, o.Omega) < 1e-11
        x = np.random.default_rng(seed).normal(size=(len(o.f), 2))
        assert relative_gap(omega.solve(omega.matrix @ x), x) < 1e-9


def test_refusals():
    """A singular matrix is refused with its nullity, a nearly singular one with its pivot."""
    with pytest.raises(MethodNotApplicable, match="its nullity is 2 of 5; try method='sequential'"):
        Omega(np.diag([1.0, 1.0, 1.0, 0.0, 0.0]))
    near = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-7]])
    with pytest.raises(MethodNotApplicable, match=r"smallest scaled pivot is 1\.0e-07: .*try method='sequential'"):
        Omega(near)


def test_block_diagonal():
    """Blocks in order, zeros elsewhere; blocks without columns and no blocks at all."""
    a, b, none = np.ones((1, 2)), 2 * np.ones((2, 1)), np.zeros((1, 0))
    expected = [[1, 1, 0], [0, 0, 0], [0, 0, 2], [0, 0, 2]]
    np.testing.assert_array_equal(block_diagonal([a, none, b]), expected)
    assert block_diagonal([]).shape == (0, 0)
