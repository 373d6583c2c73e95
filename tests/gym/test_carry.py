"""Carrying: what actions do, and what is seen and rewarded, computed otherwise."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import RestToRest
from holdfast.spatial import rotation
from tests.gym.problems import carry, parts, short_carry

EXACT = {"mass_factor": 1.0, "push": np.zeros(6)}


@pytest.mark.slow
def test_actions_accelerate_the_object():
    """A payload as modelled, without a push: the twist changes by the acceleration that was asked for."""
    env, dt = hf.gym.Carry(carry()), 0.02
    env.reset(seed=0, options=EXACT)
    action = np.array([0.3, -0.2, 0.1, 0.2, 0.4, -0.3, 0.2])
    env.step(action)
    moved = env.state.object_twist / dt
    assert moved == pytest.approx(env.task.acceleration * action[:6], abs=1e-6)


@pytest.mark.slow
def test_actions_squeeze():
    """At rest the internal force is that of the action: contacts that face each other keep all of a push."""
    env = hf.gym.Carry(carry())
    for a in (-1.0, 0.5):
        env.reset(seed=0, options=EXACT)
        *_, info = env.step(np.r_[np.zeros(6), a])
        assert info["internal_force"] == pytest.approx(
            env.task.internal_force + a * env.task.internal_force_span, rel=1e-6
        )


@pytest.mark.slow
def test_clipped():
    """An action beyond 1 is one of 1."""
    found = []
    for scale in (1.0, 3.0):
        env = hf.gym.Carry(carry())
        env.reset(seed=0)
        found.append(env.step(scale * np.array([1, -1, 1, -1, 1, 1, 1.0]))[0])
    assert (found[0] == found[1]).all()


def test_observation_and_reward():
    """Every part from the state, by the library's other functions, after steps at random."""
    envs, task, generator = hf.gym.CarryVector(3, carry()), carry(), np.random.default_rng(1)
    envs.reset(seed=8)
    for k in range(1, 9):
        actions = generator.uniform(-0.4, 0.4, (3, 7))
        observations, rewards, _, _, infos = envs.step(actions)
        t = k * task.step * task.steps_per_action
        for i in range(3):
            seen, state = parts(task, observations[i]), envs.state(i)
            drawn = {name: x[i] for name, x in envs.episodes.drawn.items()}
            path = RestToRest(task.state.object_frame, drawn["displacement"], drawn["turn"], 0.0, task.duration)
            at, target, end = state.object_frame, path.at(t), path.at(task.duration)
            e = np.r_[rotation.log(target.pose.R @ at.R.T), target.pose.p - at.p]
            to_goal = np.r_[rotation.log(end.pose.R @ at.R.T), end.pose.p - at.p]
            wrenches = envs.episodes.systems[0].grasp_wrench[i]
            split = hf.forces.split(task.chain, state, wrenches)
            internal = np.hypot(*(np.linalg.norm(split.internal[:, s], axis=1) for s in (slice(3), slice(3, 6))))
            if split.length != 1.0:
                moments, forces = split.internal[:, :3] / split.length, split.internal[:, 3:]
                internal = np.sqrt((moments**2 + forces**2).sum(1))
            expected = {
                "path": e,
                "path_twist": target.twist - state.object_twist,
                "path_acceleration": target.acceleration,
                "goal": to_goal,
                "twist": state.object_twist,
                "time": [t / (task.duration + task.settle)],
                "wrench": np.hstack([wrenches[:, :3] @ at.R, wrenches[:, 3:] @ at.R]).ravel(),
                "margin": hf.forces.grasp_margins(task.chain, state, wrenches),
                "q": state.q,
                "qd": state.qd,
            }
            assert list(expected) == list(seen)
            for name, x in expected.items():
                assert seen[name] == pytest.approx(np.asarray(x), abs=1e-9), name
            angle, distance, force = np.linalg.norm(e[:3]), np.linalg.norm(e[3:]), internal.max()
            near = 1 / (1 + (angle / task.tolerance_angle) ** 2 + (distance / task.tolerance) ** 2)
            rate = near - max(0.0, force / task.largest_internal - 1) - 0.01 * np.mean(actions[i] ** 2)
            assert rewards[i] == pytest.approx(0.02 * rate, abs=1e-11)
            info_names = [infos[name][i] for name in ("internal_force", "distance", "angle")]
            assert info_names == pytest.approx([force, distance, angle], abs=1e-9)


