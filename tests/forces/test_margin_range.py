"""Margins that internal forces allow: planar chains by hand, a gripper on paper, another solver, the same motion."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize

from holdfast import ClosedChain, Friction, Grasp, Inputs, Pose, State, forward_dynamics
from holdfast.dynamics import ForwardResult, Status
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.rank import constraint_rank
from holdfast.errors import StateError
from holdfast.forces.margin_interval import MarginRange, largest_margin, margin_range
from holdfast.forces.margins import grasp_margins
from holdfast.model.grasp import WrenchLimits
from tests.dynamics.problems import motion_of
from tests.longer import mostly_slow
from tests.simulation.gantries import BLOCK, squeezed
from tests.systems import planar_three_arms
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import stored

TOUCHED = [-np.inf] * 3


def regrasped(p: Problem, make) -> Problem:
    """Return the problem with other grasps at the same places: make(index, grasp) -> Grasp."""
    grasps = {name: make(i, g) for i, (name, g) in enumerate(p.chain.grasps.items())}
    return replace(p, chain=ClosedChain(p.chain.arms, p.chain.held_object, grasps, p.chain.gravity))


def ranged(p: Problem) -> tuple[np.ndarray, MarginRange]:
    """Return grasp wrenches and their margins' range."""
    known = constraint_rank(p.chain, p.state)  # low everywhere: no neighbour need be asked
    result = p.solved(generic_rank=known)
    assert result.status is Status.INDETERMINATE_FORCES
    return result.grasp_wrench, margin_range(p.chain, p.state, result)


def searched(p: Problem, f: np.ndarray, count: int, aim) -> float:
    """Return the largest aim(margins) met by random steps of falling length in the kernel of joints and object."""
    s = Stacked(motion_of(p))
    _, sizes, Vt = np.linalg.svd(np.hstack([s.J, s.A]).T @ s.K.T)
    kernel = Vt[int((sizes > 1e-9 * sizes[0]).sum()) :] @ s.K
    assert len(kernel) == count
    rng, best, reach = np.random.default_rng(0), -np.inf, 30.0
    while reach > 1e-5:
        tried = [f, *(f + (reach * rng.normal(size=count) @ kernel).reshape(f.shape) for _ in range(60))]
        values = [aim(grasp_margins(p.chain, p.state, wrench)) for wrench in tried]
        reach *= 1.5 if max(values) > best + 1e-3 * reach else 0.6
        best, f = max(best, *values), tried[int(np.argmax(values))]
    return best


def assert_best(p: Problem, f: np.ndarray, found: MarginRange) -> None:
    """Assert that a search finds nothing better, arm by arm and together, and comes near."""
    for i in range(3):
        best = searched(p, f, 6, lambda margins, i=i: margins[i])
        assert found.best[i] - 0.02 < best <= found.best[i] + 1e-8
    best = searched(p, f, 6, min)
    assert found.together - 0.02 < best <= found.together + 1e-8


def test_limits_on_planar_arms():
    """Three arms welded to a plate: forces out of the plane are anybody's guess, by six numbers."""
    limits = [WrenchLimits(8.0, 60.0), WrenchLimits(force=50.0), WrenchLimits(moment=5.0)]
    p = regrasped(as_chain(planar_three_arms(1, tilted=True)), lambda i, g: replace(g, wrench_limits=limits[i]))
    f, found = ranged(p)
    np.testing.assert_array_equal(found.worst, TOUCHED)
    now = grasp_margins(p.chain, p.state, f)
    assert (found.best > now + 1e-3).all()
    assert_best(p, f, found)
    assert found.together <= found.best.min() + 1e-8


def edges(i: int, grasp: Grasp) -> Grasp:
    """Return an edge that stands on the plate, its axis along the plane's normal, pressed in the plane."""
    inward = -np.array([*grasp.frame.p[:2], 0.0]) / np.linalg.norm(grasp.frame.p[:2])
    up = np.array([0.0, 0.0, 1.0])
    frame = Pose(np.column_stack([up, np.cross(inward, up), inward]), grasp.frame.p)
    return Grasp("hinge", frame, Friction(0.8, half_length=0.05))


