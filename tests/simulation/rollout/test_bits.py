"""No bit of a rollout depends on who else is in the batch, on threads, or on how its steps are asked for."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.compiler.targets import cpu
from holdfast.simulation import Rollout, RolloutSystems
from tests.compiler.programs import same_bits
from tests.simulation.rollout.problems import elsewhere, given_torques, problem, same, started, swinging

LANES = cpu.lanes()
COUNT = 2 * LANES + 3
STEP = 2e-3


def after(rollout: Rollout, systems: RolloutSystems, steps: int, **options) -> RolloutSystems:
    """Return a copy of the systems some steps later."""
    return rollout.step(systems.copy(), STEP, steps=steps, **options)


@pytest.mark.slow
def test_place_in_the_batch():
    """Alone, in tails of every length, turned round, in one thread or more than there are blocks."""
    rollout, (_, state) = swinging("five"), problem("five")
    systems = started(rollout, state, COUNT)
    whole = after(rollout, systems, 5)
    assert whole.running.all()
    for row in (0, LANES - 1, LANES, COUNT - 1):
        alone = rollout.start(**{k: x[row] for k, x in elsewhere(rollout.chain, state, COUNT).items()})
        assert same(alone, systems.copy([row]))
        assert same(after(rollout, alone, 5), whole.copy([row]))
    for count in range(1, COUNT):
        assert same(after(rollout, systems.copy(slice(count)), 5), whole.copy(slice(count)))
    turned = np.arange(COUNT)[::-1]
    assert same(after(rollout, systems.copy(turned), 5), whole.copy(turned))
    for threads in (2, 3, 7):
        assert same(after(rollout, systems, 5, threads=threads), whole)


@pytest.mark.slow
def test_how_steps_are_asked_for():
    """k steps in a call, one at a time, in odd portions, on copies; the law sees time and memory."""
    rollout, (_, state) = swinging("five"), problem("five")
    systems = started(rollout, state, LANES + 1, t=0.7)
    whole = after(rollout, systems, 30)
    one, odd = systems.copy(), systems.copy()
    for _ in range(30):
        rollout.step(one, STEP)
    for steps in (1, 7, 2, 19, 1):
        odd = rollout.step(odd, STEP, steps=steps).copy(np.arange(LANES + 1))  # a copy in every portion
    assert same(one, whole) and same(odd, whole)
    assert same_bits(whole.t, np.full(LANES + 1, 0.7 + 30 * STEP))
    assert np.array_equal(rollout.step(systems.copy(), np.full(LANES + 1, STEP), steps=30).q, whole.q)


def test_parameters_by_system():
    """Gravity, payload, bases, grasps and wrenches of each system: as if each ran alone with its own."""
    rollout, (chain, state) = given_torques("one"), problem("one")
    random, count = np.random.default_rng(0), LANES + 1
    body, (arm,), (grasp,) = chain.held_object, chain.arms.values(), chain.grasps.values()
    given = {
        "tau": random.normal(size=(count, chain.joint_count)),
        "object_wrench": random.normal(size=(count, 6)),
        "gravity": random.normal(size=(count, 3)),
        "object_mass": body.mass * random.uniform(0.5, 2.0, count),
        "object_com": body.com + 0.05 * random.normal(size=(count, 3)),
        "object_inertia": body.inertia * random.uniform(0.5, 2.0, (count, 1, 1)),
        "base_pose": np.tile(arm.base.wxyz_xyz, (count, 1, 1)),
        "grasp_pose": np.tile(grasp.frame.wxyz_xyz, (count, 1, 1)),
    }
    given["base_pose"][:, 0, 4:] += 1e-3 * random.normal(size=(count, 3))
    given["grasp_pose"][:, 0, 4:] += 1e-3 * random.normal(size=(count, 3))
    systems = started(rollout, state, count, **given)
    initial = systems.copy()
    rollout.step(systems, STEP, steps=4, **given)
    assert systems.running.all() and len(np.unique(systems.qdd[:, 0])) == count
    for row in range(count):
        own = {name: x[row] for name, x in given.items()}
        alone = rollout.step(initial.copy([row]), STEP, steps=4, **own)
        assert same(alone, systems.copy([row]))


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 3, 25])
def test_records(every):
    """What is recorded does not depend on how often it is, the last portion may be shorter."""
    rollout, (_, state) = swinging("five"), problem("five")
    systems = started(rollout, state, 3, t=0.1)
    before = systems.copy()
    fine = rollout.run(systems, 20 * STEP, STEP, record=("q", "grasp_wrench", "work", "status", "t"))
    coarse = rollout.run(systems, 20 * STEP, STEP, every=every, record=("q", "grasp_wrench", "work", "status", "t"))
    assert same(systems, before) and same(fine.systems, coarse.systems)
    rows = [*range(0, 20, every), 20]
    assert same_bits(coarse.t, fine.t[rows]) and np.array_equal(fine.t, 0.1 + STEP * np.arange(21))
    for name in ("q", "grasp_wrench", "work", "t"):
        assert same_bits(coarse[name], fine[name][rows])
    assert np.array_equal(fine["t"], np.tile(fine.t[:, None], 3))
    assert coarse["status"].shape == (len(rows), 3) and np.isinf(coarse.stopped).all()
    assert same_bits(fine["q"][-1], fine.systems.q)
    further = rollout.run(fine.systems, 5 * STEP, STEP)
    assert same(further.systems, after(rollout, systems, 25))
    assert further.t[0] == fine.t[-1]
