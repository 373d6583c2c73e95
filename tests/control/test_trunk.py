"""Controllers and force questions of arms on a trunk: held, tracked, and as the same chain written in another way."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import GravityCompensation, ObjectTracking, RestToRest
from holdfast.dynamics import project_velocity, state_from_joints
from holdfast.forces import largest_margin, last_joint_wrenches
from tests.systems.trunk_runs import one_long_arm, still_base

RIGID = {"arms": 3, "grasps": "rigid", "joints": 7}


def with_limits(chain):
    """Return the chain whose rigid grasps bear so much and no more."""
    limits = hf.WrenchLimits(force=400.0, moment=60.0)
    return replace(chain, grasps={name: replace(x, wrench_limits=limits) for name, x in chain.grasps.items()})


def at_rest(seed, floating, **options):
    """Return a random chain on a trunk, at rest."""
    p = still_base(seed, 2, floating=floating, arms=RIGID | options)
    return replace(p, state=p.state.at_rest(), inputs=hf.Inputs())


@pytest.mark.parametrize(("seed", "floating"), [(0, False), (1, False), (3, True)])
def test_held(seed, floating):
    """Under holding torques nothing accelerates; the trunk's drives bear, or arms in the world if its base floats."""
    p = at_rest(seed, floating)
    if floating:  # two arms in the world bear the base
        assert len(p.chain.mounts) < len(p.chain.arms)
    tau = hf.holding_torques(p.chain, p.state, internal_force=20.0)
    found = hf.forward_dynamics(p.chain, p.state, tau)
    assert max(np.abs(found.qdd).max(), np.abs(found.object_acceleration).max()) < 1e-9
    if floating:
        assert np.abs(found.base_acceleration).max() < 1e-9
    else:
        assert np.abs(tau[:2]).max() > 1.0
        assert GravityCompensation(p.chain, 20.0)(0.0, p.state, None)[0] == pytest.approx(tau, abs=1e-9)


def test_a_floating_base_falls():
    """With all arms on it nothing holds it up."""
    p = still_base(3, 2, floating=True, arms=RIGID, in_world=0.0)
    with pytest.raises(hf.errors.StateError, match="with the floating base at rest"):
        hf.holding_torques(p.chain, p.state.at_rest())
    with pytest.raises(hf.errors.MethodNotApplicable, match="no actuator holds"):
        GravityCompensation(p.chain)


def test_passive_trunk_joints():
    """A trunk's joint may be left without a drive, if arms in the world can bear it."""
    p = at_rest(3, False)
    name = p.chain.joint_names()[1]
    assert name.startswith("trunk/")
    tau = hf.holding_torques(p.chain, p.state, passive=[name])
    assert tau[1] == 0.0
    assert np.abs(hf.forward_dynamics(p.chain, p.state, tau).qdd).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("floating", [False, True])
def test_tracking(floating):
    """The object follows a path exactly, while the trunk's joints are slowed down and a floating base gives way."""
    gravity = {"gravity": (0.0, 0.0, 0.0)} if floating else {}
    p = at_rest(5, floating, **gravity)
    frame = p.state.object_frame
    path = RestToRest(frame, [0.0025, 0.005, 0.0], [0.0, 0.0, 0.0125], duration=0.1).at
    law = ObjectTracking(p.chain, path, internal_force=5.0)
    run = hf.simulate(p.chain, p.state, law, 0.1, 4e-3)
    assert run.stopped is None
    goal = np.array([path(t).pose.p for t in run.t])
    assert np.abs(run.object_pose[:, 4:] - goal).max() < 1e-7
    if floating:
        assert np.abs(run.base_pose[-1] - run.base_pose[0]).max() > 1e-4
    else:
        assert np.abs(run.q[-1, :2] - run.q[0, :2]).max() < 1e-9


@pytest.mark.parametrize("below", [1, 3])
def test_one_chain_in_two_ways(below):
    """Wrenches of the last joints, margins and the object's state are those of the chain whose arm is not divided."""
    alone, on_trunk = one_long_arm(5, below)
    both = []
    for p in (alone, on_trunk):
        rigid = {name: hf.Grasp("rigid", grasp.frame) for name, grasp in p.chain.grasps.items()}
        chain = with_limits(replace(p.chain, grasps=rigid))
        state = hf.close(chain, p.state)
        state = project_velocity(chain, state_from_joints(chain, state.q, state.qd))
        found = hf.forward_dynamics(chain, state, p.tau)
        best = largest_margin(chain, state, found)
        again = hf.forward_dynamics(chain, state, best.tau)
        assert again.qdd == pytest.approx(found.qdd, abs=1e-6 * np.abs(found.qdd).max())
        assert again.grasp_wrench == pytest.approx(best.grasp_wrench, abs=1e-6 * np.abs(best.grasp_wrench).max())
        both.append((state.object_pose, state.object_twist, last_joint_wrenches(chain, state, found), best.margin))
    for one, other in zip(*both, strict=True):
        assert other == pytest.approx(one, rel=1e-7, abs=1e-7 * np.abs(one).max())


def test_margins_without_a_drive_at_the_base():
    """The torques of the largest margin change no acceleration of a chain whose base floats."""
    p = at_rest(3, True)
    chain = with_limits(p.chain)
    found = hf.forward_dynamics(chain, p.state, p.tau)
    best = largest_margin(chain, p.state, found)
    again = hf.forward_dynamics(chain, p.state, best.tau)
    assert again.base_acceleration == pytest.approx(found.base_acceleration, abs=1e-7 * np.abs(found.qdd).max())
    assert again.grasp_wrench == pytest.approx(best.grasp_wrench, abs=1e-6 * np.abs(best.grasp_wrench).max())
