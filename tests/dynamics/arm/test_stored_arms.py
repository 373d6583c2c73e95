"""Every sweep against the numbers stored with the 42 cases, which another program computed."""

import numpy as np
import pytest

from holdfast.dynamics.arm.articulated import articulated_filter
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.free_dynamics import three_sweep
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.arm.tip_mobility import tip_mobility
from tests.dynamics.problems import CASES, motion_of, relative_gap, stored

TOLERANCE = 1e-10


def computed(motion: ArmMotion, gravity) -> dict[str, np.ndarray]:
    """Return what the sweeps find, named as in the file."""
    arm, at = motion.arm, motion.at
    return {
        "mass_matrix": mass_matrix(arm, at)[0],
        "jacobian": jacobian(arm, at),
        "bias_torque": bias_torque(arm, at, motion.bias.wrenches)[0],
        "tip_bias_acceleration": motion.bias.tip_acceleration + np.r_[np.zeros(3), gravity],
        "free_qdd": three_sweep(motion, motion.torque, np.zeros(6)),
        "Lambda": tip_mobility(arm, at, articulated_filter(arm, at)).rotated(at.R[-1]).dense(),
        "tip_position": at.tip.p,
    }


@pytest.mark.parametrize("name", CASES)
def test_stored_arm(name):
    """Mass matrix, Jacobian, biases, free accelerations, tip mobility and tip of every arm."""
    problem = stored(name)
    for arm, debug in zip(motion_of(problem).arms.values(), CASES[name]["debug"], strict=True):
        got = computed(arm, problem.chain.gravity)
        assert got.keys() == debug.keys()
        for quantity, expected in debug.items():
            assert relative_gap(got[quantity], expected) < TOLERANCE, quantity
