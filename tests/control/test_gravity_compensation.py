"""Gravity compensation holds every closed chain still, with the internal force asked for."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import State, forward_dynamics
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.forces.force_split import split
from tests.control.two_pandas import two_pandas
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain


@pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "ball"), ("hinge", "softfinger")])
def test_nothing_moves(kinds):
    """Forward dynamics under its torques gives no acceleration, whatever the internal force."""
    chain, state = two_pandas(*kinds)
    tau, memory = GravityCompensation(chain, internal_force=30.0)(0.0, state, "kept")
    found = forward_dynamics(chain, state, tau)
    assert memory == "kept"
    assert np.abs(found.qdd).max() < 1e-10
    assert np.abs(found.object_acceleration).max() < 1e-10


def test_random_chains_stay_still():
    """So it is for arms of any shape, one of them without a grasp, gravity along any direction."""
    for seed in range(4):
        p = as_chain(well_conditioned_system(seed, grasps=["rigid", "hinge", None], joints=[6, 7, 5], extras=False,
                                             moving_base=False))  # fmt: skip
        state = State(p.state.q, 0 * p.state.qd, p.state.object_pose)
        tau, _ = GravityCompensation(p.chain)(0.0, state, None)
        assert np.abs(forward_dynamics(p.chain, state, tau).qdd).max() < 1e-9


def test_squeeze_is_internal_and_of_its_size():
    """What 20 N more internal force adds moves nothing, and is 20 N along each normal."""
    chain, state = two_pandas()
    loose, tight = (
        forward_dynamics(chain, state, GravityCompensation(chain, force)(0.0, state, None)[0]).grasp_wrench
        for force in (0.0, 20.0)
    )
    added = tight - loose
    assert split(chain, state, added).motion == pytest.approx(np.zeros((2, 6)), abs=1e-9)
    assert np.linalg.norm(added[:, 3:], axis=1) == pytest.approx([20.0, 20.0], abs=1e-9)
    normals = [state.object_frame.R @ grasp.frame.R[:, 2] for grasp in chain.grasps.values()]
    assert [f @ n for f, n in zip(added[:, 3:], normals, strict=True)] == pytest.approx([20.0, 20.0], abs=1e-9)
    assert split(chain, state, loose).internal == pytest.approx(np.zeros((2, 6)), abs=1e-9)


def test_one_grasp_cannot_squeeze():
    """A single arm has no internal forces: the command is taken off again."""
    chain, state = two_pandas()
    alone = replace(chain, grasps={"left": chain.grasps["left"]})
    squeezed = commanded_wrenches(alone, state, np.zeros(6), 20.0)
    assert squeezed == pytest.approx(commanded_wrenches(alone, state, np.zeros(6)), abs=1e-12)
    assert squeezed[0, 5] == pytest.approx(3 * 9.81)


def test_joint_damping_slows_down():
    """Damping takes power from every moving joint."""
    chain, state = two_pandas()
    moving = State(state.q, np.ones(14), state.object_pose)
    damped, _ = GravityCompensation(chain, joint_damping=2.0)(0.0, moving, None)
    free, _ = GravityCompensation(chain)(0.0, moving, None)
    assert damped - free == pytest.approx(-2.0 * np.ones(14))
