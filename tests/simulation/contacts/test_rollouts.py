"""Rollouts with contacts: the steps of the reference, the same bits in a batch and alone, and no failure in silence."""

from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import MethodNotApplicable
from holdfast.simulation import RolloutStatus
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.rollout import contact_steps
from holdfast.simulation.rollout.compiled_impulses import CompiledImpulseStepper
from holdfast.simulation.rollout.traced_step import UNLAWFUL
from tests.simulation.contacts.test_machine_code import lowering

STEP, STEPS = 1e-3, 60
RECORDED = ("q", "object_pose", "touch_force", "touch_gap", "touch_mode")

pytestmark = pytest.mark.long


@cache
def problem():
    """Return two Pandas that hold a box just above a table, with torques too weak for it."""
    chain, state, law = lowering(2e-5)
    return chain, state, law(0.0, state, None)[0]


@cache
def rollout():
    """Return the rollout of `problem` with given torques."""
    return hf.compile_rollout(problem()[0])


def started(count, seed=0):
    """Return systems with slightly different torques; the first has those of `problem`."""
    _, state, tau = problem()
    rows = [np.repeat(x[None], count, axis=0) for x in (state.q, state.qd, state.object_pose, state.object_twist)]
    taus = np.repeat(tau[None], count, axis=0)
    taus[1:] *= 1.0 + 0.003 * np.random.default_rng(seed).normal(size=taus[1:].shape)
    return rollout().start(*rows, tau=taus)


@cache
def reference():
    """Return the run of the reference, which takes most of the time of these tests."""
    chain, state, tau = problem()
    return hf.simulate(chain, state, lambda t, state, memory: (tau, memory), STEPS * STEP, STEP, contacts="steps")


def test_as_simulate():
    """Positions and work are those of `simulate(contacts="steps")`; so is the sum of forces, and gaps stay closed."""
    record, run = rollout().run(started(1), STEPS * STEP, STEP, record=RECORDED), reference()
    assert run.stopped is None and record.systems.running.all()
    assert np.abs(record["q"][:, 0] - run.q).max() < 1e-9
    assert np.abs(record["object_pose"][:, 0] - run.object_pose).max() < 1e-9
    assert np.abs(record["touch_force"][1:, 0].sum(axis=1) - run.touch_force[1:].sum(axis=1)).max() < 1e-6
    assert (record["touch_mode"][-1] > 0).all()
    assert record["touch_gap"].min() > -1e-12
    assert np.abs(record.systems.work[0] - run.work[-1]).max() < 1e-9
    again = record.trajectory(0)
    np.testing.assert_array_equal(again.touch_force, record["touch_force"][:, 0])
    assert np.abs(again.imbalance - run.imbalance).max() < 1e-9
    assert np.abs(again.momentum_imbalance - run.momentum_imbalance).max() < 1e-6
    assert again.position_gap.max() < 1e-9
    closed = again.touch_mode > 0
    assert again.touch_margin[closed].min() > -1e-6 and np.isinf(again.touch_margin[~closed]).all()
    assert again.touch_status[-1] == 1  # four corners share the load


def test_simulate_by_machine_code():
    """A law that can be traced takes steps in machine code: the motion of the reference, and the same bits resumed."""
    chain, state, tau = problem()
    law = hf.ControlLaw(lambda t, state, memory, given: (given["tau"], memory), parameters={"tau": tau.shape})
    given, how, kept = (chain, state, law, STEPS * STEP, STEP), {"contacts": "steps", "parameters": {"tau": tau}}, []
    taken = []
    with pytest.MonkeyPatch.context() as patch:
        whole = CompiledImpulseStepper.advance
        patch.setattr(CompiledImpulseStepper, "advance", lambda *of: taken.append(whole(*of)) or taken[-1])
        fast = hf.simulate(*given, **how, on_checkpoint=kept.append)
        assert len(taken) >= STEPS
        saved = Checkpoint.from_data(*kept[40].to_data())
        rest = hf.simulate(*given, **how, start=saved)
    true = reference()
    assert [(one.kind, one.name) for one in fast.occurrences] == [(one.kind, one.name) for one in true.occurrences]
    for name, within in (("q", 1e-9), ("object_pose", 1e-9), ("work", 1e-9), ("momentum_imbalance", 1e-9)):
        assert np.abs(getattr(fast, name) - getattr(true, name)).max() < within, name
    for name in ("q", "touch_force", "work", "grasp_wrench"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(fast, name)[-len(rest) :], err_msg=name)


