"""What changes between two calls acts from then on, in the first stage of the next step too."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from holdfast import ControlLaw, Inputs, State, StateError, compile_rollout
from holdfast.simulation import Rollout
from holdfast.simulation.environment import Environment
from holdfast.simulation.runge_kutta import MIDPOINT, RK4
from holdfast.simulation.stepper import ReferenceStepper
from tests.compiler.programs import same_bits
from tests.simulation.gantries import squeezed
from tests.simulation.rollout.problems import arrays, generic_rank, given_torques, problem

STEP = 1e-2


def test_torques_and_wrenches_of_each_step():
    """Zero-order hold as the reference has it: every stage of a step, the first one too, sees that step's torques."""
    rollout, (chain, state) = given_torques("one"), problem("one")
    random, rank = np.random.default_rng(3), generic_rank(chain, state)
    systems = rollout.start(**arrays(state), tau=np.zeros(6))
    for _ in range(4):
        tau, wrench = 10.0 * random.normal(size=6), 5.0 * random.normal(size=6)
        environment = Environment(chain, inputs=Inputs(object_wrench=wrench))
        reference = ReferenceStepper(environment, lambda t, x, m, tau=tau: (tau, m), rank, RK4)
        now, _ = reference.start(0.0, systems.state(0), None)
        (reached,) = reference.advance(now, [STEP])
        rollout.step(systems, STEP, tau=tau, object_wrench=wrench)
        assert reached.instant is not None
        found = reached.instant.state
        assert np.abs(systems.q[0] - found.q).max() <= 1e-12
        assert np.abs(systems.qd[0] - found.qd).max() <= 1e-11
        assert np.abs(systems.qdd[0] - reached.instant.result.qdd).max() <= 1e-9


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


def given(target: float) -> dict[str, object]:
    """Return the law's parameters."""
    return {"gain": np.array([40.0, 15.0, 3.0]), "target": target}


def test_memory_moves_once_a_step():
    """Steps count, whether parameters change or not, are given again or not; each chapter's first torque is its own."""
    rollout, state = integrating()
    systems = rollout.start(**arrays(state), **given(0.2))
    assert np.allclose(systems.memory[0], [0.1 + 0.01 * 0.2, 1.0])
    rollout.step(systems, STEP, steps=3, **given(0.2))
    assert systems.memory[0, 1] == 4.0
    changed = systems.copy()
    rollout.step(changed, STEP, **given(-0.5))
    assert changed.memory[0, 1] == 5.0
    twice, at_once = systems.copy(), systems.copy()
    for _ in range(2):
        rollout.step(twice, STEP, **given(0.2))
    rollout.step(at_once, STEP, steps=2, **given(0.2))
    assert all(same_bits(x, at_once.arrays[name]) for name, x in twice.arrays.items())


def test_a_changed_law_is_the_references():
    """The reference, begun anew with the memory that the last torques came from, takes the same step."""
    rollout, state = integrating()
    systems = rollout.start(**arrays(state), **given(0.2))
    rollout.step(systems, STEP, steps=3, **given(0.2))
    at, memory = systems.state(0), systems.arrays["before"][0].copy()

    def controller(t, x, m):
        return rollout.law.torque(t, x, m, given(-0.5) | {"target": np.array(-0.5)})

    reference = ReferenceStepper(Environment(rollout.chain), controller, 9, MIDPOINT)
    now, _ = reference.start(systems.t[0], at, memory)
    (reached,) = reference.advance(now, [systems.t[0] + STEP])
    rollout.step(systems, STEP, **given(-0.5))
    assert reached.instant is not None
    assert np.abs(systems.object_twist[0] - reached.instant.state.object_twist).max() <= 1e-13
    assert np.abs(systems.memory[0] - reached.instant.memory).max() <= 1e-13
    assert np.abs(systems.tau[0] - reached.instant.tau).max() <= 1e-12


def test_given_memory():
    """Shared or by system."""
    rollout, state = integrating()
    many = {name: np.tile(x, (2, 1)) for name, x in arrays(state).items()}
    shared = rollout.start(**many, memory=[0.5, 2.0], **given(0.0))
    own = rollout.start(**many, memory=[[0.5, 2.0], [0.1, 0.0]], **given(0.0))
    assert np.array_equal(shared.memory[:, 1], [3.0, 3.0]) and np.array_equal(own.memory[:, 1], [3.0, 1.0])
    assert same_bits(own.qdd[0], shared.qdd[0]) and not np.array_equal(own.qdd[1], shared.qdd[1])


@pytest.mark.parametrize("refused", [{"threads": 0}, {"least_margin": np.nan}, {"steps": 0}, {"step": -1.0}])
def test_a_refused_call_is_forgotten(refused):
    """The torques of a call that was refused are new to the next one."""
    rollout, (_, state) = given_torques("one"), problem("one")
    systems = rollout.start(**arrays(state), tau=np.zeros(6))
    expected = rollout.step(systems.copy(), STEP, tau=np.ones(6))
    with pytest.raises(StateError):
        rollout.step(systems, **{"step": STEP, "tau": np.ones(6)} | refused)
    with pytest.raises(StateError):
        integrating()[0].step(systems, STEP, **given(0.0))
    rollout.step(systems, STEP, tau=np.ones(6))
    assert all(same_bits(x, expected.arrays[name]) for name, x in systems.arrays.items())


