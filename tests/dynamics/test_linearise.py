"""Forward dynamics made linear: published eigenvalues, the tangent by another route, and motions nearby."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.benchmarks import four_bar
from scipy.linalg import expm
from scipy.optimize import root_scalar

import holdfast as hf
from holdfast.spatial import rotation
from tests.derivatives.moved import tangent
from tests.longer import mostly_long, mostly_slow
from tests.systems import random_system
from tests.systems.as_chain import as_chain
from tests.systems.four_bar import held_four_bar, held_state
from tests.systems.trunk_runs import still_base


@pytest.mark.parametrize(
    ("damping", "published"), mostly_slow([(0.0, four_bar.SPRING), (1.0, four_bar.DAMPER)], [(1.0, four_bar.DAMPER)])
)
def test_four_bar(damping, published):
    """IFToMM's linkage on its spring: a planar loop in space, whose forces are not unique; one freedom."""
    still = four_bar.four_bar()
    angle = root_scalar(lambda x: four_bar.acceleration(still, x, 0.0), bracket=(2.0, 2.5), xtol=1e-15).root
    model = hf.linearise(held_four_bar(damping), held_state(angle), np.zeros(2))
    assert model.A.shape == (2, 2)
    assert np.abs(model.rate).max() < 1e-12
    assert np.abs(np.linalg.eigvals(model.A) - published).min() < 1e-8


def test_tangent():
    """The same space as the null space of the constraint's rows, differentiated by dual numbers."""
    p = as_chain(random_system(1, arms=2, joints=7, grasps="rigid", moving_base=True))
    T, expected = hf.linearise(p.chain, p.state, p.tau, inputs=p.inputs).basis, tangent(p)
    assert T.shape == expected.shape == (40, 16)
    assert np.abs(expected - T @ np.linalg.lstsq(T, expected, rcond=None)[0]).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "hinge"), ("ball", "rigid"), ("softfinger", "hinge")])
def test_motions_nearby(kinds):
    """From rest, two runs that begin apart by T z stay apart by T exp(A t) z, but for the square of z."""
    p = as_chain(random_system(5, arms=2, joints=[7, 6], grasps=list(kinds), moving_base=False, joint_speed=0.0))
    chain, n = p.chain, p.chain.joint_count
    still = hf.State(p.state.q, np.zeros(n), p.state.object_pose)
    torques = hf.holding_torques(chain, still)
    model = hf.linearise(chain, still, torques)
    assert np.abs(model.rate).max() < 1e-9
    z = np.random.default_rng(0).normal(size=len(model.A))
    t, found = 0.05, []
    for size in (1e-3, 5e-4):
        off = model.basis @ z * size
        turned = hf.Pose.from_rpy(*off[n : n + 3]).R @ still.object_frame.R
        pose = hf.Pose(turned, still.object_frame.p + off[n + 3 : n + 6])
        begin = hf.project(chain, hf.State(still.q + off[:n], off[n + 6 : 2 * n + 6], pose, off[2 * n + 6 :]))[0]
        run = hf.simulate(chain, begin, lambda t, state, memory: (torques, memory), t, 0.01)
        found.append(model.coordinates(run.state(-1)) - expm(model.A * t) @ model.coordinates(begin))
    first, second = (float(np.linalg.norm(x)) for x in found)
    assert second < 0.3 * first
    assert second < 1e-3 * 5e-4 * np.linalg.norm(z) * 100


@pytest.mark.slow
def test_a_basis_that_does_not_jump():
    """Turned towards a neighbour's, the basis is as near to it as the states are."""
    p = as_chain(random_system(1, arms=2, joints=7, grasps="rigid", moving_base=False))
    first = hf.linearise(p.chain, p.state, p.tau, inputs=p.inputs)
    moved = hf.State(p.state.q + 1e-4 * first.basis[:14, 0], p.state.qd, p.state.object_pose, p.state.object_twist)
    near = hf.project(p.chain, moved)[0]
    second = hf.linearise(p.chain, near, p.tau, inputs=p.inputs, basis=first.basis)
    assert np.abs(second.basis - first.basis).max() < 1e-2
    alone = hf.linearise(p.chain, near, p.tau, inputs=p.inputs)
    assert np.allclose(np.sort_complex(np.linalg.eigvals(second.A)), np.sort_complex(np.linalg.eigvals(alone.A)))
    with pytest.raises(hf.errors.StateError, match="basis: expected shape"):
        hf.linearise(p.chain, near, p.tau, inputs=p.inputs, basis=first.basis[:, :3])


@pytest.mark.slow
@pytest.mark.parametrize("floating", mostly_long((False, True), (False,)))
def test_motions_on_a_trunk(floating):
    """In motion, two runs that begin apart by T z stay apart by what A makes of it, but for the square of z."""
    gravity = (0.0, 0.0, 0.0 if floating else -9.81)
    p = still_base(2, 2, floating=floating, arms={"joints": (7, 6), "grasps": ("rigid", "hinge"), "gravity": gravity})
    chain, n, state = p.chain, p.chain.joint_count, hf.project(p.chain, p.state, p.inputs)[0]
    model = hf.linearise(chain, state, p.tau, inputs=p.inputs)
    half = n + 6 + 6 * floating
    assert model.basis.shape == (2 * half, len(model.A))
    z, found = np.random.default_rng(0).normal(size=len(model.A)), []
    for size in (1e-3, 1e-4):
        t = size
        begin = hf.project(chain, displaced(state, model.basis @ z * size), p.inputs)[0]
        ends = [
            hf.simulate(chain, at, lambda t, state, memory: (p.tau, memory), t, t, inputs=p.inputs).state(-1)
            for at in (begin, state)
        ]
        apart = replace(model, state=ends[1]).coordinates(ends[0])
        first = model.coordinates(begin)
        assert np.abs(first - z * size).max() < 1e-2 * np.abs(z).max() * size
        grown = t * model.A @ first
        found.append(np.abs(apart - first - grown).max() / np.abs(grown).max())
    assert found[1] < 5e-4 and found[1] < 0.2 * found[0]


def displaced(state: hf.State, by: np.ndarray) -> hf.State:
    """Return a state moved by (dq, turn, shift, .., dqd, ..)."""
    n = len(state.q)
    moved, rates = by[: len(by) // 2], by[len(by) // 2 :]
    poses, twists = [], []
    for k, (frame, twist) in enumerate(
        ((state.object_frame, state.object_twist), (state.base_frame, state.base_twist))
    ):
        if frame is None:
            break
        at = slice(n + 6 * k, n + 6 * k + 6)
        turn, shift = np.split(moved[at], 2)
        poses.append(hf.Pose(rotation.exp(turn) @ frame.R, frame.p + shift))
        twists.append(twist + rates[at])
    base = dict(zip(("base_pose", "base_twist"), (poses[1], twists[1]), strict=True)) if len(poses) > 1 else {}
    return hf.State(state.q + moved[:n], state.qd + rates[:n], poses[0], twists[0], **base)
