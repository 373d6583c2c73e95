"""Runs of arms on a trunk: balances, order, one chain written in two ways, gripping in flight, resuming."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import closure
from tests.longer import mostly_long
from tests.systems.problems import largest_gaps
from tests.systems.trunk_runs import one_long_arm, still_base, swaying

RANDOM = [(1, 2, True), (2, 3, False), (3, 6, True), (4, 0, True)]


def held(tau):
    """Return a controller of constant torques."""
    return lambda t, state, memory: (tau, memory)


def run_of(p, duration=0.04, step=2e-3, **options):
    """Return the run of a problem under its torques and inputs."""
    run = hf.simulate(p.chain, p.state, held(p.tau), duration, step, inputs=p.inputs, **options)
    assert run.stopped is None
    return run


@pytest.mark.parametrize(
    ("seed", "joints", "floating"),
    mostly_long(RANDOM, ()),  # `laws/test_trunk_springs` has two runs
)
def test_balances(seed, joints, floating):
    """Energy and momentum are accounted for, grasps stay closed; what is left falls as the scheme's order says."""
    p = still_base(seed, joints, floating=floating)
    fine = run_of(p, scheme="dop853", rtol=1e-12, atol=1e-13)
    assert np.abs(fine.imbalance).max() < 1e-10 * fine.kinetic.max()
    assert fine.position_gap[:, 1].max() < 1e-13
    # the momentum's integral is taken over samples
    assert np.abs(fine.momentum_imbalance).max() < 1e-6 * np.abs(fine.momentum).max()
    steps = (4e-3, 2e-3)
    off = [np.abs(run_of(p, step=h, scheme="midpoint").q[-1] - fine.q[-1]).max() for h in steps]
    assert np.log2(off[0] / off[1]) == pytest.approx(2.0, abs=0.3)
    assert (fine.base_pose.shape[1], fine.trunk_base_wrench.shape[1]) == (7 if floating else 0, 6)
    if floating:
        assert not fine.trunk_base_wrench.any()


@pytest.mark.slow
@pytest.mark.parametrize("below", [1, 3])
def test_an_arms_first_joints_as_a_trunk(below):
    """A chain runs alike whether the first joints of an arm are its own or a trunk's, base motion included."""
    alone, on_trunk = one_long_arm(5, below)
    name = alone.chain.names[1]
    motion = swaying(alone.chain.arms[name].base)
    first = run_of(alone, base_motion={name: motion})
    second = run_of(on_trunk, base_motion={"trunk": motion})
    part = alone.chain.joints[name]
    order = np.r_[part.start : part.start + below, : part.start, part.start + below : alone.chain.joint_count]
    assert second.q == pytest.approx(first.q[:, order], abs=1e-11)
    assert second.grasp_wrench == pytest.approx(first.grasp_wrench, rel=1e-8, abs=1e-8)
    assert second.trunk_base_wrench == pytest.approx(first.base_wrench[:, 1], rel=1e-8, abs=1e-8)
    for name in ("kinetic", "potential", "work", "momentum", "momentum_rate"):
        assert getattr(second, name) == pytest.approx(getattr(first, name), rel=1e-9, abs=1e-8), name


@pytest.mark.long
def test_free_flight_keeps_momentum():
    """Without gravity and wrenches, torques of all kinds move no momentum; an arm that grips in flight neither."""
    arms = {"arms": 3, "grasps": "rigid", "joints": 7, "gravity": (0, 0, 0)}
    p = still_base(7, 2, floating=True, arms=arms, in_world=0.0)
    name = p.chain.names[-1]
    grasp = p.chain.grasps[name]
    p = replace(p, chain=p.chain.without_grasp(name), inputs=hf.Inputs())
    grips = hf.Attach(0.02, name, grasp, here=True)
    run = run_of(p, scheme="dop853", rtol=1e-13, atol=1e-14, events=[grips])
    size = np.abs(run.momentum).max()
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-12 * size
    assert np.abs(run.imbalance).max() < 1e-10 * run.kinetic.max()
    assert run.impact[-1] < -1e-3  # what the arm's speed against the object cost
    assert run.holding[-1].all() and not run.holding[0].all()
    (gripped,) = run.occurrences
    assert not np.any(gripped.trunk_base_impulse)


@pytest.mark.slow
def test_gripping_on_a_trunk_in_the_world():
    """The impulse at the trunk's base is in the balance of momentum."""
    p = still_base(9, 2, floating=False, arms={"arms": 2, "grasps": "rigid", "joints": 7})
    name = next(iter(p.chain.mounts))
    grasp = p.chain.grasps[name]
    p = replace(p, chain=p.chain.without_grasp(name))
    run = run_of(p, scheme="dop853", rtol=1e-11, step=5e-4, events=[hf.Attach(0.02, name, grasp, here=True)])
    assert np.linalg.norm(run.occurrences[0].trunk_base_impulse) > 0.01
    assert np.abs(run.momentum_imbalance).max() < 1e-6 * np.abs(run.momentum).max()
    assert np.abs(run.imbalance).max() < 1e-8 * run.kinetic.max()


@pytest.mark.slow
def test_states_between_samples():
    """Quintics in time for the floating base as well: exact at samples, off by less than h^5 between."""
    p = still_base(1, 2, floating=True)
    coarse, fine = run_of(p, step=4e-3), run_of(p, step=1e-3)
    off = []
    for t in (0.006, 0.014, 0.022):
        between, exact = coarse.state_at(t), fine.state_at(t)
        off.append(np.abs(between.base_pose - exact.base_pose).max())
        off.append(np.abs(between.base_twist - exact.base_twist).max() * 1e-2)
        assert largest_gaps(closure(p.chain, between))[0] < 1e-6
    assert max(off) < 1e-6


def test_refused_base_motions():
    """What stands on the trunk moves with it, and what floats moves by its state."""
    fixed, free = still_base(2, 3, floating=False), still_base(1, 2, floating=True)
    motion = swaying(hf.Pose.identity())
    mounted = next(iter(fixed.chain.mounts))
    with pytest.raises(hf.errors.ModelError, match="stands on the trunk and moves with it; try the motion of 'trunk'"):
        run_of(fixed, base_motion={mounted: motion})
    with pytest.raises(hf.errors.ModelError, match="expected none, as the base floats"):
        run_of(free, base_motion={"trunk": motion})
