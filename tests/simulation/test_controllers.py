"""What is given in the place of a controller, or returned by one, is named; nothing else of Python's comes out."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast import ControlLaw, HoldfastError, Inputs, compile_rollout, simulate
from holdfast.control import TorqueSchedule
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.errors import ModelError, StateError
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING
from tests.simulation.rollout.problems import arrays, problem

N = 6
ZEROS = np.zeros(N)
LONGER = ControlLaw(lambda t, x, m, given: (-x.qd, np.zeros(3)), np.zeros(2))
THREE = r"control law: memory: expected shape \(2,\), got (shape )?\(3,\); try ControlLaw\(torque, memory="
GAIN = ControlLaw(lambda t, x, m, given: (-given["gain"] * x.qd, m), parameters={"gain": ()})
NO_GAIN = "controller: the law takes gain, got no value; try parameters={'gain': ...}, or holdfast.compile_rollout"
NO_INPUTS = r"inputs: expected Inputs, or a function \(t\) -> Inputs or \(t, state\) -> Inputs, got ndarray"
STEPS = {"few": 2, "many": 3 * STEPS_WORTH_COMPILING}  # the reference, and machine code


def run(controller, steps: int, **options):
    """Return a run of one arm."""
    chain, state = problem("one")
    return simulate(chain, state, controller, steps * 1e-4, 1e-4, **options)


@pytest.mark.parametrize("steps", STEPS.values(), ids=STEPS)
@pytest.mark.parametrize(
    ("controller", "error", "message"),
    [
        (lambda t, x, m: ZEROS, StateError, r"torques and memory, got an array of shape \(6,\); try `return tau,"),
        (lambda t, x, m: None, StateError, "torques and memory, got a NoneType"),
        (lambda t, x, m: (np.zeros(N), m, 1), StateError, "torques and memory, got 3 things"),
        (lambda t, x, m: ("none", m), StateError, "controller: torques: expected numbers"),
        (lambda t, x, m: (np.ma.masked_equal(np.zeros(N), 0.0), m), StateError, "torques: .*got a masked array"),
        (np.zeros(N), ModelError, r"controller: expected a function \(t, state, memory\) .*, got ndarray; try lambda"),
        (None, ModelError, "controller: expected a function .*, got NoneType"),
        (lambda t, x: np.zeros(N), ModelError, r"controller: .*, got one of \(t, x\); try lambda t, state, memory:"),
        (lambda t, x, m, g: (np.zeros(N), m), ModelError, r"controller: .*, got one of \(t, x, m, g\)"),
        (ControlLaw(lambda t, x, m, given: (-given["kp"] * x.qd, m)), StateError, "parameter 'kp' was not declared"),
        (ControlLaw(lambda t, x, m, given: -x.qd), HoldfastError, "control law: expected .*torques and memory"),
        (LONGER, HoldfastError, THREE),
        ("holding", ModelError, "controller: expected a function .*, got str"),
        (GAIN, StateError, NO_GAIN),
    ],
)
def test_no_controllers(controller, error, message, steps):
    """By the reference or by machine code, at the first call or before it."""
    with pytest.raises(error, match=message):
        run(controller, steps)


def test_schedules_beside_others():
    """What stands beside a schedule is a controller too."""
    with pytest.raises(ModelError, match="controller: expected a function"):
        TorqueSchedule([0.0], [np.zeros((N, 1))], beside=np.zeros(N))  # type: ignore[arg-type]
    with pytest.raises(StateError, match="torques and memory, got an array"):
        run(TorqueSchedule([0.0], [np.zeros((N, 1))], beside=lambda t, x, m: np.zeros(N)), 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": ZEROS}, NO_INPUTS),
        ({"inputs": lambda t: np.zeros(6)}, "inputs: expected the function to return Inputs, got ndarray"),
        ({"base_motion": np.zeros(6)}, "base motion: expected a mapping"),
        ({"base_motion": {"arm0": np.zeros(7)}}, "base motion 'arm0': expected a function t -> .*, got ndarray"),
        ({"base_motion": {"arm0": lambda t: ZEROS}}, r"base motion of 'arm0': expected \(pose, twist, acc.*ndarray"),
        ({"events": ["release"]}, "events: expected Attach and Release, got str"),
        ({"events": 3}, "events: expected a list of Attach and Release, got int"),
    ],
)
def test_surroundings(options, message):
    """What acts from outside is a function of time, or constant."""
    chain, _ = problem("one")
    options = {key: {chain.names[0]: of["arm0"]} if isinstance(of, dict) else of for key, of in options.items()}
    with pytest.raises(HoldfastError, match=message.replace("arm0", chain.names[0])):
        run(GravityCompensation(chain), 2, **options)


GIVEN = {"gain": 0.7, "target": np.linspace(-1.0, 1.0, N)}
PULLED = ControlLaw(
    lambda t, x, m, given: (given["gain"] * (given["target"] - x.q) - x.qd + m, 0.5 * m),
    memory=np.full(N, 0.1),
    parameters={"gain": (), "target": (N,)},
)


@pytest.mark.parametrize(
    ("options", "steps"),
    [
        ({"on_limit": "clip"}, STEPS["few"]),
        ({"sample_time": 2e-4}, STEPS["few"]),
        pytest.param({}, STEPS_WORTH_COMPILING, marks=pytest.mark.slow),
        pytest.param({"inputs": lambda t: Inputs()}, STEPS_WORTH_COMPILING, marks=pytest.mark.long),
        pytest.param({"on_limit": "clip", "sample_time": 2e-4}, STEPS["many"], marks=pytest.mark.long),
    ],
)
def test_parameters_of_a_law(options, steps):
    """By the reference or machine code, whole or stagewise, sampled or not: as a function that knows the values."""

    def known(t, x, memory):
        memory = np.full(N, 0.1) if memory is None else memory
        return 0.7 * (np.linspace(-1.0, 1.0, N) - x.q) - x.qd + memory, 0.5 * memory

    mine, theirs = run(PULLED, steps, parameters=GIVEN, **options), run(known, steps, **options)
    for name in ("q", "qd", "tau", "work"):
        np.testing.assert_allclose(getattr(mine, name), getattr(theirs, name), rtol=0.0, atol=1e-12)
    kept = mine.setting.options["parameters"]
    assert kept["gain"] == 0.7
    assert list(kept["target"]) == GIVEN["target"].tolist()
    assert "parameters" not in theirs.setting.options


def test_parameters_as_in_a_rollout():
    """The same law under the same values: the two go the same way."""
    chain, state = problem("one")
    rollout = compile_rollout(chain, law=PULLED)
    systems = rollout.start(**arrays(state), **GIVEN)
    rollout.step(systems, 1e-4, steps=STEPS["few"])
    found = run(PULLED, STEPS["few"], parameters=GIVEN)
    np.testing.assert_allclose(systems.q[0], found.q[-1], atol=1e-13)
    np.testing.assert_allclose(systems.tau[0], found.tau[-1], atol=1e-12)


@pytest.mark.parametrize(
    ("controller", "parameters", "error", "message"),
    [
        (PULLED, {"gain": 1.0}, StateError, "the law takes target, got no value"),
        (PULLED, GIVEN | {"gian": 1.0}, StateError, "no parameter 'gian'. Did you mean 'gain'?"),
        (PULLED, GIVEN | {"gain": np.ones(2)}, StateError, r"parameter 'gain': expected shape \(\), got shape \(2,\)"),
        (PULLED, GIVEN | {"gain": np.nan}, StateError, "parameter 'gain': expected finite numbers"),
        (PULLED, [1.0], ModelError, "parameters: expected a mapping from a name to a value, got list"),
        (lambda t, x, m: (np.zeros(N), m), GIVEN, StateError, "parameters: expected none, got gain, target: only a"),
    ],
)
def test_parameters_that_do_not_fit(controller, parameters, error, message):
    """Each is named, before anything moves."""
    with pytest.raises(error, match=message):
        run(controller, 2, parameters=parameters)


def test_no_memory_is_none():
    """A law without memory may return None for it, on floats and in machine code."""
    law = ControlLaw(lambda t, x, m, given: (-x.qd, None))
    chain, state = problem("one")
    systems = compile_rollout(chain, law).start(**arrays(state))
    assert systems.running.all() and run(law, 2).stopped is None


def test_undeclared_parameters_of_rollouts():
    """The nearest that was declared is named."""
    chain, state = problem("one")
    law = ControlLaw(lambda t, x, m, given: (-given["kd"] * x.qd, m), parameters={"kp": ()})
    with pytest.raises(StateError, match=r"'kd' was not declared\. Did you mean 'kp'\? Known: kp\. Try ControlLaw"):
        compile_rollout(chain, law).start(**arrays(state), kp=1.0)
    with pytest.raises(ModelError, match="parameters: expected names such as 'gain', got 3"):
        ControlLaw(law.torque, parameters={3: ()})  # pyright: ignore[reportArgumentType]
