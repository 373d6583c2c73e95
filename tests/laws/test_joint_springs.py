"""Springs in joints: torques, energy and power beside the same chain with those torques given; MuJoCo's springs."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import potential_energy, power
from holdfast.simulation.balance import WORK_TERMS
from tests.simulation.rollout.problems import assert_rollout_is_run
from tests.simulation.runs import assert_held_still, limp
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain
from tests.systems.problems import random_problem, relative_gap


def sprung(chain: hf.ClosedChain, seed: int = 0) -> tuple[hf.ClosedChain, np.ndarray, np.ndarray]:
    """Return the chain with springs in its joints, every third without, their stiffness and where they are slack."""
    rng, n = np.random.default_rng(seed), chain.joint_count
    k, rest = rng.uniform(5.0, 50.0, n), rng.normal(size=n)
    k[::3] = 0.0
    given = iter(zip(k, rest, strict=True))
    arms = {
        name: replace(
            arm, joints=[replace(j, stiffness=s, rest=r) for j, (s, r) in zip(arm.joints, given, strict=False)]
        )
        for name, arm in chain.arms.items()
    }
    return replace(chain, arms=arms), k, rest


def mixed(seed: int):
    """Return a random chain of all grasps, everything on, with springs in its joints."""
    p = random_problem(seed, grasps=("rigid", "hinge", "softfinger", "ball"), joints=(6, 7, 5, 4), moving_base=True)
    return p, *sprung(p.chain, seed)


@pytest.mark.parametrize("seed", range(3))
def test_torques(seed):
    """A spring is a torque -k (q - rest) of the joint; forward, inverse and machine code agree on it."""
    p, chain, k, rest = mixed(seed)
    pull = k * (p.state.q - rest)
    found = hf.forward_dynamics(chain, p.state, p.tau, inputs=p.inputs)
    plain = hf.forward_dynamics(p.chain, p.state, p.tau - pull, inputs=p.inputs)
    assert relative_gap(found.qdd, plain.qdd) < 1e-12
    for method in ("kkt", "nonrigid"):
        other = hf.forward_dynamics(chain, p.state, p.tau, inputs=p.inputs, method=method)
        assert relative_gap(other.qdd, found.qdd) < 1e-9
    again = hf.inverse_dynamics(chain, p.state, found.qdd, found.grasp_wrench, p.inputs)
    assert relative_gap(again, p.tau) < 1e-10


@pytest.mark.parametrize("seed", range(2))
def test_power(seed):
    """What springs take goes into the potential energy: its rate less the weights' is the springs' power."""
    p, chain, k, rest = mixed(seed)
    found = hf.forward_dynamics(chain, p.state, p.tau, inputs=p.inputs)
    stored = potential_energy(chain, p.state) - potential_energy(p.chain, p.state)
    assert stored == pytest.approx(0.5 * k @ (p.state.q - rest) ** 2, rel=1e-12)
    # the drives' own power does not count the springs
    assert power(chain, p.state, p.tau, found, p.inputs).drives == pytest.approx(p.tau @ p.state.qd, rel=1e-13)


def test_machine_code():
    """Forward and inverse dynamics and energy are the same as the reference's."""
    p = as_chain(well_conditioned_system(3, joints=[6, 6], grasps=["rigid", "hinge"], moving_base=False))
    chain, _, _ = sprung(p.chain)
    fast, s = hf.compile(chain), p.state
    found = fast.forward_dynamics(s.q, s.qd, p.tau, s.object_pose, s.object_twist)
    expected = hf.forward_dynamics(chain, s, p.tau)
    assert relative_gap(found.qdd, expected.qdd) <= 1e-11
    assert fast.potential_energy(s.q, s.object_pose) == pytest.approx(potential_energy(chain, s), rel=1e-13)
    back = fast.inverse_dynamics(s.q, s.qd, expected.qdd, expected.grasp_wrench)
    assert relative_gap(back, p.tau) < 1e-10


def held():
    """Return a chain with springs, without damping, and a state in motion."""
    options = {"moving_base": False, "extras": False, "joint_speed": 0.7, "gravity": (0, 0, -9.81)}
    p = as_chain(well_conditioned_system(4, joints=[6, 5], grasps=["rigid", "ball"], **options))
    smooth = {
        n: replace(a, joints=[replace(j, damping=0.0, friction=0.0) for j in a.joints]) for n, a in p.chain.arms.items()
    }
    return sprung(replace(p.chain, arms=smooth))[0], p.state


@pytest.mark.slow
def test_energy():
    """Kinetic, weights' and springs' energies together do not change."""
    chain, state = held()
    run = hf.simulate(chain, state, limp, 0.1, 0.02, scheme="dop853", rtol=1e-13)
    total = run.kinetic + run.potential
    assert run.stopped is None and np.ptp(run.potential) > 0.1
    assert np.ptp(total) <= 1e-11 * np.abs(run.kinetic).max()
    assert not run.work[:, [WORK_TERMS.index(term) for term in ("drives", "damping", "external")]].any()


@pytest.mark.slow
def test_rollout():
    """Rollouts have the springs in their steps."""
    chain, state = held()
    assert_rollout_is_run(chain, state)


@pytest.mark.parametrize("controlled", [False, True])
def test_holding(controlled):
    """Torques that hold the chain still hold it against its springs too."""
    chain, state = held()
    assert_held_still(chain, state, controlled)


def test_mujoco():
    """MuJoCo's springs, out of our MJCF, pull as ours, and come back from there."""
    mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")
    chain, state = held()
    _, k, rest = sprung(chain)
    model = mujoco.MjModel.from_xml_string(hf.interop.to_mjcf(chain, state))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert data.qfrc_spring[: len(k)] == pytest.approx(-k * (state.q - rest), abs=1e-12)
    name, arm = next(iter(chain.arms.items()))
    back = hf.interop.load_mjcf(hf.interop.to_mjcf(replace(chain, grasps={})), base=name, tip=f"{name}/tip")
    assert back.stiffness == pytest.approx(arm.stiffness, rel=1e-15)
    assert back.rest[arm.stiffness > 0] == pytest.approx(arm.rest[arm.stiffness > 0], rel=1e-15)