def test_batch_and_single_have_the_same_bits():
    """Also where systems take different ways; nothing depends on the number of steps of a call."""
    many = rollout().step(started(12), STEP, steps=STEPS)
    for row in (0, 5, 11):
        alone = started(12).copy([row])
        for part in (1, 7, STEPS - 8):
            rollout().step(alone, STEP, steps=part)
        for name, x in many.arrays.items():
            np.testing.assert_array_equal(alone.arrays[name][0], x[row], err_msg=name)


def test_a_record_and_its_folder(tmp_path):
    """What a system carries into the next step is in its record: read again, it goes on with the same bits."""
    record = rollout().run(started(2), STEPS * STEP, STEP, record=RECORDED)
    record.save(tmp_path / "record")
    read = hf.io.load_record(tmp_path / "record", rollout=rollout())
    np.testing.assert_array_equal(read["touch_force"], record["touch_force"])
    for systems in (record.systems, read.systems):
        rollout().step(systems, STEP, steps=5)
    np.testing.assert_array_equal(read.systems.touch_force, record.systems.touch_force)
    np.testing.assert_array_equal(read.systems.q, record.systems.q)


def test_nothing_fails_in_silence(monkeypatch):
    """A system whose impulses are never found stops at its last good state, and says why; the others go on."""
    systems = started(3)
    rollout().step(systems, STEP, steps=40)
    before = systems.copy()

    def without_success(take, few, h):
        few.arrays["code"][...] = UNLAWFUL

    monkeypatch.setattr(contact_steps, "_without_last_forces", without_success)
    for arrays in (systems.arrays, before.arrays):
        arrays["touch_force"][1] = 1e9  # far from any solution, and the surer ways are taken away
    rollout().step(systems, STEP, steps=3)
    assert [one.name for one in systems.status] == ["RUNNING", "UNLAWFUL", "RUNNING"]
    np.testing.assert_array_equal(systems.q[1], before.q[1])
    assert "laws of contact" in RolloutStatus.UNLAWFUL.value


def test_surer_ways(monkeypatch):
    """A wrong start costs time, not the result: the path of the interior point finds the same motion."""
    systems = started(2)
    rollout().step(systems, STEP, steps=40)
    other = systems.copy()
    other.arrays["touch_force"][...] = 1e9
    for some in (systems, other):
        rollout().step(some, STEP, steps=3)
    assert other.running.all()
    assert np.abs(other.q - systems.q).max() < 1e-12


def test_boxes_that_tumble():
    """Of 128 systems with torques wrong by 1 %, none ends for want of impulses while its box lands, tips and lifts."""
    _, state, tau = problem()
    rows = [np.repeat(x[None], 128, axis=0) for x in (state.q, state.qd, state.object_pose, state.object_twist)]
    wrong = 1.0 + 0.01 * np.random.default_rng(0).normal(size=(128, len(tau)))
    wrong[0] = 1.0
    systems = rollout().start(*rows, tau=wrong * tau)
    modes = set[int]()
    for _ in range(30):
        rollout().step(systems, STEP, steps=50)
        assert systems.running.all()
        assert systems.touch_gap.min() > -1e-9
        modes |= set(systems.touch_mode.ravel().astype(int).tolist())
    assert modes == {0, 1, 2}


def test_what_is_refused():
    """Another scheme, and derivatives."""
    chain = problem()[0]
    with pytest.raises(MethodNotApplicable, match="scheme: expected 'midpoint' with contacts, got 'rk4'"):
        hf.compile_rollout(chain, scheme="rk4")
    with pytest.raises(MethodNotApplicable, match="tape: expected a chain without touching"):
        rollout().tape(started(1), STEP, steps=3)
