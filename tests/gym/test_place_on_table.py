"""Placing on a table: a sensible policy succeeds, a random one does not, and what is seen is computed otherwise."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import holdfast as hf
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.errors import ModelError
from tests.gym.problems import parts, place
from tests.gym.test_bits import walk_together

BELOW = 0.01  # m below the goal, where the policy's spring rests: it presses when it is there
K, D, WAY = 60.0, 16.0, 0.05  # 1/s^2, 1/s, m: of the policy's spring, no further than this


def sensible(observations: np.ndarray) -> np.ndarray:
    """Return actions that first bring objects above their goals, then down."""
    actions = []
    for one in observations:
        seen = parts(place(), one)
        e, v = seen["goal"].copy(), seen["twist"]
        e[5] -= BELOW
        e[5] *= 1.0 if np.hypot(e[3], e[4]) < 0.5 * BELOW else 0.2
        wanted = K * np.r_[e[:3], np.clip(e[3:], -WAY, WAY)] - D * v
        actions.append(np.r_[wanted / place().acceleration, 0.0])
    return np.array(actions)


def outcomes(policy, count):
    """Return success and return of one episode in each of several environments."""
    envs = hf.gym.PlaceOnTableVector(count, place())
    observations, _ = envs.reset(seed=3)
    over, success, gained = np.zeros(count, bool), np.zeros(count), np.zeros(count)
    for _ in range(place().episode_steps):
        observations, rewards, terminated, truncated, infos = envs.step(policy(observations))
        gained += np.where(over, 0.0, rewards)
        ends = (terminated | truncated) & ~over
        success[ends], over = infos["success"][ends], over | ends
        if over.all():
            break
    return success, gained


@pytest.mark.slow
def test_policies():
    """Each box is placed by a spring that leads it down; random actions place none, and are worth less."""
    good, much = outcomes(sensible, 6)
    assert good.all()
    generator = np.random.default_rng(1)
    bad, little = outcomes(lambda seen: generator.uniform(-1.0, 1.0, (len(seen), 7)), 6)
    assert not bad.any()
    assert much.min() > little.max() + 0.5 * place().success_reward


@pytest.mark.slow
def test_observation_and_success():
    """Gaps are those of the state, the table's force carries the weight that hands do not, and success is as said."""
    env, task = hf.gym.PlaceOnTable(place()), place()
    one, _ = env.reset(seed=0, options={"mass_factor": 1.05, "push": np.zeros(6), "displacement": [0.01, 0.0, 0.0]})
    home, chain = task.state.object_frame, task.chain
    np.testing.assert_allclose(task.place, [0, 0, -0.05], atol=1e-12)
    terminated = False
    while not terminated:
        one, reward, terminated, truncated, info = env.step(sensible(one[None])[0])
        assert not truncated
        seen, state = parts(task, one), env.state
        gap = contact_rows(chain.touching, state.object_frame, state.object_twist).gap
        np.testing.assert_allclose(seen["gap"], gap, atol=1e-12)
        assert gap.min() > -1e-12
        goal = home.p + task.place + [0.01, 0, 0]
        np.testing.assert_allclose(seen["goal"][3:], goal - state.object_frame.p, atol=1e-12)
        if np.abs(seen["table"]).max() < task.observed["table"][0]:  # not cut off
            assert info["press"] == pytest.approx(np.linalg.norm(seen["table"]), abs=1e-12)
        assert info["success"] == float(terminated)
    assert reward > task.success_reward and info["status"] == "RUNNING"
    assert info["press"] <= task.largest_press
    assert seen["table"][2] >= task.least_share * 1.05 * 9.81 * chain.held_object.mass
    assert max(info["distance"] / task.tolerance, info["angle"] / task.tolerance_angle, info["speed"] / task.still) <= 1


@pytest.mark.long
def test_bits():
    """A vector environment is that many single ones, to the bit, with contacts, too."""
    kinds = hf.gym.PlaceOnTable, hf.gym.PlaceOnTableVector
    walk_together(kinds, place(), AutoresetMode.NEXT_STEP, 3, 60)


def test_refused():
    """A chain that touches nothing, and numbers that mean nothing, are refused by name."""
    free = hf.gym.HandOverTask()
    with pytest.raises(ModelError, match="place on table: chain: expected one whose object may touch a table"):
        hf.gym.PlaceOnTableTask(free.chain, free.state)
    for name, value in {"least_share": -1.0, "still": 0.0, "place": [1.0], "displacement": [-1.0, 0, 0]}.items():
        with pytest.raises(ModelError, match=f"place on table: {name}"):
            hf.gym.PlaceOnTableTask(**{name: value})
