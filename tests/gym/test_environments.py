"""Environments keep to Gymnasium's rules, and refuse by name what they cannot do."""

import pickle
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import holdfast as hf
from holdfast.errors import HoldfastError, MethodNotApplicable, ModelError, StateError
from tests.gym.problems import careless_hand_over, carry, place, short_carry

IDS = {"holdfast/Carry-v0": carry, "holdfast/HandOver-v0": careless_hand_over, "holdfast/PlaceOnTable-v0": place}


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_check_env(name):
    """Gymnasium's own check finds nothing, and nothing to warn of."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(name, task=IDS[name]()).unwrapped)


@pytest.mark.parametrize("name", [pytest.param(x, marks=() if "Carry" in x else pytest.mark.slow) for x in IDS])
def test_made_by_id(name):
    """Single ones and true vector ones; an autoreset mode goes through."""
    task = IDS[name]()
    single = gymnasium.make(name, task=task)
    many = gymnasium.make_vec(name, num_envs=3, task=task, autoreset_mode="SameStep")
    assert isinstance(single.unwrapped, hf.gym.Carry | hf.gym.HandOver | hf.gym.PlaceOnTable)
    assert isinstance(many, hf.gym.CarryVector | hf.gym.HandOverVector | hf.gym.PlaceOnTableVector)
    assert many.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    first, _ = single.reset(seed=4)
    observations, _ = many.reset(seed=4)
    assert observations in many.observation_space and first in single.observation_space
    assert (observations[0] == first).all() and not (observations[1] == first).all()
    assert many.np_random_seed == (4, 5, 6)


def test_seeds():
    """One seed, one sequence of episodes; environments have their own, and a mask leaves the others alone."""
    envs = hf.gym.CarryVector(3, short_carry(), autoreset_mode="Disabled")
    first, _ = envs.reset(seed=[1, None, 3])
    second, _ = envs.reset()
    assert not (first == second).all(1).any()
    again, _ = envs.reset(seed=[1, 7, 3])
    assert (again == first).all(1).tolist() == [True, False, True]
    masked, infos = envs.reset(seed=1, options={"reset_mask": np.array([True, False, False])})
    assert (masked == again).all(1).tolist() == [True, True, True]
    assert infos["_status"].tolist() == [True, False, False]
    assert infos["status"].tolist() == ["RUNNING", None, None]


def test_options():
    """What is given is not drawn; the rest is as it would have been."""
    envs = hf.gym.CarryVector(2, short_carry())
    envs.reset(seed=3)
    drawn = {name: x.copy() for name, x in envs.episodes.drawn.items()}
    factors = np.array([0.9, 1.1])
    envs.reset(seed=3, options={"mass_factor": factors, "turn": [0.0, 0.0, 0.1]})
    assert (envs.episodes.drawn["mass_factor"] == factors).all()
    assert (envs.episodes.drawn["turn"] == [0.0, 0.0, 0.1]).all()
    assert (envs.episodes.drawn["push"] == drawn["push"]).all()
    mass = envs.episodes.systems[0].call_inputs["object_mass"]
    assert mass == pytest.approx(factors * envs.task.chain.held_object.mass, rel=1e-15)


def test_spread():
    """Draws fill what they may and no more."""
    task, generator = carry(), np.random.default_rng(0)
    every = [task.draw(generator) for _ in range(400)]
    for name, largest in (("push", task.push), ("displacement", task.displacement), ("turn", task.turn)):
        found = np.abs([one[name] for one in every]).max(0)
        assert (found <= largest).all() and (found >= 0.95 * largest).all()
    factors = [one["mass_factor"] for one in every]
    assert 0.8 <= min(factors) < 0.82 and 1.18 < max(factors) <= 1.2


def test_results_are_the_callers():
    """What a step returned does not change with the next one."""
    envs = hf.gym.CarryVector(2, short_carry())
    held = [*envs.reset(seed=1)[:1], *envs.step(np.zeros((2, 7)))[:4]]
    copies = [x.copy() for x in held]
    envs.step(np.ones((2, 7)))
    assert all((x == y).all() for x, y in zip(held, copies, strict=True))


@pytest.mark.long
def test_tasks_travel():
    """A task can be pickled: another process makes the same environment."""
    task = pickle.loads(pickle.dumps(short_carry()))
    assert (hf.gym.Carry(task).reset(seed=2)[0] == hf.gym.Carry(short_carry()).reset(seed=2)[0]).all()


@pytest.mark.parametrize(
    ("setting", "error", "message"),
    [
        ({"step_": 0.1}, ModelError, "CarryTask: no setting 'step_'. Did you mean 'step'"),
        ({"commands": "wheel"}, ModelError, "commands: expected 'object' or 'joint', got 'wheel'"),
        ({"mass_spread": 1.0}, ModelError, "mass_spread: expected less than 1"),
        ({"push": [1, 2, 3]}, ModelError, "push: expected shape"),
        ({"turn": [-1, 0, 0]}, ModelError, "turn: expected numbers >= 0"),
        ({"steps_per_action": 2.5}, ModelError, "steps_per_action: expected an integer >= 1, got 2.5"),
        ({"lost_angle": 4.0}, ModelError, "lost_angle: expected less than pi"),
        ({"duration": 0.0}, ModelError, "duration: expected > 0"),
        ({"path": 3}, ModelError, "path: expected a path"),
        ({"state": 3}, ModelError, "chain: expected a ClosedChain"),
        ({"chain": carry}, ModelError, "chain: expected a ClosedChain"),
        ({"task": 3}, ModelError, "task: expected CarryTask, got int"),
        ({"render_mode": "rgb_array"}, MethodNotApplicable, "render_mode: expected None, got 'rgb_array'"),
    ],
)
def test_settings_refused(setting, error, message):
    """By name."""
    given = {name: x() if x is carry else x for name, x in setting.items()}
    with pytest.raises(error) as refused:
        hf.gym.Carry(**given)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (
            {"giver": "left", "receiver": "left"},
            "receiver: expected an arm with a grasp, got 'left'. 'left' is the giver",
        ),
        ({"giver": "lift"}, "giver: expected an arm with a grasp, got 'lift'. Did you mean 'left'"),
        ({"retreat": [0.1]}, "retreat: expected shape"),
        ({"still": -1.0}, "still: expected > 0"),
    ],
)
def test_hand_over_settings_refused(setting, message):
    """By name."""
    with pytest.raises(ModelError) as refused:
        hf.gym.HandOverTask(**setting)
    assert message in str(refused.value)


def test_single_refusals():
    """Steps without an episode, actions that are none, options that the task has not, pictures."""
    env = hf.gym.Carry(short_carry())
    for wrong, message in (([0.0], "action: expected shape"), ([np.nan] * 7, "action"), (["a"] * 7, "action")):
        with pytest.raises(StateError, match=message):
            env.step(wrong)
    for call, error, message in (
        (lambda: env.step(np.zeros(7)), StateError, "under way"),
        (lambda: env.reset(options={"mass": 1.0}), StateError, "no 'mass'"),
        (lambda: env.reset(options={"turn": 1.0}), StateError, "turn: expected shape"),
        (lambda: env.reset(options={"mass_factor": -1.0}), HoldfastError, "mass"),
        (env.render, MethodNotApplicable, "draw nothing"),
    ):
        with pytest.raises(error, match=message):
            call()
    env.reset(seed=0)
    while not (outcome := env.step(np.zeros(7)))[2] and not outcome[3]:
        pass
    with pytest.raises(StateError, match="over"):
        env.step(np.zeros(7))


def test_vector_refusals():
    """Likewise, and masks, seeds and modes."""
    envs = hf.gym.CarryVector(2, short_carry(), autoreset_mode=AutoresetMode.DISABLED)
    for call, error, message in (
        (lambda: envs.step(np.zeros((2, 7))), StateError, "try reset"),
        (lambda: envs.step(np.zeros(7)), StateError, "action"),
        (lambda: envs.reset(seed=[1, 2, 3]), StateError, "seed: expected"),
        (lambda: envs.state(2), StateError, "from 0 to 1"),
        (
            lambda: hf.gym.CarryVector(2, short_carry(), autoreset_mode="later"),
            ModelError,
            "or one of 'NextStep'",
        ),
        (lambda: hf.gym.CarryVector(0), StateError, "num_envs: expected an integer >= 1"),
    ):
        with pytest.raises(error, match=message):
            call()
    for mask in ([True, False], np.zeros(2, dtype=bool), np.ones(3, dtype=bool), np.ones(2)):
        with pytest.raises(StateError, match="reset_mask: expected an array of 2 truth values"):
            envs.reset(options={"reset_mask": mask})
    envs.reset(seed=0)
    for _ in range(envs.task.episode_steps):
        over = np.logical_or(*envs.step(np.zeros((2, 7)))[2:4])
        if over.any():
            break
    with pytest.raises(StateError, match="reset_mask"):
        envs.step(np.zeros((2, 7)))


def test_missing_extra():
    """Without Gymnasium the import names the command that installs it."""
    code = "import sys; sys.modules['gymnasium'] = None\nimport holdfast as hf\n"
    code += "try: hf.gym\nexcept hf.errors.MissingExtra as e: print(e)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "pip install 'holdfast[gym]'" in said


@pytest.mark.slow
def test_actions_of_a_sampled_law():
    """An action acts from the next sample on, after the delay; the noise of an episode can be chosen and repeated."""
    sampling = {"sample_time": 4e-3, "delay": 2e-3, "noise": {"tau": 0.1}, "seed": 4}
    env = hf.gym.Carry(commands="joint", sampling=sampling, steps_per_action=1, push=np.zeros(6), mass_spread=0.0)
    chain, option = env.task.chain, {"noise_stream": 7, "displacement": np.zeros(3), "turn": np.zeros(3)}

    def torques(actions, **options):
        env.reset(seed=0, options=option | options)
        found = []
        for action in actions:
            env.step(np.full(chain.joint_count, action))
            found.append(env.episodes.systems[0].tau[0].copy())
        return np.array(found)

    still, pushed = torques([0.0] * 5), torques([0.0, 0.1, 0.1, 0.1, 0.1])
    # the action of 2 ms is read by the sample at 4 ms and acts from 6 ms on; torques are read at 2, 4, 6 ... ms
    assert (still == torques([0.0] * 5)).all()
    assert (still != torques([0.0] * 5, noise_stream=8)).all()
    changed = np.abs(pushed - still).max(axis=1) > 0.5
    assert changed.tolist() == [False, False, True, True, True]
    for options in ({"noise_stream": -1}, {"noise_stream": 0.5}):
        with pytest.raises(StateError, match="noise_stream: expected an integer >= 0"):
            env.reset(options=options)


@pytest.mark.parametrize(
    ("sampling", "message"),
    [
        (2e-3, "sampling: expected"),
        ({"delay": 1e-3}, "sampling: expected a sample_time, got none"),
        ({"sample_tim": 1e-3}, "sampling: no 'sample_tim'. Did you mean 'sample_time'"),
        ({"sample_time": 3e-3}, "step: expected one that divides the sample time 0.003 s .* got 0.002 s"),
        ({"sample_time": 2e-3, "noise": {"q": 1e-3}}, "seed: expected an integer"),
    ],
    ids=str,
)
def test_impossible_sampling(sampling, message):
    """Refused when the task is made, by name."""
    with pytest.raises(HoldfastError, match=message):
        hf.gym.CarryTask(sampling=sampling)
