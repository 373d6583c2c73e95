"""Rollouts on a trunk take the reference's steps; one system of a record is a run, to the bit."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast import Attach, ControlLaw, Inputs, compile_rollout, simulate
from holdfast.dynamics import momentum, project_velocity
from holdfast.errors import StateError
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.compiled_steppers import stepper_for
from holdfast.simulation.rollout.fused_stepper import FusedStepper
from holdfast.simulation.rollout.python_law_stepper import PythonLawStepper
from holdfast.simulation.runge_kutta import MIDPOINT
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.simulation.trajectory import array_names
from tests.compiler.programs import same_bits
from tests.longer import mostly_long
from tests.simulation.rollout.problems import (
    arrays,
    difference,
    elsewhere,
    generic_rank,
    numbers,
    problem,
    swinging_law,
    tiled,
)
from tests.simulation.rollout.test_statuses import gantries, given, slip_time
from tests.simulation.rollout.test_surroundings import shaken
from tests.systems.as_chain import Problem
from tests.systems.trunk_runs import still_base


def on_trunk(floating: bool, **options: Any) -> Problem:
    """Return two arms on a trunk of two joints."""
    arms = {"arms": 2, "joints": 7, "grasps": ("rigid", "ball")} | options
    return still_base(3, 2, floating=floating, arms=arms, in_world=0.0)


def leaning(joint_count: int) -> ControlLaw:
    """Return torques that depend on where a floating base is, and on its velocity."""
    size = np.random.default_rng(2).normal(size=joint_count)
    return ControlLaw(lambda t, s, m, given: (size * (s.base_pose[4] - s.base_twist[1]) - s.qd, m), key="lean")


@pytest.mark.slow
@pytest.mark.parametrize("fused", [True, False])
def test_steppers(fused):
    """Whole steps of machine code, and steps whose controller is asked from Python, are the reference's."""
    p = on_trunk(True)
    chain, law, rank = p.chain, leaning(p.chain.joint_count), generic_rank(p.chain, p.state)

    def asked(t, state, memory):
        return law.torque(t, state, None, {})[0], memory

    environment = Environment(chain, inputs=Inputs(object_wrench=np.arange(6.0)))
    controller = law if fused else asked
    stepper = stepper_for(environment, controller, rank, MIDPOINT, Tolerance(), 1000)
    assert type(stepper) is (FusedStepper if fused else PythonLawStepper)
    found, expected = (
        one.advance(one.start(0.0, p.state, None)[0], [0.004, 0.01])
        for one in (stepper, ReferenceStepper(environment, asked, rank, MIDPOINT))
    )
    for one, other in zip(found, expected, strict=True):
        mine, theirs = numbers(one.instant), numbers(other.instant)
        mine["memory"] = theirs["memory"] = np.zeros(0)
        assert difference(mine, theirs) <= 1e-12


@pytest.mark.slow
def test_bits_and_travel():
    """Threads, the number of systems, and a way through a pickle change no bit."""
    p = on_trunk(True)
    law = ControlLaw(leaning(p.chain.joint_count).torque)
    rollout = compile_rollout(p.chain, law, scheme="midpoint")
    many = rollout.start(**elsewhere(p.chain, p.state, 5))
    one = rollout.start(**arrays(many.state(3)))
    again = rollout.start(**elsewhere(p.chain, p.state, 5))
    other, there = pickle.loads(pickle.dumps((rollout, many)))
    rollout.step(many, STEP, steps=3)
    rollout.step(again, STEP, steps=3, threads=2)
    other.step(there, STEP, steps=3)
    rollout.step(one, STEP, steps=3)
    for key, x in many.arrays.items():
        assert same_bits(x, again.arrays[key]) and same_bits(x, there.arrays[key]), key
    assert many.floating_pose[3] == pytest.approx(one.floating_pose[0], abs=1e-15)