def test_ends():
    """An object that stays behind, one that slips, and one that lasts its time."""
    still = {**EXACT, "displacement": np.zeros(3), "turn": np.zeros(3)}
    env = hf.gym.Carry(carry())
    for options, action, status, lasts in (
        ({**EXACT, "displacement": [0.6, 0.0, 0.0]}, 0.0, "RUNNING", False),
        ({**still, "push": [0, 0, 0, 0, 0, -90.0]}, 0.0, "SLIPPED", False),
        (still, 0.0, "RUNNING", True),
    ):
        env.reset(options=options)
        rewards, over = [], False
        while not over:
            _, reward, terminated, truncated, info = env.step(np.full(7, action))
            rewards.append(reward)
            over = terminated or truncated
        assert (truncated, info["status"]) == (lasts, status)
        assert (rewards[-1] < -4.9) == (not lasts)
        assert (len(rewards) == env.task.episode_steps) == lasts


@pytest.mark.long
def test_crushed():
    """An object that is squeezed too hard ends the episode, though nothing slips."""
    env = hf.gym.Carry(chain=carry().chain, state=carry().state, largest_internal=20.0, crushing_internal=60.0)
    env.reset(options={**EXACT, "displacement": np.zeros(3), "turn": np.zeros(3)})
    *_, terminated, truncated, info = env.step(np.r_[np.zeros(6), 1.0])
    assert terminated and not truncated and info["internal_force"] > 60.0 and info["status"] == "RUNNING"


@pytest.mark.long
def test_path_of_ones_own():
    """Episodes follow it, and nothing of it is drawn; one that begins elsewhere is refused."""
    chain, state = carry().chain, carry().state
    path = RestToRest(state.object_frame, [0.0, 0.0, 0.1], duration=0.5)
    env = hf.gym.Carry(chain=chain, state=state, path=path, duration=0.5, settle=0.0)
    assert set(env.task.drawn) == {"mass_factor", "push"}
    env.reset(options=EXACT)
    seen = parts(env.task, env.step(np.zeros(7))[0])
    assert seen["goal"][3:] == pytest.approx([0.0, 0.0, 0.1], abs=1e-6)
    assert seen["path_acceleration"] == pytest.approx(path.at(0.02).acceleration, abs=1e-12)
    away = RestToRest(hf.Pose.translation(0.0, 0.0, 2.0))
    with pytest.raises(hf.errors.ModelError, match="path: expected one that begins where the object is"):
        hf.gym.CarryTask(chain, state, path=away)


@pytest.mark.long
def test_torques():
    """With actions of the joints the weight is carried, and an action adds its torque."""
    task = hf.gym.CarryTask(chain=carry().chain, state=carry().state, commands="joint")
    env, action = hf.gym.Carry(task), np.linspace(-0.5, 0.5, 14)
    env.reset(options={**EXACT, "displacement": np.zeros(3), "turn": np.zeros(3)})
    *_, info = env.step(np.zeros(14))
    assert info["distance"] < 1e-9
    before = env.state
    env.step(action)
    tau = env.episodes.systems[0].tau[0]
    own, _ = hf.control.GravityCompensation(task.chain, task.internal_force, task.joint_damping)(0.0, env.state, None)
    assert tau - own == pytest.approx(task.joint_torque * action, abs=1e-9)
    assert not np.allclose(before.qd, env.state.qd)
    assert task.joint_torque[:7] == pytest.approx([8.7] * 4 + [1.2] * 3)


def test_a_short_episode_is_of_whole_steps():
    """An episode's length is that of its path and the time after it."""
    assert short_carry().episode_steps == 40
