"""The largest margin of any torques: a parallel gripper on paper, another solver, and a motion that stays as it is."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize

from holdfast import ClosedChain, Inputs, State, forward_dynamics
from holdfast.dynamics import ForwardResult
from holdfast.dynamics.rank import constraint_rank
from holdfast.forces import grasp_margins, largest_margin, margin_range
from holdfast.model.grasp import WrenchLimits
from tests.dynamics.problems import motion_of
from tests.forces.test_margin_range import hinged, regrasped
from tests.simulation.gantries import BLOCK, Friction, squeezed
from tests.systems import planar_three_arms
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import stored

MU, G = 0.5, 10.0
CARRIED = BLOCK * G / 2  # N, along each contact's tangent


def gripper(
    internal_force: float, limits: WrenchLimits | None = None, effort: float = np.inf
) -> tuple[Problem, ForwardResult]:
    """Return two fingers that hold a block between ball contacts, and forward dynamics with an internal force."""
    chain, state = squeezed(("ball", "ball"), Friction(MU), gravity=G, effort_limit=effort)
    grasps = {name: replace(grasp, wrench_limits=limits) for name, grasp in chain.grasps.items()}
    chain = ClosedChain(chain.arms, chain.held_object, grasps, chain.gravity)
    lift = (BLOCK / 2 + 1.0) * G
    tau = np.array([internal_force, 0.0, lift, -internal_force, 0.0, lift])
    result = forward_dynamics(chain, state, tau)
    np.testing.assert_allclose(result.qdd, 0.0, atol=1e-12)
    return Problem(chain, state, tau, Inputs()), result


@pytest.mark.parametrize("internal_force", [0.0, 3.0, 70.0])
def test_parallel_gripper(internal_force):
    """`together` knows only the force at hand; the best of all is where friction and strength give way at once."""
    strength = 60.0
    p, result = gripper(internal_force, WrenchLimits(force=strength))
    at_hand = min(MU * internal_force - CARRIED, strength - np.hypot(internal_force, CARRIED))
    assert margin_range(p.chain, p.state, result).together == pytest.approx(at_hand, abs=1e-9)
    assert at_hand < 0.0
    best: Any = brentq(lambda n: MU * n - CARRIED - strength + np.hypot(n, CARRIED), 0.0, 100.0, xtol=1e-12)
    found = largest_margin(p.chain, p.state, result)
    assert found.margin == pytest.approx(MU * best - CARRIED, abs=1e-7)
    assert found.margin > 0.0
    assert found.tau[[0, 3]] == pytest.approx([best, -best], abs=1e-6)
    after = forward_dynamics(p.chain, p.state, found.tau)
    np.testing.assert_allclose(after.qdd, result.qdd, atol=1e-9)
    np.testing.assert_allclose(after.grasp_wrench, found.grasp_wrench, atol=1e-7)


@pytest.mark.parametrize("internal_force", [0.0, 50.0])
def test_gripper_with_drives_of_limited_force(internal_force):
    """Without another limit harder is always better, up to the drives' own; from beyond it as well as from within."""
    p, result = gripper(internal_force, effort=30.0)
    assert largest_margin(p.chain, p.state, result).margin == np.inf
    found = largest_margin(p.chain, p.state, result, effort_limits=True)
    assert found.margin == pytest.approx(MU * 30.0 - CARRIED, abs=1e-6)
    assert np.abs(found.tau).max() <= 30.0 * (1 + 1e-9)
    weak, result = gripper(internal_force, effort=19.0)  # lifting alone takes 20 N of each
    found = largest_margin(weak.chain, weak.state, result, effort_limits=True)
    assert found.margin == -np.inf
    np.testing.assert_allclose(found.tau, weak.tau, atol=1e-12)


def by_another_solver(p: Problem, f: np.ndarray) -> float:
    """Return the largest least margin by SLSQP over all lambda with A^T K^T lambda unchanged, from several starts."""
    motion = motion_of(p)
    K = [c.K for c in motion.contacts]
    to_C = np.hstack([np.vstack([k[:, :3].T + np.cross(c.offset, k[:, 3:]).T, k[:, 3:].T])
                      for k, c in zip(K, motion.contacts, strict=True)])  # fmt: skip
    _, sizes, Vt = np.linalg.svd(to_C)
    free = Vt[int((sizes > 1e-9).sum()) :].T
    ends = np.cumsum([len(k) for k in K])[:-1]

    def margins(z):
        parts = np.split(free @ z, ends)
        moved = f + np.array([k.T @ part for k, part in zip(K, parts, strict=True)])
        return grasp_margins(p.chain, p.state, moved)

    best, random = -np.inf, np.random.default_rng(0)
    for _ in range(3):
        start = random.normal(size=free.shape[1])
        found = minimize(
            lambda x: -x[-1],
            np.r_[start, margins(start).min()],
            jac=lambda x: np.r_[np.zeros(len(x) - 1), -1.0],
            constraints={"type": "ineq", "fun": lambda x: margins(x[:-1]) - x[-1]},
            options={"maxiter": 300, "ftol": 1e-10},
        )
        best = max(best, margins(found.x[:-1]).min())
    return best


@pytest.mark.parametrize("name", ["hinge_2arm", "softfinger_3arm"])
def test_against_another_solver(name):
    """Arms with force and moment limits: nothing better is found, and what is found comes near."""
    p = stored(name)
    p = regrasped(p, lambda i, g: replace(g, wrench_limits=WrenchLimits(20.0 + i, 100.0)))
    result = p.solved()
    found = largest_margin(p.chain, p.state, result, inputs=p.inputs)
    assert grasp_margins(p.chain, p.state, found.grasp_wrench).min() == pytest.approx(found.margin, abs=1e-6)
    other = by_another_solver(p, result.grasp_wrench)
    assert found.margin - 1e-2 * abs(found.margin) - 0.1 < other <= found.margin + 1e-6
    after = forward_dynamics(p.chain, p.state, found.tau, inputs=p.inputs)
    np.testing.assert_allclose(after.qdd, result.qdd, atol=1e-7 * max(1.0, np.abs(result.qdd).max()))
    np.testing.assert_allclose(after.object_acceleration, result.object_acceleration, rtol=1e-6, atol=1e-6)


def test_never_below_together():
    """Torques of choice can do whatever the torques at hand can."""
    plain = as_chain(planar_three_arms(0))
    limited = regrasped(plain, lambda i, g: replace(g, wrench_limits=WrenchLimits(8.0 + i, 60.0)))
    for p in (limited, hinged(1)):
        known = constraint_rank(p.chain, p.state)
        result = p.solved(generic_rank=known)
        found = largest_margin(p.chain, p.state, result, inputs=p.inputs)
        now = grasp_margins(p.chain, p.state, result.grasp_wrench).min()
        assert found.margin >= margin_range(p.chain, p.state, result).together - 1e-7 >= now - 2e-7


def test_nothing_to_give_way():
    """Two-sided grasps without limits, and nobody who holds."""
    p = stored("rigid_2arm_7R_gravity")
    result = p.solved()
    found = largest_margin(p.chain, p.state, result, inputs=p.inputs)
    assert found.margin == np.inf
    np.testing.assert_allclose(found.tau, p.tau, atol=1e-9 * np.abs(p.tau).max())
    nobody = replace(p.chain, grasps={})
    still = State(p.state.q, 0 * p.state.qd, p.state.object_pose)
    alone = forward_dynamics(nobody, still, p.tau)
    assert largest_margin(nobody, still, alone).margin == np.inf
