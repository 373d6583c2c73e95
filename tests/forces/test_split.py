"""Grasp forces in two parts: what moves the object, and what only squeezes it."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import ClosedChain, Grasp, HeldObject, Pose, State
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.errors import StateError
from holdfast.forces import split
from tests.dynamics.problems import motion_of
from tests.model.parts import arm
from tests.systems.problems import random_problem, relative_gap

OPTIONS = {
    "rigid": {"grasps": "rigid", "joints": (7, 6, 8)},
    "mixed": {"grasps": ("rigid", "hinge", "softfinger", "ball"), "joints": (7, 6, 7, 6)},
    "balls": {"grasps": "ball", "joints": (7, 6, 7)},
}
systems = pytest.mark.parametrize(("kind", "seed"), [(kind, seed) for kind in OPTIONS for seed in range(4)])


def solved(kind: str, seed: int):
    """Return problem, stacked matrices and grasp wrenches of a random chain."""
    p = random_problem(seed, **OPTIONS[kind])
    return p, Stacked(motion_of(p)), p.solved().grasp_wrench


@systems
def test_two_parts(kind, seed):
    """motion + internal = f, A^T f_internal = 0, H f = 0; the motion part is the smallest, linear and idempotent."""
    p, s, f = solved(kind, seed)
    parts, size = split(p.chain, p.state, f), np.abs(f).max()
    np.testing.assert_allclose(parts.motion + parts.internal, f, atol=1e-14 * size)
    assert np.abs(s.A.T @ parts.internal.ravel()).max() < 1e-12 * size
    for part in (parts.motion, parts.internal):
        assert np.abs(s.HT.T @ part.ravel()).max(initial=0.0) < 1e-13 * size
    # orthogonal to all transmissible wrenches of no resultant
    metric = np.tile(np.r_[np.full(3, parts.length**-2), np.ones(3)], len(f))
    _, sizes, Vt = np.linalg.svd(s.A.T @ s.K.T)
    loads = Vt[int((sizes > 1e-10 * sizes[0]).sum()) :]
    assert len(loads)
    assert np.abs(loads @ s.K @ (metric * parts.motion.ravel())).max() < 1e-11 * size * metric.max()
    np.testing.assert_allclose(split(p.chain, p.state, parts.motion).motion, parts.motion, atol=1e-12 * size)
    np.testing.assert_allclose(split(p.chain, p.state, parts.internal).motion, 0, atol=1e-12 * size)
    assert relative_gap(split(p.chain, p.state, -3 * f).motion, -3 * parts.motion) < 1e-12
    net = f[:, 3:].sum(axis=0)
    assert parts.load_share.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(parts.load_share, parts.motion[:, 3:] @ net / (net @ net), atol=1e-11)


def test_no_net_force_no_share():
    """Two hands that only squeeze carry nothing: no share, all internal."""
    p, _, f = solved("rigid", 1)
    internal_force = split(p.chain, p.state, f).internal
    parts = split(p.chain, p.state, internal_force)
    assert parts.load_share is None
    np.testing.assert_allclose(parts.internal, internal_force, atol=1e-12 * np.abs(internal_force).max())
    assert split(p.chain, p.state, 0 * f).load_share is None


def test_symmetric_hands_share_equally():
    """Two balls left and right of the mass centre carry half the weight each; pushing in is internal."""
    grasps = {"left": Grasp("ball", Pose.translation(-0.2, 0, 0)), "right": Grasp("ball", Pose.translation(0.2, 0, 0))}
    chain = ClosedChain({"left": arm(), "right": arm()}, HeldObject.box(2.0, 0.4, 0.1, 0.1), grasps)
    state = State(np.zeros(4), np.zeros(4), Pose.identity())
    up, inward = np.r_[np.zeros(5), 9.81], np.r_[np.zeros(3), 50.0, 0, 0]
    lopsided = split(chain, state, np.array([2 * up + inward, -inward]))
    np.testing.assert_allclose(lopsided.load_share, [1.0, 0.0], atol=1e-12)  # the torque about y decides
    even = split(chain, state, np.array([up + inward, up - inward]))
    np.testing.assert_allclose(even.motion, [up, up], atol=1e-12)
    np.testing.assert_allclose(even.internal, [inward, -inward], atol=1e-12)
    np.testing.assert_allclose(even.load_share, [0.5, 0.5], atol=1e-12)
    assert even.length == pytest.approx(0.2)


def test_length():
    """L weighs moments against forces; by default the contacts' rms distance, 1 m for a single one."""
    p, _, f = solved("rigid", 2)
    points = np.array([c.offset for c in motion_of(p).contacts])
    spread = np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert split(p.chain, p.state, f).length == pytest.approx(spread, rel=1e-14)
    short, long = (split(p.chain, p.state, f, length) for length in (0.01, 100.0))
    assert np.abs(long.motion[:, :3]).max() > np.abs(short.motion[:, :3]).max()
    single = p.chain.without_grasp("arm1").without_grasp("arm2")
    assert split(single, p.state, f).length == 1.0


def test_arms_without_a_grasp():
    """An arm that holds nothing has neither part, and nobody holding is no error."""
    p, _, f = solved("rigid", 3)
    opened = p.chain.without_grasp("arm2")
    parts = split(opened, p.state, f * np.array([[1.0], [0.0], [1.0]]))
    assert not parts.motion[1].any()
    assert not parts.internal[1].any()
    nobody = split(replace(p.chain, grasps={}), p.state, 0 * f)
    assert nobody.load_share is None
    assert not nobody.motion.any()


def test_refusals():
    """Wrong shapes and lengths are refused by name."""
    p, _, f = solved("rigid", 0)
    with pytest.raises(StateError, match=r"grasp_wrench: expected shape \(3, 6\)"):
        split(p.chain, p.state, f[:2])
    with pytest.raises(ValueError, match="length: expected > 0"):
        split(p.chain, p.state, f, 0.0)
