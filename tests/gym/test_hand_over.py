"""Handing over: a policy by hand succeeds, and grips and releases keep to mechanics."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from tests.gym.problems import careless_hand_over, hand_over, parts

GIVING, BOTH, TAKEN = 0.0, 1.0, 2.0


def by_hand(task: hf.gym.HandOverTask, seen: np.ndarray, q: np.ndarray, phase: float) -> np.ndarray:
    """Return actions of springs: from the receiver's tip to its place, then from the object to its goal."""
    x, tau = parts(task, seen), np.zeros(task.chain.joint_count)
    receiver, giver = (task.chain.joints[name] for name in (task.receiver, task.giver))
    pull = {GIVING: np.repeat([40.0, 600.0], 3) * x["gap"], TAKEN: np.repeat([40.0, 400.0], 3) * x["goal"]}
    if phase in pull:
        tau[receiver] = hf.dynamics.tip_jacobian(task.chain.arms[task.receiver], x["q"][receiver]).T @ pull[phase]
    if phase != TAKEN:
        tau[giver] = 100.0 * (q - x["q"])[giver]
    return np.r_[tau / task.joint_torque, 1.0, 1.0]


@pytest.mark.long
def test_a_hand_over():
    """The receiver reaches, grips, takes over and brings the object to its goal, in the order of the phases."""
    env = hf.gym.HandOver(hand_over())
    for seed in range(3):
        seen, info = env.reset(seed=seed)
        q, phases, over, rewards = env.state.q, [info["phase"]], False, []
        while not over:
            seen, reward, terminated, truncated, info = env.step(by_hand(env.task, seen, q, phases[-1]))
            phases.append(info["phase"])
            rewards.append(reward)
            over = terminated or truncated
        assert terminated and info["success"] == 1.0 and info["status"] == "RUNNING"
        assert sorted(set(phases)) == [GIVING, BOTH, TAKEN] and phases == sorted(phases)
        assert info["distance"] <= env.task.tolerance and rewards[-1] > 4.9


def scaled(body: hf.HeldObject, factor: float) -> hf.HeldObject:
    """Return a body of the same shape and another density."""
    return hf.HeldObject(factor * body.mass, factor * body.inertia, body.com)


@pytest.mark.slow
def test_grip_and_release():
    """A grip closes both grasps where the tip is, by an impulse that takes energy; a release changes no velocity."""
    task = careless_hand_over()
    envs, generator = hf.gym.HandOverVector(4, task), np.random.default_rng(3)
    envs.reset(seed=1)
    for _ in range(20):
        envs.step(np.hstack([generator.uniform(-1, 1, (4, 14)), np.full((4, 2), -1.0)]))
    assert (envs.episodes.phase == 0).all()
    rows, episodes = np.array([1, 3]), envs.episodes
    before = [envs.state(k) for k in range(4)]
    episodes.actions[rows, -2] = 1.0
    task.prepare(episodes, np.arange(4))
    assert episodes.phase.tolist() == [0, 1, 0, 1]
    for row in rows:
        state, column = envs.state(row), list(task.chain.grasps).index(task.receiver)
        frame = hf.Pose.from_wxyz_xyz(episodes.drawn["grasp_pose"][row, column])
        chain = task.chains[0].with_grasp(task.receiver, hf.Grasp("rigid", frame))
        tip = hf.dynamics.tip_pose(chain.arms[task.receiver], before[row].q[chain.joints[task.receiver]])
        held = before[row].object_frame @ frame
        assert held.p == pytest.approx(tip.p, abs=1e-12) and pytest.approx(tip.R, abs=1e-12) == held.R
        gaps = hf.dynamics.closure(chain, state)[task.receiver]
        assert np.abs(gaps.position).max() < 1e-12 and np.abs(gaps.velocity).max() < 1e-12
        assert state.q == pytest.approx(before[row].q, abs=1e-9)
        loaded = replace(chain, held_object=scaled(chain.held_object, episodes.drawn["mass_factor"][row]))
        energies = [hf.dynamics.kinetic_energy(loaded, one) for one in (before[row], state)]
        assert energies[1] < energies[0]
        place = hf.dynamics.closure(task.chain, before[row])[task.receiver]  # where it should have gripped
        speed = np.linalg.norm(place.velocity[3:])
        assert episodes.drawn["impact"][row] == pytest.approx(speed, rel=1e-9)
    held = [envs.state(k) for k in range(4)]
    episodes.actions[rows, -1] = 1.0
    task.prepare(episodes, np.arange(4))
    assert episodes.phase.tolist() == [0, 2, 0, 2]
    for row in rows:
        assert envs.state(row).qd == pytest.approx(held[row].qd, abs=1e-9)
        assert envs.state(row).object_twist == pytest.approx(held[row].object_twist, abs=1e-9)


@pytest.mark.long
def test_nothing_happens_out_of_reach():
    """A receiver that is too far away does not grip, and a giver that holds alone does not let go."""
    env = hf.gym.HandOver(hand_over())
    env.reset(options={"retreat": np.full(7, 0.15)})
    *_, info = env.step(np.r_[np.zeros(14), 1.0, 1.0])
    assert info["phase"] == GIVING and info["within_reach"] == 0.0 and info["gap"] > 0.02
    env.reset(options={"retreat": np.zeros(7)})
    *_, info = env.step(np.r_[np.zeros(14), -1.0, 1.0])
    assert info["phase"] == GIVING and info["within_reach"] == 1.0
    *_, info = env.step(np.r_[np.zeros(14), 1.0, -1.0])
    assert info["phase"] == BOTH
    *_, info = env.step(np.r_[np.zeros(14), -1.0, 1.0])
    assert info["phase"] == TAKEN
