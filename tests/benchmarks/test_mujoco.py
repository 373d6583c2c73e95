"""MuJoCo gets the same systems: without its soft welds it moves as ours, with them nearly so."""

import numpy as np
import pytest
from benchmarks.bench.entries import ACCURATE, relative_error
from benchmarks.bench.measure import reference
from benchmarks.bench.systems import make_system

from holdfast import ClosedChain, State, forward_dynamics

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")

from benchmarks.bench import mujoco_peer as entries  # noqa: E402
from benchmarks.bench.mujoco_peer import inputs, mjcf  # noqa: E402


def test_same_arms_and_object():
    """Masses, inertias, axes and armature: released arms accelerate as ours do, the object falls."""
    system = make_system(3, 7, 4)
    chain = ClosedChain(system.chain.arms, system.chain.held_object, {}, system.chain.gravity)
    model = mujoco.MjModel.from_xml_string(mjcf(chain, "Newton", "dense"))
    data, got, true = mujoco.MjData(model), [], []
    for row, (q, v, tau) in enumerate(inputs(system)):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, tau
        mujoco.mj_forward(model, data)
        got.append(data.qacc[: len(tau) - 6].copy())
        state = State(*(array[row] for array in (system.q, system.qd, system.object_pose, system.object_twist)))
        true.append(forward_dynamics(chain, state, system.tau[row]).qdd)
        assert np.allclose(data.qacc[-6:-3], chain.gravity, atol=1e-12)
    assert relative_error(np.array(got), np.array(true)) <= ACCURATE


def test_welds_are_closed():
    """The welds sit where the hands are: no position error to correct in any state."""
    system = make_system(3, 7, 4)
    model = mujoco.MjModel.from_xml_string(mjcf(system.chain, "Newton", "dense"))
    data = mujoco.MjData(model)
    for q, v, tau in inputs(system):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, tau
        mujoco.mj_forward(model, data)
        assert len(data.efc_pos) == 18
        assert np.abs(data.efc_pos).max() <= 1e-12
        assert np.abs(data.efc_vel).max() <= 1e-12


@pytest.mark.parametrize(("solver", "jacobian"), entries.SOLVERS)
def test_soft_but_near(solver, jacobian):
    """Every solver finds the accelerations of the hardest weld: a few per cent off at most, and never exact."""
    system = make_system(2, 7, 4)
    error = relative_error(entries.mj_forward(system, solver, jacobian, None).answers().qdd, reference(system).qdd)
    assert ACCURATE < error < 0.03
