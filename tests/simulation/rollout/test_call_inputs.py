"""What a call gives acts until another call changes it, in the first stage of the next step too; systems travel."""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest

from holdfast import ControlLaw, Inputs, State, compile_rollout
from holdfast.errors import FrozenError, StateError
from holdfast.simulation import Rollout
from holdfast.simulation.environment import Environment
from holdfast.simulation.runge_kutta import MIDPOINT, RK4
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.spatial.scalar import minimum, sin, where
from tests.compiler.programs import same_bits
from tests.simulation.gantries import squeezed
from tests.simulation.rollout.problems import arrays, elsewhere, generic_rank, given_torques, problem, same, tiled

COUNT, STEP, LONG = 3, 1e-3, 1e-2
ANEW = ("gain", "pull", "object_mass", "gravity", "grasp_pose", "object_wrench", "object_com")


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


@pytest.mark.parametrize("name", ANEW)
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


@pytest.mark.slow
def test_another_law():
    """A law that takes over acts in the first stage of its first step; what the law before was given is not its own."""
    held, state = given_torques("one"), problem("one")[1]
    chain = held.chain
    laws = [ControlLaw(lambda t, x, m, g, k=k: (-k * x.qd, m)) for k in (1.0, 50.0)]
    plain = [compile_rollout(chain, law, scheme="midpoint") for law in laws]
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


def test_torques_and_wrenches_of_each_step():
    """Zero-order hold as the reference has it: every stage of a step, the first one too, sees that step's torques."""
    rollout, (chain, state) = given_torques("one"), problem("one")
    random, rank = np.random.default_rng(3), generic_rank(chain, state)
    systems = rollout.start(**arrays(state), tau=np.zeros(6))
    for _ in range(4):
        tau, wrench = 10.0 * random.normal(size=6), 5.0 * random.normal(size=6)
        environment = Environment(chain, inputs=Inputs(object_wrench=wrench))
        reference = ReferenceStepper(environment, lambda t, x, m, tau=tau: (tau, m), rank, RK4)
        found = reference.advance(reference.start(0.0, systems.state(0), None)[0], [LONG])[0].instant
        rollout.step(systems, LONG, tau=tau, object_wrench=wrench)
        assert np.abs(systems.q[0] - found.state.q).max() <= 1e-12
        assert np.abs(systems.qd[0] - found.state.qd).max() <= 1e-11
        assert np.abs(systems.qdd[0] - found.result.qdd).max() <= 1e-9


@cache
def integrating() -> tuple[Rollout, State]:
    """Return a block between gantries under a law with gain, target and an integral."""
    chain, state = squeezed(("rigid", "rigid"), None)

    def torque(t, state, memory, given):
        error = given["target"][()] - state.object_pose[6]
        up = given["gain"] @ np.array([error, memory[0], -state.object_twist[5]])
        return np.array([0.0, 0.0, up, 0.0, 0.0, 0.0]), np.array([memory[0] + 0.01 * error, memory[1] + 1.0])

    law = ControlLaw(torque, np.array([0.1, 0.0]), {"gain": (3,), "target": ()}, key="tests: integrating")
    return compile_rollout(chain, law, scheme="midpoint"), state


def gains(target: float) -> dict[str, object]:
    """Return the law's parameters."""
    return {"gain": np.array([40.0, 15.0, 3.0]), "target": target}


@pytest.mark.slow
def test_memory_moves_once_a_step():
    """Steps count, whether parameters change or not, are given again or not; each chapter's first torque is its own."""
    rollout, state = integrating()
    systems = rollout.start(**arrays(state), **gains(0.2))
    assert np.allclose(systems.memory[0], [0.1 + 0.01 * 0.2, 1.0])
    rollout.step(systems, LONG, steps=3, **gains(0.2))
    assert systems.memory[0, 1] == 4.0
    changed = systems.copy()
    rollout.step(changed, LONG, **gains(-0.5))
    assert changed.memory[0, 1] == 5.0
    twice, at_once = systems.copy(), systems.copy()
    for _ in range(2):
        rollout.step(twice, LONG, **gains(0.2))
    rollout.step(at_once, LONG, steps=2, **gains(0.2))
    assert same(twice, at_once)


