"""What a call gives acts until another call changes it; rollouts and systems travel."""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest

from holdfast import ControlLaw, FrozenError, State, StateError, compile_rollout
from holdfast.simulation import Rollout
from holdfast.spatial.scalar import minimum, sin, where
from tests.compiler.programs import same_bits
from tests.simulation.rollout.problems import arrays, elsewhere, given_torques, problem, same

COUNT, STEP = 3, 1e-3


@cache
def braking() -> tuple[Rollout, State]:
    """Return the rollout of one arm under a law with a gain, one of its joints pulled."""
    chain, state = problem("one")
    home = np.array(state.q)

    def torque(t: Any, now: State, memory: Any, given: Any) -> tuple[Any, Any]:
        push = minimum(-given["gain"][()] * now.qd, 30.0 + memory[0])
        return push + where(t < 0.5, given["pull"], 0.0) - sin(now.q - home), np.array([0.9 * memory[0] + t])

    return compile_rollout(chain, ControlLaw(torque, [0.2], {"gain": (), "pull": (6,)}), scheme="midpoint"), state


def everything(rollout: Rollout, count: int) -> dict[str, Any]:
    """Return every parameter there is: some shared, most of each system's own."""
    random, chain = np.random.default_rng(5), rollout.chain
    body, (grasp,) = chain.held_object, chain.grasps.values()
    return {
        "gain": random.uniform(1.0, 9.0, count),
        "pull": random.normal(size=6),
        "object_mass": body.mass * random.uniform(0.5, 2.0, count),
        "object_inertia": "scale",
        "object_com": body.com + 0.01 * random.normal(size=(count, 3)),
        "gravity": np.array([0.3, 0.0, -9.0]),
        "grasp_pose": np.array([[grasp.frame.wxyz_xyz]]) + np.array([0, 0, 0, 0, 1e-4, 0, 0]) * np.ones((count, 1, 7)),
        "object_wrench": random.normal(size=(count, 6)),
    }


def test_kept():
    """Payload, gravity, frames, wrenches and the law's parameters given at the start act in every later step."""
    rollout, state = braking()
    given, where_they_are = everything(rollout, COUNT), elsewhere(rollout.chain, state, COUNT)
    systems, given_again = (rollout.start(**where_they_are, **given) for _ in range(2))
    for _ in range(3):
        rollout.step(systems, STEP, steps=2)
        rollout.step(given_again, STEP, steps=2, **given)
    assert same(systems, given_again) and systems.running.all()
    record = rollout.run(systems, 4 * STEP, STEP)
    rollout.step(systems, STEP, steps=4)
    assert same(record.systems, systems)


@pytest.mark.parametrize(
    "name", ["gain", "pull", "object_mass", "gravity", "grasp_pose", "object_wrench", "object_com"]
)
def test_given_anew(name):
    """One parameter changes, the others stay; so does the change."""
    rollout, state = braking()
    given = everything(rollout, COUNT)
    other = {name: 0.9 * given[name]} | ({"object_inertia": "scale"} if name == "object_mass" else {})
    if name == "grasp_pose":
        other = {name: given[name] + np.array([0, 0, 0, 0, 0, 1e-4, 0])}
    systems, as_given, nominal = (rollout.start(**elsewhere(rollout.chain, state, COUNT), **given) for _ in range(3))
    rollout.step(systems, STEP, **other)
    rollout.step(systems, STEP)
    for _ in range(2):
        rollout.step(as_given, STEP, **given | other)
        rollout.step(nominal, STEP)
    assert same(systems, as_given) and not same_bits(systems.qd, nominal.qd)


def test_rows_keep_their_own():
    """Some of the systems, by number or truth value, go on as they did among the others."""
    rollout, state = braking()
    systems = rollout.start(**elsewhere(rollout.chain, state, COUNT), **everything(rollout, COUNT))
    rollout.step(systems, STEP)
    some, one = systems.copy([2, 0]), systems.copy(np.array([False, True, False]))
    for each in (systems, some, one):
        rollout.step(each, STEP, steps=3)
    assert same_bits(some.q, systems.q[[2, 0]]) and same_bits(one.q, systems.q[1:2])
    assert same_bits(some.grasp_wrench, systems.grasp_wrench[[2, 0]])


def test_a_callers_array_is_its_own():
    """What was given is a copy: an action that is overwritten acts when it is given."""
    rollout, state = given_torques("one"), problem("one")[1]
    tau = np.ones(6)
    systems, expected = (rollout.start(**arrays(state), tau=tau) for _ in range(2))
    tau[...] = 5.0
    rollout.step(systems, STEP)
    rollout.step(expected, STEP, tau=np.ones(6))
    assert same(systems, expected)


def test_another_law():
    """A law that takes over acts in the first stage of its first step; what the law before was given is not its own."""
    held, state = given_torques("one"), problem("one")[1]
    chain = held.chain
    plain = [
        compile_rollout(chain, ControlLaw(lambda t, x, m, g, k=k: (-k * x.qd, m)), scheme="midpoint")
        for k in (1.0, 50.0)
    ]
    systems = plain[0].start(**arrays(state))
    plain[0].step(systems, STEP)
    fresh = plain[1].start(systems.q, systems.qd, systems.object_pose, systems.object_twist, t=float(systems.t[0]))
    plain[1].step(systems, STEP)
    plain[1].step(fresh, STEP)
    np.testing.assert_allclose(systems.qd, fresh.qd, rtol=0, atol=1e-11)
    with pytest.raises(StateError, match="the control law's parameter 'tau' is missing"):
        held.step(systems, STEP)
    with pytest.raises(StateError, match=r"systems: .*try systems that `start` of this rollout returned"):
        given_torques("legs").step(systems, STEP, tau=np.zeros(given_torques("legs").chain.joint_count))


def test_travelling():
    """A started rollout whose law is a closure, and its systems, are pickled, and go on to the same bits elsewhere."""
    rollout, state = braking()
    systems = rollout.start(**elsewhere(rollout.chain, state, COUNT), **everything(rollout, COUNT))
    rollout.step(systems, STEP, steps=2)
    other, there = pickle.loads(pickle.dumps((rollout, systems)))
    assert other.generic_rank == rollout.generic_rank and other.law.parameters == rollout.law.parameters
    for law in (rollout.law, other.law):  # both are functions on floats
        tau, memory = law.torque(0.1, state, np.array([0.2]), {"gain": np.array(2.0), "pull": np.ones(6)})
        assert tau.shape == (6,) and memory == pytest.approx([0.28])
    rollout.step(systems, STEP, steps=3)
    other.step(there, STEP, steps=3)
    assert same(systems, there)
    again = pickle.loads(pickle.dumps(other))
    again.step(there, STEP)
    rollout.step(systems, STEP)
    assert same(systems, there)
    named = given_torques("one")  # a law that is a function of a module travels as it is
    assert pickle.loads(pickle.dumps(named)).law.torque is named.law.torque


def test_nothing_is_written_in_vain():
    """A state written between two steps would not be what the next step begins with."""
    rollout, state = given_torques("one"), problem("one")[1]
    systems = rollout.start(**arrays(state), tau=np.zeros(6))
    for name in ("q", "qd", "object_pose", "grasp_wrench", "gap", "margin", "work"):
        with pytest.raises(FrozenError, match=f"systems: {name}: expected .* to stay.*try `start`"):
            setattr(systems, name, np.zeros(6))
        with pytest.raises(ValueError, match="read-only"):
            getattr(systems, name)[...] = 0.0
    with pytest.raises(FrozenError, match=r"systems: no attribute 'qs'\. Did you mean 'q"):
        systems.qs = np.zeros(6)
