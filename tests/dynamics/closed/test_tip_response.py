"""Both routes of one arm around the object give the same numbers, out and back."""

import numpy as np
import pytest

from holdfast.dynamics.arm.free_dynamics import articulated
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.closed.tip_response import RECURSION_PAYS_FROM, by_mass_matrix, recursive, tip_response
from tests.dynamics.problems import random_motion, relative_gap

seeds = pytest.mark.parametrize("seed", range(10))


@seeds
def test_routes_agree(seed):
    """Mobility, free acceleration, and the way back from a grasp force."""
    motion = random_motion(seed)
    a, b = recursive(motion), by_mass_matrix(motion)
    f = 10 * np.random.default_rng(seed).normal(size=6)
    assert relative_gap(a.mobility.dense(), b.mobility.dense()) < 1e-11
    assert relative_gap(a.free_acceleration, b.free_acceleration) < 1e-11
    for x, y in zip(a.back_substitute(f), b.back_substitute(f), strict=True):
        assert relative_gap(x, y) < 1e-10


@seeds
@pytest.mark.parametrize("route", ["recursive", "mass_matrix"])
def test_back(seed, route):
    """qdd = M^-1 (T' - J^T f), and the base wrench is Newton and Euler's for it."""
    motion = random_motion(seed)
    f = 10 * np.random.default_rng(seed).normal(size=6)
    qdd, base = tip_response(motion, route).back_substitute(f)
    assert relative_gap(qdd, articulated(motion, motion.torque, f)) < 1e-10
    assert relative_gap(base, newton_euler(motion, qdd, f)[1]) < 1e-10


@pytest.mark.parametrize("joints", [RECURSION_PAYS_FROM - 1, RECURSION_PAYS_FROM])
def test_auto(joints):
    """`auto` takes the mass matrix for short arms and the recursion for long ones, bit by bit."""
    motion = random_motion(0, joints=joints, grasps="ball")
    chosen = recursive if joints >= RECURSION_PAYS_FROM else by_mass_matrix
    np.testing.assert_array_equal(tip_response(motion, "auto").pivots, chosen(motion).pivots)