@pytest.mark.slow
def test_a_changed_law_is_the_references():
    """The reference, begun anew with the memory that the last torques came from, takes the same step."""
    rollout, state = integrating()
    systems = rollout.start(**arrays(state), **gains(0.2))
    rollout.step(systems, LONG, steps=3, **gains(0.2))
    at, memory = systems.state(0), systems.arrays["before"][0].copy()

    def controller(t, x, m):
        return rollout.law.torque(t, x, m, gains(-0.5) | {"target": np.array(-0.5)})

    reference = ReferenceStepper(Environment(rollout.chain), controller, 9, MIDPOINT)
    now, _ = reference.start(systems.t[0], at, memory)
    found = reference.advance(now, [systems.t[0] + LONG])[0].instant
    rollout.step(systems, LONG, **gains(-0.5))
    assert np.abs(systems.object_twist[0] - found.state.object_twist).max() <= 1e-13
    assert np.abs(systems.memory[0] - found.memory).max() <= 1e-13
    assert np.abs(systems.tau[0] - found.tau).max() <= 1e-12


@pytest.mark.slow
def test_given_memory():
    """Shared or by system."""
    rollout, state = integrating()
    many = tiled(state, 2)
    shared = rollout.start(**many, memory=[0.5, 2.0], **gains(0.0))
    own = rollout.start(**many, memory=[[0.5, 2.0], [0.1, 0.0]], **gains(0.0))
    assert np.array_equal(shared.memory[:, 1], [3.0, 3.0]) and np.array_equal(own.memory[:, 1], [3.0, 1.0])
    assert same_bits(own.qdd[0], shared.qdd[0]) and not np.array_equal(own.qdd[1], shared.qdd[1])


@pytest.mark.parametrize("refused", [{"threads": 0}, {"least_margin": np.nan}, {"steps": 0}, {"step": -1.0}])
def test_a_refused_call_is_forgotten(refused):
    """The torques of a call that was refused are new to the next one."""
    rollout, (_, state) = given_torques("one"), problem("one")
    systems = rollout.start(**arrays(state), tau=np.zeros(6))
    expected = rollout.step(systems.copy(), LONG, tau=np.ones(6))
    with pytest.raises(StateError):
        rollout.step(systems, **{"step": LONG, "tau": np.ones(6)} | refused)
    with pytest.raises(StateError):
        integrating()[0].step(systems, LONG, **gains(0.0))
    rollout.step(systems, LONG, tau=np.ones(6))
    assert same(systems, expected)


@pytest.mark.slow
def test_gravity_turned_off():
    """A parameter of the chain acts from the next step on: a free fall stops accelerating at once."""
    rollout, state = integrating()
    idle = {"gain": np.zeros(3), "target": 0.0}
    systems = rollout.start(**arrays(state), gravity=np.array([0.0, 0.0, -9.81]), **idle)
    rollout.step(systems, LONG, steps=5)
    fall = systems.object_twist[0, 5]
    assert fall == pytest.approx(-9.81 * 5 * LONG, rel=1e-12)
    rollout.step(systems, LONG, steps=4, gravity=np.zeros(3))
    assert systems.object_twist[0, 5] == pytest.approx(fall, rel=1e-12)


def test_reset_of_some():
    """Systems that begin anew go on as they would alone, under arguments of their own, and the others as before."""
    rollout, (_, state) = given_torques("one"), problem("one")
    many, tau = tiled(state, 4), np.linspace(0.0, 1.0, 6)
    systems = rollout.start(**many, tau=tau)
    rollout.step(systems, LONG, steps=3)
    kept, copied = systems.copy([0, 3]), systems.copy()
    fresh = rollout.start(**{name: x[:2] for name, x in many.items()}, tau=2.0 * tau, t=0.5)
    systems.reset([1, 2], fresh)
    assert systems.t.tolist() == [3 * LONG, 0.5, 0.5, 3 * LONG] and len(copied.call_inputs["control.tau"]) == 1
    for some in (systems, kept, fresh):
        rollout.step(some, LONG, steps=2)
    for name, x in systems.arrays.items():
        assert same_bits(x[[0, 3]], kept.arrays[name]) and same_bits(x[1:3], fresh.arrays[name]), name