def hinged(seed: int) -> Problem:
    """Return three planar arms that hold the plate by its edges, tip axes turned to fit."""
    p = as_chain(planar_three_arms(seed))
    arms = {}
    for i, (name, arm) in enumerate(p.chain.arms.items()):
        grasp = p.chain.grasps[name]
        arms[name] = arm.with_tip(arm.tip @ Pose(grasp.frame.R.T @ edges(i, grasp).frame.R, np.zeros(3)))
    return regrasped(replace(p, chain=replace(p.chain, arms=arms)), edges)


@pytest.mark.slow
def test_edges_of_planar_arms():
    """In the plane the forces are given; best is what slides or tips least for want of the rest."""
    p = hinged(2)
    f, found = ranged(p)
    np.testing.assert_array_equal(found.worst, TOUCHED)
    assert_best(p, f, found)


def pressed(signs) -> Problem:
    """Return four planar arms that press on the plate from above (1) and below (-1), as ball contacts."""
    flip = np.diag([1.0, -1.0, -1.0])

    def ball(i, grasp):
        return Grasp("ball", Pose(flip if signs[i] > 0 else np.eye(3), grasp.frame.p), Friction(0.5))

    return regrasped(as_chain(planar_three_arms(4, joints=(6, 6, 6, 6))), ball)


def test_squeezing_for_ever():
    """Ball contacts on both faces: some internal force presses them all, and harder is always better."""
    p = pressed((1, 1, 1, 1))
    s = Stacked(motion_of(p))
    _, _, Vt = np.linalg.svd(np.hstack([s.J, s.A]).T @ s.K.T)
    internal = (Vt[-1] @ s.K).reshape(4, 6)[:, 5]
    assert np.abs(internal).min() > 1e-3
    _, found = ranged(pressed(-internal))
    np.testing.assert_array_equal(found.worst, [-np.inf] * 4)
    np.testing.assert_array_equal(found.best, [np.inf] * 4)
    assert found.together == np.inf

    wrong = pressed(np.abs(internal))  # all from above: what presses one lifts another
    f, found = ranged(wrong)
    np.testing.assert_array_equal(found.best, [np.inf] * 4)
    assert found.together == pytest.approx(searched(wrong, f, 1, min), abs=1e-3)


def test_untouched():
    """Two-sided grasps without limits cannot fail; a limit that internal forces do not reach keeps its value."""
    p = as_chain(planar_three_arms(1))
    _, found = ranged(p)
    np.testing.assert_array_equal(found.worst, [np.inf] * 3)
    np.testing.assert_array_equal(found.best, [np.inf] * 3)
    assert found.together == np.inf
    one = regrasped(p, lambda i, g: replace(g, wrench_limits=WrenchLimits(force=90.0) if i == 1 else None))
    _, found = ranged(one)
    np.testing.assert_array_equal(found.worst, [np.inf, -np.inf, np.inf])
    assert found.together == pytest.approx(found.best[1], rel=1e-9)


def test_unique_forces():
    """Where the forces are unique the range is a point."""
    p = stored("rigid_2arm_7R_gravity")
    limited = regrasped(p, lambda i, g: replace(g, wrench_limits=WrenchLimits(20.0, 100.0)))
    result = limited.solved()
    found = margin_range(limited.chain, limited.state, result)
    now = grasp_margins(limited.chain, limited.state, result.grasp_wrench)
    np.testing.assert_array_equal([found.worst, found.best], [now, now])
    assert found.together == now.min()
    nobody = replace(limited.chain, grasps={})
    alone = forward_dynamics(nobody, limited.state, limited.tau)
    assert margin_range(nobody, limited.state, alone).together == np.inf


def test_refused():
    """A result of another chain, or one that holds no numbers."""
    p = as_chain(planar_three_arms(1))
    result = p.solved(generic_rank=12)
    fewer = {name: p.chain.arms[name] for name in p.chain.names[:2]}
    chain = replace(p.chain, arms=fewer, grasps={})
    joints = chain.joint_count
    state = replace(p.state, q=p.state.q[:joints], qd=p.state.qd[:joints])
    with pytest.raises(StateError, match="expected one system of 2 arms with 13 joints, got"):
        margin_range(chain, state, result)
    with pytest.raises(StateError, match="grasp_wrench: expected finite numbers"):
        margin_range(p.chain, p.state, replace(result, grasp_wrench=np.nan * result.grasp_wrench))


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


@pytest.mark.parametrize("name", mostly_slow(["hinge_2arm", "softfinger_3arm"], ["softfinger_3arm"]))
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
