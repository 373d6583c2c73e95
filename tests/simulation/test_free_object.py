"""An object that nobody holds, by the reference and by machine code: it falls, and spins as Euler says."""

import numpy as np
import pytest

import holdfast as hf

START = hf.State([], [], [1, 0, 0, 0, 0, 0, 0], [0.1, 2.0, 0.3, 0, 0, 1])
BOX = hf.HeldObject.box(3.0, 0.3, 0.2, 0.1)
CHAIN = hf.ClosedChain({}, BOX, {})
LASTS = 0.2


def require_motion(pose, twist):
    """Check the fall of the centre, and that the momentum about it and the energy of the spin stay."""
    assert pose[6] == pytest.approx(LASTS - 0.5 * 9.81 * LASTS**2, abs=1e-12)
    R = hf.Pose.from_wxyz_xyz(pose).R
    I = np.diag(np.diag(BOX.inertia))
    spin, before = R @ I @ R.T @ twist[:3], I @ START.object_twist[:3]
    np.testing.assert_allclose(spin, before, atol=1e-8)
    assert spin @ twist[:3] == pytest.approx(before @ START.object_twist[:3], abs=1e-8)


@pytest.mark.parametrize("steps", [10, 100])
@pytest.mark.parametrize("law", [None, lambda t, state, memory: (np.zeros(0), memory)], ids=["none", "function"])
def test_runs(law, steps):
    """With few steps by the reference, with many by machine code."""
    run = hf.simulate(CHAIN, START, law, LASTS, LASTS / steps)
    assert run.stopped is None
    require_motion(run.object_pose[-1], run.object_twist[-1])


def test_rollouts():
    """They take no torques, and their records become runs."""
    rollout = hf.compile_rollout(CHAIN)
    systems = rollout.start(START.q, START.qd, START.object_pose, START.object_twist)
    record = rollout.run(systems, LASTS, LASTS / 100)
    pose = record["object_pose"][-1, 0]
    require_motion(pose, record["object_twist"][-1, 0])
    run = record.trajectory(0)
    np.testing.assert_allclose(run.object_pose[-1], pose, atol=1e-12)
    assert run.grasp_wrench.shape == run.wrist_wrench.shape == (101, 0, 6)


def test_a_controller_is_needed_with_joints():
    """None stands for no torques only where there are none."""
    arm = hf.robots.panda()
    chain = hf.ClosedChain({"arm": arm}, None, {})
    with pytest.raises(hf.errors.ModelError, match="controller: expected a function"):
        hf.simulate(chain, hf.State(np.zeros(7), np.zeros(7)), None, 0.1, 0.01)
