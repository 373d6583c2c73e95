"""Runs of forests by machine code: the motion of the reference, closed and accounted for alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiled.forest_engine import CompiledForestEngine
from holdfast.dynamics.tree.forest_closing import forest_close
from holdfast.dynamics.tree.forest_inverse import inverse_at
from holdfast.dynamics.tree.forest_projection import closing_round
from holdfast.dynamics.tree.forest_simulate import ForestReference, forest_steps
from holdfast.dynamics.tree.mechanism_terms import chain_state, flat_state, mechanism_arguments
from holdfast.dynamics.tree.varied_forest import ForestArguments, displaced, position_rates
from holdfast.forces.margins import margin_of_row
from holdfast.forces.row_wrenches import contact_wrenches
from holdfast.model.grasp_rows import grasp_rows
from tests.dynamics.tree.as_branched import gap
from tests.longer import mostly_long, mostly_slow
from tests.systems.branched import branched_problems, palletiser, two_arms_with_grippers
from tests.systems.random_forests import random_forest

SLOW, LONG = pytest.mark.slow, pytest.mark.long
SEEDS = [4, *(pytest.param(k, marks=SLOW if k in (0, 2) else LONG) for k in range(12) if k != 4)]


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_steps(seed):
    """Motion, work, forces, gaps and energies of every kind of forest."""
    p = random_forest(seed)

    def acting(t, q, qd):
        return ForestArguments(p.forest, q, qd, p.tau, p.wrenches)

    runs = []
    for engine in (ForestReference(p.forest), CompiledForestEngine(p.forest)):
        samples = [*forest_steps(engine, p.q, p.qd, acting, 1e-3 * np.arange(4))]
        runs.append([(one, engine.account(one.given, one.now)) for one in samples])
    for (reference, theirs), (coded, ours) in zip(*runs, strict=True):
        assert gap(coded.given.q, reference.given.q) < 1e-12
        assert gap(coded.given.qd, reference.given.qd) < 1e-11
        assert gap(coded.now.qdd, reference.now.qdd) < 1e-8
        assert gap(coded.now.power, reference.now.power) < 1e-12
        assert coded.now.unique is reference.now.unique
        assert gap(ours.closure_wrench, theirs.closure_wrench) < 1e-8
        assert gap(ours.coupling_force, theirs.coupling_force) < 1e-8
        assert gap([ours.kinetic, ours.potential], [theirs.kinetic, theirs.potential]) < 1e-11
        assert max(ours.position_gap, ours.velocity_gap, theirs.position_gap, theirs.velocity_gap) < 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_rounds_close(seed):
    """Rounds close what a motion along the rates has opened, as `forest_close` does, at a quadratic rate."""
    p = random_forest(seed)
    q, qd, opened = displaced(p.forest, p.q, 2e-3 * p.qd), p.qd, []
    for _ in range(4):
        now = closing_round(p.forest, q, qd)
        q, qd, opened = now.q, now.qd, [*opened, now.position_gap]
    assert opened[1] < max(opened[0] ** 1.5, 1e-13) and opened[-1] < 1e-13
    closed = forest_close(p.forest, q, p.qd)
    assert gap(closed.q, q) < 1e-12
    assert gap(closed.qd, qd) < 1e-4  # the first rounds changed the rates where the closures were open


@pytest.mark.parametrize(
    "name", ["palletiser", *mostly_slow(["on a shoulder"], ()), *mostly_long(["grippers", "pot and lid"], ())]
)
def test_runs_of_chains(name):
    """Longer runs are machine code, shorter ones are not: the same samples, and the first of both is the start."""
    chain, state, tau = branched_problems()[name]

    def law(t, state, memory):
        return tau, memory

    short, long = (hf.simulate(chain, state, law, steps * 1e-3, 1e-3) for steps in (10, 60))
    for of in ("q", "qd", "object_pose", "tau", "qdd", "grasp_wrench", "coupling_force", "kinetic", "work"):
        assert gap(getattr(long, of)[:11], getattr(short, of)) < 1e-9
    assert np.abs(long.imbalance).max() < 1e-7
    assert long.position_gap[:, 1].max() < 1e-12


@pytest.mark.slow
def test_a_lower_rank_is_answered_by_the_reference():
    """A rank that is not that of the start is left to the reference, whose forces are the smallest there."""
    p = two_arms_with_grippers()
    forest = p.chain.forest
    q, qd = np.append(p.state.q, p.state.object_pose), np.append(p.state.qd, p.state.object_twist)
    given = ForestArguments(forest, q, qd, np.append(p.tau, np.zeros(6)), np.zeros((len(forest.bodies), 6)))
    engine = CompiledForestEngine(forest)
    engine.rank = forest.constraint_row_count
    assert gap(engine.instant(given).closure_wrench, ForestReference(forest).instant(given).closure_wrench) == 0.0


def test_refusals_are_those_of_the_reference():
    """A run whose torques overflow ends in the words of the reference, by machine code as well."""
    chain, state, tau = palletiser()
    for steps in (10, 60):
        run = hf.simulate(chain, state, lambda t, state, memory: (1e306 * np.sign(tau), memory), steps * 1e-3, 1e-3)
        assert "overflow" in run.stopped


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_inverse(seed):
    """Inverse dynamics by machine code: the terms, loads, forces and nearest accelerations of the reference."""
    p = random_forest(seed)
    given = ForestArguments(p.forest, p.q, p.qd, p.tau, p.wrenches)
    coded, reference = CompiledForestEngine(p.forest).inverse(given), inverse_at(given)
    assert coded is not None
    for ours, theirs in zip(coded.terms, reference.terms, strict=True):
        assert gap(ours, theirs) < 1e-12
    qdd = np.random.default_rng(seed).normal(size=len(p.qd))
    assert gap(coded.loads(qdd), reference.loads(qdd)) < 1e-12
    rows = len(reference.terms.G)
    asked = np.random.default_rng(seed + 100).normal(size=rows)
    ours, theirs = (of.carrying(reference.loads(qdd), asked) for of in (coded, reference))
    for a, b in zip(ours, theirs, strict=True):
        assert gap(a, b) < 1e-9
    free = np.arange(len(qdd)) % 3 > 0
    for few in (free, ~free):  # many joints satisfy the rows, a few come as close as they can
        assert gap(coded.nearest(qdd, few), reference.nearest(qdd, few)) < 1e-9
    other = random_forest(seed + 1).forest
    assert CompiledForestEngine(other).inverse(given) is None


def with_limits(name):
    """Return a branched problem whose closures have limits."""
    p = branched_problems()[name]
    limits = hf.WrenchLimits(force=50.0, moment=8.0)
    if name == "palletiser":  # a loop
        arm = p.chain.arms["robot"]
        pin = replace(arm.loops["level"], grasp=replace(arm.loops["level"].grasp, wrench_limits=limits))
        return replace(p.chain, arms={"robot": replace(arm, loops={"level": pin})}), p
    grasps = {key: replace(grasp, wrench_limits=limits) for key, grasp in p.chain.grasps.items()}
    return replace(p.chain, grasps=grasps), p


@pytest.mark.parametrize("name", ["palletiser", *mostly_slow(["grippers"], ())])
def test_margins(name):
    """Margins of several points are those of the reference's forces, the smallest where these are not unique."""
    chain, p = with_limits(name)
    forest, rows = chain.as_forest.forest, dict(enumerate(grasp_rows(chain)))
    q, qd = flat_state(chain, p.state)
    drives = mechanism_arguments(chain, p.state, p.tau)
    engine, reference = CompiledForestEngine(forest), ForestReference(forest)
    engine.instant(drives)
    places = [reference.closed(displaced(forest, q, s * qd), qd)[:2] for s in (0.0, 1e-3, 2e-3)]
    x = np.array([at for at, _ in places])
    for at, _ in forest.quaternions:
        x[:, at] *= 2.0  # of any length
    rates = np.array([position_rates(forest, at, rate) for at, (_, rate) in zip(x, places, strict=True)])
    found = engine.margins(x, rates, np.tile(drives.tau, (3, 1)), drives.wrenches)
    for ours, (at, rate) in zip(found, places, strict=True):
        given = drives._replace(q=at, qd=rate)
        forces = reference.account(given, reference.instant(given)).closure_wrench
        wrenches = contact_wrenches(chain, chain_state(chain, at, rate), forces, rows)
        assert gap(ours, [margin_of_row(rows[i], f) for i, f in wrenches.items()]) < 1e-9
    engine.rank -= 1
    assert engine.margins(x, rates, np.tile(drives.tau, (3, 1)), drives.wrenches) is None