def test_gravity_turned_off():
    """A parameter of the chain acts from the next step on: a free fall stops accelerating at once."""
    rollout, state = integrating()
    idle = {"gain": np.zeros(3), "target": 0.0}
    systems = rollout.start(**arrays(state), gravity=np.array([0.0, 0.0, -9.81]), **idle)
    rollout.step(systems, STEP, steps=5)
    fall = systems.object_twist[0, 5]
    assert fall == pytest.approx(-9.81 * 5 * STEP, rel=1e-12)
    rollout.step(systems, STEP, steps=4, gravity=np.zeros(3))
    assert systems.object_twist[0, 5] == pytest.approx(fall, rel=1e-12)


def test_reset_of_some():
    """Systems that begin anew go on as they would alone, under arguments of their own, and the others as before."""
    rollout, (_, state) = given_torques("one"), problem("one")
    many, tau = {name: np.tile(x, (4, 1)) for name, x in arrays(state).items()}, np.linspace(0.0, 1.0, 6)
    systems = rollout.start(**many, tau=tau)
    rollout.step(systems, STEP, steps=3)
    kept, copied = systems.copy([0, 3]), systems.copy()
    fresh = rollout.start(**{name: x[:2] for name, x in many.items()}, tau=2.0 * tau, t=0.5)
    systems.reset([1, 2], fresh)
    assert systems.t.tolist() == [3 * STEP, 0.5, 0.5, 3 * STEP] and len(copied.call_inputs["control.tau"]) == 1
    for some in (systems, kept, fresh):
        rollout.step(some, STEP, steps=2)
    for name, x in systems.arrays.items():
        assert same_bits(x[[0, 3]], kept.arrays[name]) and same_bits(x[1:3], fresh.arrays[name]), name


def test_resets_refused():
    """Of systems that are not there, by another number or under other arguments."""
    rollout, (_, state) = given_torques("one"), problem("one")
    systems = rollout.start(**{name: np.tile(x, (3, 1)) for name, x in arrays(state).items()}, tau=np.zeros(6))
    other = rollout.start(**arrays(state), tau=np.zeros(6))
    with pytest.raises(StateError, match="rows: expected numbers from 0 to 2"):
        systems.reset([3], other)
    with pytest.raises(StateError, match="expected 2 systems for as many rows, got 1"):
        systems.reset([True, False, True], other)
    with pytest.raises(StateError, match="systems of the same rollout"):
        systems.reset([0], integrating()[0].start(**arrays(integrating()[1]), **given(0.0)))
    with pytest.raises(StateError, match="other: expected RolloutSystems, got NoneType"):
        systems.reset([0], None)


MASS = {"object_mass": 3.0, "object_inertia": "scale"}
WRENCH = {"object_wrench": np.array([0.0, 0.1, 0.0, 2.0, 0.0, 1.0])}


@pytest.mark.parametrize("own", [MASS, WRENCH, MASS | WRENCH], ids=["mass", "wrench", "both"])
def test_resets_say_what_they_change(own):
    """What a start is not given stays as it was in those rows; what only it is given is the chain's own elsewhere."""
    rollout, (_, state) = given_torques("one"), problem("one")
    many, tau = {name: np.tile(x, (3, 1)) for name, x in arrays(state).items()}, np.linspace(0.0, 1.0, 6)
    plain, whole = (rollout.step(rollout.start(**many, tau=tau, **more), STEP, steps=3) for more in ({}, own))
    others = {id(plain): plain.copy(), id(whole): whole.copy()}
    plain.reset([1], rollout.start(**arrays(state), tau=2.0 * tau, **own))
    whole.reset([1], rollout.start(**arrays(state), tau=2.0 * tau))
    alone = rollout.start(**arrays(state), tau=2.0 * tau, **own)
    rollout.step(alone, STEP, steps=2)
    for systems in (plain, whole):
        before = others[id(systems)]
        rollout.step(systems, STEP, steps=2)
        rollout.step(before, STEP, steps=2)
        assert same_bits(systems.q[[0, 2]], before.q[[0, 2]])
        for name in ("q", "qd", "qdd", "object_pose", "grasp_wrench"):
            assert getattr(systems, name)[1] == pytest.approx(getattr(alone, name)[0], rel=1e-12, abs=1e-12)


def test_resets_under_another_law():
    """A parameter of the law that only one of them has is named, with what to do."""
    rollout, (chain, state) = given_torques("one"), problem("one")
    law = ControlLaw(
        lambda t, x, memory, given: (given["tau"] * given["share"], memory), (), {"tau": (6,), "share": ()}
    )
    other = compile_rollout(chain, law).start(**arrays(state), tau=np.zeros(6), share=0.5)
    systems = rollout.start(**arrays(state), tau=np.zeros(6))
    with pytest.raises(StateError, match="the fresh systems have their own share; pass it to these systems' too"):
        systems.reset([0], other)
    with pytest.raises(StateError, match="these systems have their own share; pass it to the fresh `start` too"):
        other.reset([0], systems)


def test_no_systems():
    """What is given in the place of systems is named."""
    rollout = given_torques("one")
    for call in (
        lambda: rollout.step(None, STEP),
        lambda: rollout.run(0.1, 0.1, STEP),
        lambda: rollout.tape([], STEP, steps=1),
        lambda: rollout.take_over("systems"),
    ):
        with pytest.raises(StateError, match="systems: expected those that `start` returned, got"):
            call()


def test_shapes_in_words():
    """A number for each of four systems is of shape (4,)."""
    rollout, state = integrating()
    many = {name: np.tile(x, (4, 1)) for name, x in arrays(state).items()}
    with pytest.raises(StateError, match=r"target: expected shape \(\) or \(4,\), got \(3,\)"):
        rollout.start(**many, gain=np.zeros(3), target=np.zeros(3))
    with pytest.raises(StateError, match=r"gain: expected shape \(3,\) or \(batch, 3\), got \(2,\)"):
        rollout.start(**many, gain=np.zeros(2), target=0.0)
