"""Filtering and smoothing are the triangular factors of the mass matrix (5.2)-(5.4)."""

import numpy as np
import pytest

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.spatial.linalg import ldl
from holdfast.spatial.spatial_vector import rotate, unrotate
from tests.dynamics.problems import random_motion, relative_gap

seeds = pytest.mark.parametrize("seed", range(8))


def tip_to_base(motion) -> tuple[np.ndarray, np.ndarray]:
    """Return L and D of M = L D L^T with joints in the paper's order, but L back in the code's."""
    M = mass_matrix(motion.arm, motion.at)[0]
    reverse = slice(None, None, -1)
    factors = ldl(M[reverse, reverse], np.ones(len(M)))
    return factors.L[reverse, reverse], factors.pivots[reverse]


@seeds
def test_pivots(seed):
    """D are the pivots of M eliminated from the tip to the base; their product is det M."""
    motion = random_motion(seed)
    filter = articulated_filter(motion.arm, motion.at)
    assert relative_gap(filter.D, tip_to_base(motion)[1]) < 1e-12
    M = mass_matrix(motion.arm, motion.at)[0]
    assert np.log(filter.D).sum() == pytest.approx(np.linalg.slogdet(M)[1], rel=1e-11)


@seeds
def test_whitening_and_smoothing(seed):
    """whiten is (I + H Phi L)^-1 and smooth its transpose: forward and back substitution."""
    motion = random_motion(seed)
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    L, _ = tip_to_base(motion)
    T = np.random.default_rng(seed).normal(size=len(L))
    assert relative_gap(whiten(arm, at, filter, T, None, None)[0], np.linalg.solve(L, T)) < 1e-12
    assert relative_gap(smooth(arm, at, filter, T)[0], np.linalg.solve(L.T, T)) < 1e-12


@seeds
def test_tip_of_smoothing(seed):
    """The acceleration that smoothing passes out at the tip is J times its result."""
    motion = random_motion(seed)
    arm, at = motion.arm, motion.at
    out, tip = smooth(arm, at, articulated_filter(arm, at), np.arange(1.0, 1 + arm.joint_count))
    assert relative_gap(rotate(at.R[-1], tip), jacobian(arm, at) @ out) < 1e-12


@seeds
def test_whitening_is_linear(seed):
    """Torques, bias wrenches and tip wrench add up; C and J^T f can as well be taken off before."""
    motion = random_motion(seed)
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    rng = np.random.default_rng(seed)
    T, f = rng.normal(size=arm.joint_count), rng.normal(size=6)
    tip = unrotate(at.R[-1], f)
    C, _ = bias_torque(arm, at, motion.bias.wrenches)
    together, _ = whiten(arm, at, filter, T, motion.bias.wrenches, tip)
    before, _ = whiten(arm, at, filter, T - C - jacobian(arm, at).T @ f, None, None)
    apart = [whiten(arm, at, filter, *part)[0] for part in ((T, motion.bias.wrenches, None), (None, None, tip))]
    assert relative_gap(together, before) < 1e-12
    assert relative_gap(sum(apart), together) < 1e-12


@seeds
def test_wrench_left_at_the_base(seed):
    """What whitening leaves at the base is the base wrench of the accelerations it leads to."""
    motion = random_motion(seed)
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    f = np.random.default_rng(seed).normal(size=6)
    eps, z = whiten(arm, at, filter, motion.torque, motion.bias.wrenches, unrotate(at.R[-1], f))
    qdd, _ = smooth(arm, at, filter, eps / filter.D)
    assert relative_gap(rotate(arm.base.R, z), newton_euler(motion, qdd, f)[1]) < 1e-12
