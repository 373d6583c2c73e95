"""Inverse dynamics of one arm, and the wrench at its base."""

import numpy as np
import pytest

from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.free_dynamics import articulated, composite, newton_euler_columns, three_sweep
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.newton_euler import newton_euler
from tests.dynamics.problems import random_motion, relative_gap
from tests.oracles.arithmetic import arithmetic
from tests.oracles.body_equations import arm_equations
from tests.oracles.maximal_kkt import base_wrench
from tests.systems import random_system

seeds = pytest.mark.parametrize("seed", range(8))


def drawn(seed: int, N: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random joint accelerations and a tip wrench."""
    rng = np.random.default_rng(seed)
    return 5 * rng.normal(size=N), 10 * rng.normal(size=6)


@seeds
def test_equation_of_motion(seed):
    """T = M qdd + C + J^T f (2.1a)."""
    motion = random_motion(seed)
    arm, at = motion.arm, motion.at
    qdd, f = drawn(seed, arm.joint_count)
    C, _ = bias_torque(arm, at, motion.bias.wrenches)
    expected = mass_matrix(arm, at)[0] @ qdd + C + jacobian(arm, at).T @ f
    assert relative_gap(newton_euler(motion, qdd, f)[0], expected) < 1e-13


@seeds
@pytest.mark.parametrize("solver", [composite, newton_euler_columns, articulated, three_sweep])
def test_forward_undoes_inverse(seed, solver):
    """The torques of given accelerations bring these accelerations back, tip loaded, base moving."""
    motion = random_motion(seed)
    qdd, f = drawn(seed, motion.arm.joint_count)
    torques, _ = newton_euler(motion, qdd, f)
    assert relative_gap(solver(motion, torques, f), qdd) < 1e-12


@seeds
def test_base_wrench(seed):
    """The base supports what changes the links' momentum and what goes on to the object: the oracle's."""
    case = random_system(seed, arms=1, moving_base=True, gravity=(1.0, -2.0, -9.0))
    numbers = arithmetic(None)
    oracle = arm_equations(case["arms"][0], np.array(case["gravity"]), numbers)
    motion = random_motion(seed)
    qdd, f = drawn(seed, motion.arm.joint_count)
    torques, base = newton_euler(motion, qdd, f)
    assert relative_gap(base, base_wrench(oracle, qdd, f)) < 1e-12
    assert relative_gap(torques, oracle.M @ qdd + oracle.bias + oracle.J.T @ f) < 1e-12


def test_link_wrenches_are_helpers():
    """A wrench that pushes a link takes its virtual work off the torques: J_k^T w."""
    loaded, bare = random_motion(4), random_motion(4, extras=False)
    assert (loaded.at.tip.p == bare.at.tip.p).all()
    case = random_system(4, arms=1, moving_base=True, gravity=(1.0, -2.0, -9.0))
    # armature enters with qdd only
    none = np.zeros(loaded.arm.joint_count)
    saved = newton_euler(bare, none, np.zeros(6))[0] - newton_euler(loaded, none, np.zeros(6))[0]
    numbers = arithmetic(None)
    arm = case["arms"][0]
    unloaded = {key: value for key, value in arm.items() if key != "link_wrench"}
    gravity = np.array(case["gravity"])
    expected = arm_equations(unloaded, gravity, numbers).bias - arm_equations(arm, gravity, numbers).bias
    assert np.abs(expected).max() > 1
    assert relative_gap(saved, expected) < 1e-12
