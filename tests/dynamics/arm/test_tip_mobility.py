"""The mobility at the tip: Lambda = J M^-1 J^T."""

import numpy as np
import pytest

from holdfast.dynamics.arm.articulated import articulated_filter
from holdfast.dynamics.arm.free_dynamics import articulated
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import at_rest
from holdfast.dynamics.arm.tip_mobility import tip_mobility
from tests.dynamics.problems import random_motion, relative_gap

seeds = pytest.mark.parametrize("seed", range(8))


def in_world(motion) -> np.ndarray:
    """Return the recursion's result, world axes."""
    arm, at = motion.arm, motion.at
    return tip_mobility(arm, at, articulated_filter(arm, at)).rotated(at.R[-1]).dense()


@seeds
def test_recursion(seed):
    """The recursion (6.10) gives J M^-1 J^T, symmetric to the last bit and semidefinite."""
    motion = random_motion(seed)
    J, M = jacobian(motion.arm, motion.at), mass_matrix(motion.arm, motion.at)[0]
    mobility = in_world(motion)
    np.testing.assert_array_equal(mobility, mobility.T)
    assert relative_gap(mobility, J @ np.linalg.solve(M, J.T)) < 1e-12
    assert np.linalg.eigvalsh(mobility)[0] > -1e-13 * np.abs(mobility).max()


@seeds
def test_response_to_a_wrench(seed):
    """A wrench on the tip accelerates it by Lambda times it, the arm at rest."""
    motion = at_rest(random_motion(seed))
    f = np.random.default_rng(seed).normal(size=6)
    qdd = articulated(motion, np.zeros(motion.arm.joint_count), -f)
    assert relative_gap(jacobian(motion.arm, motion.at) @ qdd, in_world(motion) @ f) < 1e-12
