"""Objects of chains with branches follow paths: the commanded accelerations, errors that decay, refusals by name."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import ObjectTracking, RestToRest
from holdfast.errors import MethodNotApplicable, ModelError
from tests.dynamics.tree.as_branched import gap
from tests.systems.branched import Branched, palletiser, pot_and_lid, two_arms_with_grippers


def paths(p) -> dict[str, RestToRest]:
    """Return a path for every object, that begins a little beside it."""
    found = {}
    for k, (name, pose) in enumerate(zip(p.chain.free_objects, p.state.object_pose.reshape(-1, 7), strict=True)):
        start = hf.Pose.translation(1e-3, -2e-3, 1e-3 * k) @ hf.Pose.from_wxyz_xyz(pose)
        found[name] = RestToRest(start, [0.01, -0.02, 0.01], turn=[0.02, 0.0, 0.01], duration=0.3)
    return found


def lid_apart() -> Branched:
    """Return a pot and a lid that do not touch, each in one hand."""
    p = pot_and_lid()
    whole = p.chain
    chain = hf.ClosedChain(whole.arms, whole.held_object, dict(whole.grasps), objects=dict(whole.objects))
    return Branched(chain, p.state, p.tau)


@pytest.mark.parametrize("make", [two_arms_with_grippers, pytest.param(lid_apart, marks=pytest.mark.slow)])
def test_accelerations_are_those_commanded(make):
    """Forward dynamics gives back the commanded accelerations, and coupled joints stay together."""
    p = make()
    found = paths(p)
    law = ObjectTracking(p.chain, found if len(found) > 1 else next(iter(found.values())), internal_force=5.0)
    tau, memory = law(0.1, p.state, "kept")
    assert memory == "kept"
    result = hf.forward_dynamics(p.chain, p.state, tau)
    assert gap(result.object_acceleration, law.commanded_acceleration(0.1, p.state)) < 1e-9


@pytest.mark.slow
def test_errors_decay():
    """The error of the pose decays as critically damped, in a run by machine code, as it does in one without."""
    p = two_arms_with_grippers()
    start = hf.State(p.state.q, 0.0 * p.state.qd, p.state.object_pose)
    path = next(iter(paths(p).values()))
    law = ObjectTracking(p.chain, path, stiffness=400.0, damping=40.0)
    long = hf.simulate(p.chain, start, law, 0.2, 1e-3)
    short = hf.simulate(p.chain, start, law, 0.01, 1e-3)
    assert gap(long.tau[:11], short.tau) < 1e-9 and gap(long.object_pose[:11], short.object_pose) < 1e-11
    error = np.array([path.at(t).pose.p - pose[4:] for t, pose in zip(long.t, long.object_pose, strict=True)])
    for t, e in zip(long.t, error, strict=True):
        wanted = error[0] * (1.0 + 20.0 * t) * np.exp(-20.0 * t)
        assert np.abs(e - wanted).max() < 1e-8
    assert np.abs(long.imbalance).max() < 1e-6


def test_refusals():
    """What the law does not do for such chains, and paths that do not fit, are named."""
    p, lone = two_arms_with_grippers(), palletiser()
    (name, path), *_ = paths(p).items()
    alike = (ObjectTracking(p.chain, one)(0.0, p.state, None)[0] for one in ({name: path}, path))
    assert np.array_equal(*alike)
    with pytest.raises(ModelError, match=f"expected a path for each of the objects {name}, by name, got lid"):
        ObjectTracking(p.chain, {"lid": path})
    with pytest.raises(ModelError, match="expected a chain with an object, got one path"):
        ObjectTracking(lone.chain, path)
    with pytest.raises(ModelError, match="expected a path for each of the objects object, lid, by name, got one path"):
        ObjectTracking(pot_and_lid().chain, path)
    with pytest.raises(MethodNotApplicable, match="limits: expected its default"):
        ObjectTracking(p.chain, path, limits=hf.forces.ForceLimits())
