"""The joint mass matrix is the kinetic energy's, and its columns are reactions to unit accelerations."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import at_rest
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.arm.velocity import link_twists
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from tests.dynamics.problems import random_arm, random_motion, relative_gap

seeds = pytest.mark.parametrize("seed", range(8))


@seeds
def test_kinetic_energy(seed):
    """1/2 qd M qd = sum 1/2 V M V + 1/2 armature qd^2 for every qd: polarised, entry by entry."""
    given = random_arm(seed)
    arm, at, N = given.arm, posture(given.arm, given.q), len(given.q)

    def energy(qd) -> float:
        twists = link_twists(arm, at, qd, np.zeros(6))
        moving = sum(V @ link.spatial_inertia.apply(V) for link, V in zip(arm.links, twists, strict=True))
        return 0.5 * (moving + arm.armature @ qd**2)

    M, e = mass_matrix(arm, at)[0], np.eye(N)
    expected = [[energy(e[i] + e[j]) - energy(e[i]) - energy(e[j]) for j in range(N)] for i in range(N)]
    assert relative_gap(M, np.array(expected)) < 1e-12


@seeds
def test_symmetric_and_definite(seed):
    """M is symmetric to the last bit and positive definite."""
    M = mass_matrix(random_arm(seed).arm, random_motion(seed).at)[0]
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M)[0] > 0


@seeds
def test_columns_by_newton_euler(seed):
    """Column k of M and of the first link's wrenches is what unit qdd_k asks for (Walker and Orin)."""
    motion = at_rest(random_motion(seed))
    M, first = mass_matrix(motion.arm, motion.at)
    lever = motion.arm.base.R @ motion.at.l[0]
    for k, unit in enumerate(np.eye(len(M))):
        torques, base = newton_euler(motion, unit, np.zeros(6))
        assert relative_gap(M[k], torques) < 1e-13
        assert relative_gap(shift_wrench(lever, rotate(motion.at.R[0], first[:, k])), base) < 1e-13


@seeds
def test_armature_loads_only_its_drive(seed):
    """Armature adds to the diagonal and to nothing else."""
    given = random_arm(seed)
    bare = replace(given.arm, joints=[replace(joint, armature=0.0) for joint in given.arm.joints])
    at = posture(bare, given.q)
    (M, base), (M0, base0) = mass_matrix(given.arm, at), mass_matrix(bare, at)
    np.testing.assert_allclose(M - M0, np.diag(given.arm.armature), atol=1e-14 * np.abs(M).max())
    np.testing.assert_array_equal(base, base0)
