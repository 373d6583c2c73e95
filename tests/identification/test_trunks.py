"""Identification of what arms on a trunk hold, from states in any motion."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import inertial_parameters
from holdfast.identification import Prior, Recording, instants
from holdfast.identification.completed import OBJECT_MOTION, completed
from holdfast.identification.machine.unknowns import machine_unknowns
from holdfast.identification.rows import channels, equations_at, named_bodies, terms_of
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem
from tests.systems.trunk_problems import on_trunk

SAMPLES = 20


@cache
def recorded(floating: bool) -> tuple[Problem, Recording]:
    """Return a chain of a trunk and two arms, one in the world or both on a floating base, and states of it."""
    arms = random_problem(3, joints=(7, 7), grasps=("rigid", "rigid"), moving_base=False)
    p = on_trunk(arms, 3, 2, floating=floating, in_world=0.0 if floating else 0.5)
    chain, random = p.chain, np.random.default_rng(4)
    assert len(chain.mounts) == (2 if floating else 1)
    rows: dict[str, list] = {}
    for _ in range(SAMPLES):
        near = replace(p.state, q=p.state.q + 0.2 * random.normal(size=chain.joint_count))
        closed = hf.close(chain, near, inputs=p.inputs)
        fast = replace(closed, qd=random.normal(size=chain.joint_count), object_twist=random.normal(size=6))
        state, tau = hf.dynamics.project_velocity(chain, fast, inputs=p.inputs), 10 * random.normal(size=len(fast.q))
        found = hf.forward_dynamics(chain, state, tau, inputs=p.inputs)
        sample = {"q": state.q, "qd": state.qd, "qdd": found.qdd, "tau": tau, "object_pose": state.object_pose}
        sample |= {"object_twist": state.object_twist, "object_acceleration": found.object_acceleration}
        sample |= {"wrist_wrench": hf.forces.wrist_wrenches(chain, state, found)}
        if floating:
            sample |= {"base_pose": state.base_pose, "base_twist": state.base_twist}
            sample |= {"base_acceleration": found.base_acceleration}
        for name, x in sample.items():
            rows.setdefault(name, []).append(x)
    arrays = {name: np.array(column) for name, column in rows.items()}
    return p, Recording(np.arange(SAMPLES), **arrays, inputs=p.inputs)


@pytest.mark.slow
@pytest.mark.parametrize("by", ["wrist_wrench", "tau"])
@pytest.mark.parametrize("floating", [False, True])
def test_the_payload_comes_back(floating, by):
    p, recording = recorded(floating)
    body = p.chain.held_object
    guess = hf.HeldObject.box(0.8 * body.mass, 0.3, 0.25, 0.2)
    found = hf.identify(replace(p.chain, held_object=guess), recording, by=by)
    true = np.r_[body.mass, body.com, body.inertia[np.triu_indices(3)]]
    assert np.abs(found.values - true).max() < 1e-6
    assert found.undetermined == ()


@pytest.mark.slow
@pytest.mark.parametrize("floating", [False, True])
def test_the_motion_of_the_object_follows_from_the_tips(floating):
    p, recording = recorded(floating)
    lacking = replace(recording, object_pose=None, object_twist=None, object_acceleration=None)
    whole, given = (hf.identify(p.chain, one, by="tau").values for one in (lacking, recording))
    assert np.abs(whole - given).max() < 1e-6


@pytest.mark.slow
def test_gravity_and_grasp_frames_are_found():
    p, recording = recorded(True)
    tilted = replace(p.chain, gravity=p.chain.gravity @ hf.Pose.from_rpy(0.05, -0.03, 0.0).R)
    found = hf.identify(tilted, recording, by="tau", gravity=True)
    assert np.abs(found.chain.gravity - p.chain.gravity).max() < 1e-6
    off = hf.Pose.translation(0.01, 0.0, 0.0)
    moved = {name: replace(grasp, frame=grasp.frame @ off) for name, grasp in p.chain.grasps.items()}
    again = hf.identify(replace(p.chain, grasps=moved), recording, grasp_frames=True)
    for name, grasp in p.chain.grasps.items():
        assert np.abs(again.chain.grasps[name].frame.p - grasp.frame.p).max() < 1e-9


@pytest.mark.slow
def test_the_motion_of_a_floating_base_is_needed():
    p, recording = recorded(True)
    with pytest.raises(
        hf.errors.StateError, match="expected base_twist, base_acceleration, as the trunk's base floats"
    ):
        hf.identify(p.chain, replace(recording, base_twist=None, base_acceleration=None), by="tau")


@pytest.mark.slow
@pytest.mark.parametrize("floating", [False, True])
def test_machine_code_of_many_samples_gives_the_equations_of_a_few(floating, monkeypatch):
    """Trunks, mounted arms, constant inputs and floating bases; and the model explains what it did."""
    p, recording = recorded(floating)
    n = p.chain.joint_count
    assert recording.tau is not None
    unknowns = machine_unknowns(p.chain, "tau", ("payload", "links"), Prior(), recording.tau, np.ones(n), 1.0)
    few = equations_at(p.chain, recording, unknowns)
    monkeypatch.setattr(instants, "MANY", 1)
    many = equations_at(p.chain, recording, unknowns)
    A, b, _, P, ranks = many
    products = [np.concatenate([one[0], one[1][:, :, None], one[2], one[3]], axis=2) for one in (few, many)]
    first, second = (x.transpose(0, 2, 1) @ x for x in products)  # in which the bases of the motions do not enter
    assert np.allclose(first, second, rtol=0.0, atol=1e-10 * np.abs(first).max())
    assert (ranks == few[4]).all()
    right = np.concatenate([inertial_parameters(p.chain.held_object), *bodies(p.chain)])
    assert np.abs(A @ right + b - np.einsum("src,sc->sr", P, recording.tau)).max() < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("floating", [False, True])
def test_wrists_explain_what_the_object_did(floating, many, monkeypatch):
    """By few samples and by many, whose pieces machine code finds; the object's motion is that of the tips."""
    p, recording = recorded(floating)
    monkeypatch.setattr(instants, "MANY", 1 if many else SAMPLES + 1)
    unseen = replace(recording, object_pose=None, object_twist=None, object_acceleration=None)
    whole = completed(p.chain, unseen)
    for name in OBJECT_MOTION:
        found, true = getattr(whole, name), getattr(recording, name)
        assert np.abs(found - true).max() < 1e-8 * max(1.0, float(np.abs(true).max())), name
    assert recording.wrist_wrench is not None
    for by, rows in (("wrist_wrench", 6), ("wrist_force", 3)):
        of_wrists = replace(whole, wrist_force=recording.wrist_wrench[:, :, 3:])
        A, b, _, P, _ = equations_at(p.chain, of_wrists, terms_of(p.chain, by, ("payload", "sensor_drift")))
        assert A.shape[1:] == (rows, 10 + 2 * rows)
        y = channels(p.chain, of_wrists, by)
        left = A[:, :, :10] @ inertial_parameters(p.chain.held_object) + b - np.einsum("src,sc->sr", P, y)
        assert np.abs(left).max() < 1e-7
        assert np.abs(A[:, :, 10:] - P * recording.t[:, None, None]).max() == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("many", [False, True])
def test_a_pose_that_is_none_is_refused(many, monkeypatch):
    p, recording = recorded(False)
    monkeypatch.setattr(instants, "MANY", 1 if many else SAMPLES + 1)
    assert recording.object_pose is not None
    wrong = recording.object_pose.copy()
    wrong[3, :4] *= 1.2
    with pytest.raises(hf.errors.StateError, match=r"object_pose: expected unit quaternions .* got length 1.2;"):
        hf.identify(p.chain, replace(recording, object_pose=wrong), by="tau")


def bodies(chain: hf.ClosedChain) -> list[np.ndarray]:
    """Return the inertial parameters of trunk and links, in the order of the unknowns."""
    return [inertial_parameters(body) for _, body in named_bodies(chain)]
