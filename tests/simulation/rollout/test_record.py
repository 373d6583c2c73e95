"""One system of a record as a run: the steps of the rollout to the bit, the samples of `simulate`."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import project_velocity
from holdfast.simulation.environment import Environment
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.simulation.trajectory import array_names
from tests.compiler.programs import same_bits
from tests.simulation.rollout.problems import arrays, difference, elsewhere, problem, swinging_law, tiled
from tests.simulation.rollout.test_statuses import gantries, given, slip_time
from tests.simulation.rollout.test_surroundings import shaken
from tests.simulation.rollout.test_trunk import leaning
from tests.simulation.rollout.test_trunk import problem as trunk_problem

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
@pytest.mark.parametrize("floating", [True, False])
def test_as_simulate(floating):
    """Under a law that looks at a floating base, or on one that moves; wrenches on all links, a payload of its own."""
    p = trunk_problem(floating)
    chain, n = p.chain, p.chain.joint_count
    law = leaning(n) if floating else swinging_law(n)
    bases = {} if floating else {"trunk": shaken(chain.trunk.base, 5, quaternion=False)}
    state = project_velocity(chain, p.state, inputs=Environment(chain, bases).at(0.0, p.state)[1])
    rollout = hf.compile_rollout(chain, law, scheme="midpoint", base_motion=bases, parameters=["link_wrench"])
    random, held = np.random.default_rng(4), chain.held_object
    on_links, on_trunk = random.normal(size=(3, n - 2, 6)), random.normal(size=(len(chain.trunk.bodies), 6))
    mass = held.mass * np.array([0.5, 1.0, 2.0])
    systems = rollout.start(**elsewhere(chain, state, 3), trunk_link_wrench=on_trunk)
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
        inputs=hf.Inputs(link_wrenches=on_links[2], trunk_link_wrenches=on_trunk), make_stepper=ReferenceStepper,
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
        with pytest.raises(hf.StateError, match="system: expected a number from 0 to 0"):
            record.trajectory(number)
        with pytest.raises(hf.StateError, match="system: expected a number from 0 to 0"):
            systems.state(number)
    for every in (0, 1.5, "2"):
        with pytest.raises(hf.StateError, match="every: expected an integer"):
            record.trajectory(0, every=every)
    with pytest.raises(hf.StateError, match="put together from arrays"):
        replace(record, arguments=None).trajectory(0)
