"""What margins internal forces allow where grasp forces are not unique: planar chains, and their kernel by hand."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import ClosedChain, Friction, Grasp, Pose, StateError, forward_dynamics
from holdfast.dynamics import Status
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.rank import constraint_rank
from holdfast.forces.margin_interval import MarginRange, margin_range
from holdfast.forces.margins import grasp_margins
from holdfast.model.grasp import WrenchLimits
from tests.dynamics.problems import motion_of
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