@pytest.mark.slow
def test_a_grip_in_flight():
    """Systems taken over by a rollout with one more grasp: as `Attach`, without loss of momentum."""
    p = on_trunk(True, gravity=(0.0, 0.0, 0.0), grasps="rigid")
    name = p.chain.names[1]
    open_chain = p.chain.without_grasp(name)
    law = leaning(p.chain.joint_count)
    before, after = (compile_rollout(chain, law, scheme="midpoint") for chain in (open_chain, p.chain))
    moving = replace(p.state, qd=p.state.qd + 1e-6 * np.arange(p.chain.joint_count))
    systems = before.start(**arrays(project_velocity(open_chain, moving)))
    gripped = after.take_over(systems)
    assert gripped.running.all()
    run = simulate(
        open_chain, systems.state(0), law, 2e-3, 1e-3, events=[Attach(1e-3, name, p.chain.grasps[name], here=True)],
        make_stepper=ReferenceStepper,
    )  # fmt: skip
    assert run.holding[-1].all()
    size = np.abs(momentum(open_chain, systems.state(0))).max()
    assert np.abs(momentum(p.chain, gripped.state(0)) - momentum(open_chain, systems.state(0))).max() < 1e-13 * size


def test_states_of_the_base():
    """A floating base's pose and velocity are asked for, and refused where there is none."""
    free, fixed = on_trunk(True), on_trunk(False)
    rollout, given = compile_rollout(free.chain, scheme="midpoint"), arrays(free.state)
    with pytest.raises(StateError, match="floating_pose: expected that of the trunk's floating base, got none"):
        rollout.start(**{name: x for name, x in given.items() if not name.startswith("floating")})
    rollout = compile_rollout(fixed.chain, scheme="midpoint")
    with pytest.raises(StateError, match="floating_twist: expected none, as the chain has no floating base"):
        rollout.start(**arrays(fixed.state), floating_twist=np.zeros(6))


STEP, AGREEMENT = 1e-3, 1e-10
EXACT = 1e-11  # of the last samples
RECORDED = ("q", "qd", "object_pose", "object_twist", "tau", "work")
OTHERS = ("qdd", "grasp_wrench", "trunk_base_wrench")
OF_BASE = {f"floating_{name}": f"base_{name}" for name in ("pose", "twist", "acceleration")}
UNLIKE = {"position_gap", "velocity_gap", "condition"}  # rounding
UNLIKE |= {name for name in array_names() if name.startswith("lowest_")}  # a rollout looks at samples only


def agree(run, expected):
    """Compare every number of two runs."""
    assert len(run) == len(expected)
    for name in set(array_names()) - UNLIKE:
        a, b = getattr(run, name), getattr(expected, name)
        size = max(1.0, np.abs(b[np.isfinite(b)]).max(initial=0))
        assert np.allclose(a, b, rtol=AGREEMENT, atol=AGREEMENT * size), name