def test_resets_refused():
    """Of systems that are not there, by another number, under other arguments or under another law."""
    rollout, (chain, state) = given_torques("one"), problem("one")
    systems, other = (rollout.start(**tiled(state, count), tau=np.zeros(6)) for count in (3, 1))
    law = ControlLaw(lambda t, x, m, given: (given["tau"] * given["share"], m), (), {"tau": (6,), "share": ()})
    sharing = compile_rollout(chain, law).start(**arrays(state), tau=np.zeros(6), share=0.5)
    stranger = integrating()[0].start(**arrays(integrating()[1]), **gains(0.0))
    for mine, rows, fresh, message in (
        (systems, [3], other, "rows: expected numbers from 0 to 2"),
        (systems, [True, False, True], other, "expected 2 systems for as many rows, got 1"),
        (systems, [0], stranger, "systems of the same rollout"),
        (systems, [0], None, "other: expected RolloutSystems, got NoneType"),
        (systems, [0], sharing, "the fresh systems have their own share; pass it to these systems' too"),
        (sharing, [0], systems.copy([0]), "these systems have their own share; pass it to the fresh `start` too"),
    ):
        with pytest.raises(StateError, match=message):
            mine.reset(rows, fresh)


MASS = {"object_mass": 3.0, "object_inertia": "scale"}
WRENCH = {"object_wrench": np.array([0.0, 0.1, 0.0, 2.0, 0.0, 1.0])}


@pytest.mark.parametrize("own", [MASS, WRENCH, MASS | WRENCH], ids=["mass", "wrench", "both"])
def test_resets_say_what_they_change(own):
    """What a start is not given stays as it was in those rows; what only it is given is the chain's own elsewhere."""
    rollout, (_, state) = given_torques("one"), problem("one")
    many, tau = tiled(state, 3), np.linspace(0.0, 1.0, 6)
    plain, whole = (rollout.step(rollout.start(**many, tau=tau, **more), LONG, steps=3) for more in ({}, own))
    others = {id(plain): plain.copy(), id(whole): whole.copy()}
    plain.reset([1], rollout.start(**arrays(state), tau=2.0 * tau, **own))
    whole.reset([1], rollout.start(**arrays(state), tau=2.0 * tau))
    alone = rollout.start(**arrays(state), tau=2.0 * tau, **own)
    rollout.step(alone, LONG, steps=2)
    for systems in (plain, whole):
        before = others[id(systems)]
        rollout.step(systems, LONG, steps=2)
        rollout.step(before, LONG, steps=2)
        assert same_bits(systems.q[[0, 2]], before.q[[0, 2]])
        for name in ("q", "qd", "qdd", "object_pose", "grasp_wrench"):
            assert getattr(systems, name)[1] == pytest.approx(getattr(alone, name)[0], rel=1e-12, abs=1e-12)


def test_no_systems():
    """What is given in the place of systems is named."""
    rollout = given_torques("one")
    for call in (
        lambda: rollout.step(None, LONG),
        lambda: rollout.run(0.1, 0.1, LONG),
        lambda: rollout.tape([], LONG, steps=1),
        lambda: rollout.take_over("systems"),
    ):
        with pytest.raises(StateError, match="systems: expected those that `start` returned, got"):
            call()


def test_shapes_in_words():
    """A number for each of four systems is of shape (4,)."""
    rollout, state = integrating()
    many = tiled(state, 4)
    with pytest.raises(StateError, match=r"target: expected shape \(\) or \(4,\), got \(3,\)"):
        rollout.start(**many, gain=np.zeros(3), target=np.zeros(3))
    with pytest.raises(StateError, match=r"gain: expected shape \(3,\) or \(batch, 3\), got \(2,\)"):
        rollout.start(**many, gain=np.zeros(2), target=0.0)
