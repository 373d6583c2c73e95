"""What users may get wrong: every mistake is named, none is taken for something else."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from holdfast import ControlLaw, compile_rollout
from holdfast.compiler.errors import CompileError
from holdfast.errors import ModelError, StateError
from holdfast.simulation import Rollout, RolloutSystems
from tests.simulation.rollout.problems import arrays, given_torques, problem, same, started

NONE = np.zeros(6)
NO_LAW = "law: expected a ControlLaw, a ready-made controller or None, got function; try"


def one(count: int = 2) -> tuple[Rollout, RolloutSystems]:
    """Return systems of a chain of one arm under given torques."""
    rollout, (_, state) = given_torques("one"), problem("one")
    return rollout, started(rollout, state, count, tau=NONE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(5)}, r"q: expected shape \(6,\) or \(batch, 6\), got \(5,\)"),
        ({"qd": np.zeros((3, 6)), "q": np.zeros((2, 6))}, "expected one batch size, got q: 2, qd: 3"),
        ({"q": np.zeros((0, 6))}, "rollout: expected at least one system"),
        ({"q": "abc"}, "q: expected real numbers"),
        ({"tau": np.zeros(5)}, r"tau: expected shape \(6,\)"),
        ({"tau": np.zeros((3, 6))}, r"tau: expected shape \(6,\) or \(1, 6\), got \(3, 6\)"),
        ({"memory": np.zeros(2)}, r"memory: expected shape \(0,\)"),
        ({"t": np.nan}, "t: expected a finite number, got nan"),
        ({"threads": 1.5}, "threads: expected an integer >= 1, got 1.5"),
        ({"torque": NONE}, "no parameter 'torque'"),
        ({"tau": None}, "the control law's parameter 'tau' is missing: expected shape"),
        ({"object_mass": 1.0}, "object_mass: expected object_inertia beside it"),
    ],
)
def test_start(change, message):
    """States, time, memory."""
    rollout, _ = one()
    given = arrays(problem("one")[1]) | {"tau": NONE} | change
    with pytest.raises(StateError, match=message):
        rollout.start(**{name: x for name, x in given.items() if x is not None})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": 0.0}, "step: expected one positive number of seconds, or one for each system, got 0.0"),
        ({"step": "short"}, "step: expected one positive"),
        ({"step": [1e-3] * 3}, "step: expected one positive"),
        ({"steps": 1.0}, "steps: expected an integer >= 1, got 1.0"),
        ({"stop_at_limits": 0}, "stop_at_limits: expected True or False, got 0"),
        ({"least_margin": "some"}, "least_margin: expected a number, got 'some'"),
        ({"object_mas": 1.0}, "no parameter 'object_mas'. Did you mean 'object_mass'?"),
        ({"begin": 1.0}, "no parameter 'begin'"),
        ({"generic_rank": 6}, "no parameter 'generic_rank'"),
        ({"object_mass": 1.0}, "object_mass: expected object_inertia beside it.*try object_inertia='scale'"),
        ({"object_inertia": "scale"}, r"object_inertia: expected \(3, 3\) numbers, or 'scale' beside object_mass"),
        ({"object_mass": 1, "object_inertia": "same"}, r"object_inertia: expected \(3, 3\) numbers, or 'scale' beside"),
        ({"object_mass": [1.0, -1.0], "object_inertia": "scale"}, "object_mass: expected > 0"),
        ({"object_mass": [1, 2, 3], "object_inertia": "scale"}, r"mass: expected shape \(\) or \(2,\), got \(3,\)"),
        ({"object_wrench": np.full(6, np.inf)}, "object_wrench: expected finite numbers"),
        ({"object_wrench": np.zeros((3, 6))}, r"object_wrench: expected shape \(6,\) or \(2, "),
        ({"base_pose": np.ones((1, 7))}, "base_pose: expected unit quaternions"),
    ],
)
def test_step(change, message):
    """Steps and parameters; nothing has happened after a refusal."""
    rollout, systems = one()
    before = systems.copy()
    with pytest.raises(StateError, match=message):
        rollout.step(systems, **{"tau": NONE, "step": 1e-3} | change)
    assert same(systems, before)
    for each in (systems, before):
        rollout.step(each, 1e-3, tau=NONE)
    assert same(systems, before)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": 0.0105}, r"duration: expected a whole number of steps of 0.001 s, got 0.0105 s"),
        ({"duration": -0.01}, "duration: expected a whole number of steps"),
        ({"duration": "long"}, "duration: expected a finite number, got 'long'"),
        ({"duration": np.inf}, "duration: expected a finite number, got inf"),
        ({"every": 0}, "every: expected an integer >= 1, got 0"),
        ({"record": ("grasp_wrenches",)}, "record: no array 'grasp_wrenches'. Did you mean 'grasp_wrench'?"),
        ({"record": ("copy",)}, "record: no array 'copy'"),
    ],
)
def test_run(change, message):
    """Durations and records."""
    rollout, systems = one()
    with pytest.raises(StateError, match=message):
        rollout.run(systems, **{"duration": 0.01, "step": 1e-3, "tau": NONE} | change)


def test_record_by_name():
    """What was not recorded is named; systems at different times have no common record."""
    rollout, systems = one()
    record = rollout.run(systems, 2e-3, 1e-3, tau=NONE)
    with pytest.raises(KeyError, match=r"'qdd' was not recorded. Did you mean 'qd'"):
        record["qdd"]
    rollout.step(systems, [1e-3, 2e-3], tau=NONE)
    with pytest.raises(StateError, match=r"expected all at one time, got 0.001 s to 0.002 s"):
        rollout.run(systems, 2e-3, 1e-3, tau=NONE)


def test_systems_of_others():
    """Systems of another chain, of another law, cut, or converted are refused before their addresses are used."""
    rollout, systems = one()
    other = given_torques("nobody holds").start(**arrays(problem("nobody holds")[1]), tau=np.zeros(5))
    with pytest.raises(StateError, match=r"systems: q: expected shape \(1, 6\), got shape \(1, 5\)"):
        rollout.step(other, 1e-3, tau=NONE)
    for name, x, message in (
        ("qd", systems.qd[:1], "expected shape"),
        ("slope", systems.arrays["slope"].astype(np.float32), "float64 in C order, writeable"),
        ("qdd", np.asfortranarray(systems.qdd), "float64 in C order"),
    ):
        wrong = systems.copy()
        wrong.arrays[name] = x
        with pytest.raises(StateError, match=f"systems: {name}: .*{message}"):
            rollout.step(wrong, 1e-3, tau=NONE)
    wrong = systems.copy()
    del wrong.arrays["work"]
    with pytest.raises(StateError, match=r"systems: work: expected shape .*, got none"):
        rollout.step(wrong, 1e-3, tau=NONE)


def branching(t: Any, state: Any, memory: Any, given: Any) -> tuple[Any, Any]:
    """A law that chooses by a value."""
    if state.q[0] > 0.0:
        return np.zeros(6), memory
    return np.ones(6), memory


def by_math(t: Any, state: Any, memory: Any, given: Any) -> tuple[Any, Any]:
    """A law that asks for a number."""
    return np.full(6, math.sin(t)), memory


def torques_only(t: Any, state: Any, memory: Any, given: Any) -> Any:
    """A law that forgets its memory."""
    return np.zeros(6)


@pytest.mark.parametrize(
    ("torque", "message"),
    [
        (branching, r"test_arguments.py:\d+: `if state.q\[0\] > 0.0:`: the truth .* try where"),
        (by_math, r"test_arguments.py:\d+: `return np.full\(6, math.sin\(t\)\), memory`"),
        (torques_only, "control law: expected torques and memory, got ndarray; try `tau, memory`"),
        (lambda t, x, m, given: (np.zeros(5), m), r"control law: torques: expected shape \(6,\), got \(5,\)"),
        (lambda t, x, m, given: (1.0, m), r"control law: torques: expected shape \(6,\), got \(\)"),
        (lambda t, x, m, given: (np.zeros(6), np.zeros(2)), r"control law: memory: expected shape \(0,\), got \(2,\)"),
    ],
)
def test_laws_that_cannot_be_traced(torque, message):
    """The line is named, or what does not fit."""
    chain, state = problem("one")
    with pytest.raises(CompileError, match=message):
        compile_rollout(chain, ControlLaw(torque)).start(**arrays(state))


@pytest.mark.parametrize("name", ["gravity", "steps", "object_mass"])
def test_taken_names(name):
    """A law's parameter may not be called what a rollout's call has an argument for."""
    law = ControlLaw(branching, parameters={name: ()})
    with pytest.raises(ModelError, match=f"control law: parameter '{name}': expected a name of its own"):
        compile_rollout(problem("one")[0], law)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda chain: compile_rollout(chain, branching), NO_LAW),
        (lambda chain: compile_rollout("chain"), "chain: expected a ClosedChain, got str"),
        (lambda chain: compile_rollout(chain, scheme="rk5"), "Did you mean 'rk4'"),
        (lambda chain: compile_rollout(chain, scheme="dop853"), "expected 'rk4' or 'midpoint', got 'dop853'"),
        (lambda chain: ControlLaw(np.zeros(6)), "control law: torque: expected a function .*, got ndarray"),
        (lambda chain: ControlLaw(branching, memory=[np.nan]), "control law: memory: expected finite numbers"),
        (lambda chain: ControlLaw(branching, memory="none"), "control law: memory"),
        (lambda chain: ControlLaw(branching, parameters=["gain"]), "control law: parameters: expected a mapping"),
        (lambda chain: ControlLaw(branching, parameters={"gain": 3}), r"parameter 'gain': expected a shape such as"),
        (lambda chain: ControlLaw(branching, parameters={"gain": (-1,)}), "parameter 'gain': expected a shape"),
    ],
)
def test_what_cannot_be_made(make, message):
    """No law, chain, scheme, function, memory or shape."""
    with pytest.raises(ModelError, match=message):
        make(problem("one")[0])