@pytest.mark.slow
@pytest.mark.parametrize("floating", mostly_long([True, False], (True,)))
def test_as_simulate(floating):
    """Under a law that looks at a floating base, or on one that moves; wrenches on all links, a payload of its own."""
    p = on_trunk(floating)
    chain, n = p.chain, p.chain.joint_count
    law = leaning(n) if floating else swinging_law(n)
    bases = {} if floating else {"trunk": shaken(chain.trunk.base, 5, quaternion=False)}
    state = project_velocity(chain, p.state, inputs=Environment(chain, bases).at(0.0, p.state)[1])
    rollout = hf.compile_rollout(chain, law, scheme="midpoint", base_motion=bases, parameters=["link_wrench"])
    random, held = np.random.default_rng(4), chain.held_object
    on_links, on_bodies = random.normal(size=(3, n - 2, 6)), random.normal(size=(len(chain.trunk.bodies), 6))
    mass = held.mass * np.array([0.5, 1.0, 2.0])
    systems = rollout.start(**elsewhere(chain, state, 3), trunk_link_wrench=on_bodies)
    own = {"object_mass": mass, "object_inertia": "scale", "link_wrench": on_links}
    names = (*RECORDED, *OTHERS, *(OF_BASE if floating else ()))
    record = rollout.run(systems, 10 * STEP, STEP, every=2, record=names, **own)
    assert record.systems.running.all() and record.systems.gap.max() <= 1e-12
    assert not np.allclose(record.systems.q[0], record.systems.q[1], rtol=0, atol=1e-9)
    run = record.trajectory(2)
    for name in RECORDED[:-2]:
        assert same_bits(getattr(run, name), record[name][:, 2]), name
    assert same_bits(run.work, record["work"][:, 2]) and same_bits(run.tau[1:], record["tau"][1:, 2])
    heavier = replace(chain, held_object=replace(held, mass=mass[2], inertia=2.0 * held.inertia))
    expected = hf.simulate(
        heavier, run.state(0), law, 10 * STEP, STEP, base_motion=bases, scheme="midpoint", on_slip="record",
        inputs=hf.Inputs(link_wrenches=on_links[2], trunk_link_wrenches=on_bodies), make_stepper=ReferenceStepper,
    )  # fmt: skip
    agree(record.trajectory(2, every=1), expected)
    found = {name: record[name][-1, 2] for name in names if name != "tau"}
    assert difference(found, {name: getattr(expected, OF_BASE.get(name, name))[-1] for name in found}) <= EXACT
    assert np.abs(run.imbalance).max() < 1e-2 * max(1.0, run.summary().energy_moved)
    assert pickle.loads(pickle.dumps(record)).trajectory(2).q.tobytes() == run.q.tobytes()


def test_one_that_slips(tmp_path):
    """It ends where it stood still, says why and when, and can be saved, written and drawn as any run."""
    rollout, state = gantries()
    rate = np.array([20.0, 600.0])
    systems = rollout.start(**tiled(state, 2), **given(rate))
    record = rollout.run(systems, 0.1, STEP, every=7, least_margin=0.0)
    assert "2 systems at 16 times" in repr(record) and "1 running, 1 slipped" in repr(record)
    run = record.trajectory(1)
    when = float(slip_time(rate[1:])[0])
    assert run.stopped.startswith(f"slipped at t = {when:.6f}"[:-2])
    assert run.t[-1] == record.systems.t[1] <= when
    assert same_bits(run.q[-1], record.systems.q[1])
    assert (run.margin[:, 0] >= 0.0).all()
    result = hf.load_result(run.save(tmp_path / "run"))
    assert not result.complete and "slipped" in result.note
    assert result.meta.scene == "system 1"
    assert record.trajectory(0).stopped is None


def test_laws_that_remember():
    """What a law carries on is replayed too."""
    chain, state = problem("one")
    rollout = hf.compile_rollout(chain, swinging_law(chain.joint_count), scheme="midpoint")
    systems = rollout.step(rollout.start(**elsewhere(chain, state, 2)), STEP, steps=3)
    record = rollout.run(systems, 0.004, STEP, record=RECORDED)
    run = record.trajectory(1)
    assert run.t[0] == pytest.approx(0.003)
    assert same_bits(systems.state(1).q, run.q[0])
    assert same_bits(record.systems.state(1).object_pose, run.object_pose[-1])
    assert same_bits(run.q, record["q"][:, 1]) and same_bits(run.tau, record["tau"][:, 1])


def test_refusals():
    """No such system, a stride that is none, a record put together from arrays."""
    rollout, state = gantries()
    systems = rollout.start(**arrays(state), **given(np.array(20.0)))
    record = rollout.run(systems, 0.002, STEP)
    for number in (1, -1, 0.0, "0", None, True):
        with pytest.raises(hf.errors.StateError, match="system: expected a number from 0 to 0"):
            record.trajectory(number)
        with pytest.raises(hf.errors.StateError, match="system: expected a number from 0 to 0"):
            systems.state(number)
    for every in (0, 1.5, "2"):
        with pytest.raises(hf.errors.StateError, match="every: expected an integer"):
            record.trajectory(0, every=every)
    with pytest.raises(hf.errors.StateError, match="put together from arrays"):
        replace(record, arguments=None).trajectory(0)
