"""What a configuration can and cannot do, in numbers without units and in words."""

import numpy as np
import pytest

from holdfast import State, diagnose
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.stacked import Stacked
from tests.dynamics.problems import CASES, motion_of, random_problem, stored
from tests.dynamics.rescaled import rescaled
from tests.systems import (
    one_straight_arm_of_three,
    planar_parallelogram,
    planar_three_arms,
    two_collinear_stretched_6r,
)
from tests.systems.as_chain import Problem, as_chain


def parallel(a, b) -> bool:
    """Return whether two unit vectors agree up to their sign."""
    return abs(abs(a @ b) - 1) < 1e-9


def assert_felt_by_no_drive(p: Problem, found) -> None:
    """Assert that a lost direction, read as a wrench, loads no joint of its arm."""
    arm = motion_of(p).arms[found.arm]
    lever = found.point - arm.at.tip.p
    line = np.r_[np.cross(lever, found.axis), found.axis]
    wrench = {"translation": line, "rotation": np.r_[found.axis, 0, 0, 0]}[found.kind]
    assert np.abs(jacobian(arm.arm, arm.at).T @ wrench).max() < 1e-9


def assert_indeterminate_forces(p: Problem, found) -> None:
    """Assert that every listed pattern is felt by no joint and by no object, and is all of them."""
    s = Stacked(motion_of(p))
    patterns = np.array([force.wrenches.ravel() for force in found.indeterminate_forces])
    assert len(patterns) == found.rows - found.rank == np.linalg.matrix_rank(patterns)
    for force, f in zip(found.indeterminate_forces, patterns, strict=True):
        assert np.abs(s.J.T @ f).max() < 1e-9
        assert np.abs(s.A.T @ f).max() < 1e-9
        assert "felt by no joint" in force.words


@pytest.mark.parametrize("seed", range(4))
def test_regular(seed):
    """A sound chain: full rank, nothing lost, nothing indeterminate, mobility by counting."""
    p = random_problem(seed, grasps=("rigid", "hinge", "softfinger", "ball"), joints=(7, 6, 7, 7))
    found = diagnose(p.chain, p.state)
    assert (found.status, found.rank, found.generic_rank, found.rows) == ("regular", 24, 24, 24)
    assert found.mobility == 27 + 6 + 6 - 24
    assert found.lost_directions == found.indeterminate_forces == ()
    assert found.report() == f"regular: rank 24 of 24 (nearby 24), mobility 15, condition {found.condition:.3g}"


@pytest.mark.parametrize("name", CASES)
def test_stored_cases(name):
    """Mobility, rank and condition as stored with the 42 cases."""
    p, tags = stored(name), CASES[name]["tags"]
    found = diagnose(p.chain, p.state)
    assert (found.mobility, found.rank) == (tags["mobility"], tags["constraint_rank"])
    assert found.status == ("regular" if tags["f_unique"] else "indeterminate")
    assert 1 <= found.condition < 1e6


def test_flat_parallelogram():
    """Flat, both cranks lose their common line and the chain one more row: singular, in words."""
    p = as_chain(planar_parallelogram(0.0))
    found = diagnose(p.chain, p.state)
    assert (found.status, found.rank, found.generic_rank, found.mobility) == ("singular", 8, 9, 2)
    assert_indeterminate_forces(p, found)
    for name in ("arm1", "arm2"):
        lost = [direction for direction in found.lost_directions if direction.arm == name]
        assert sorted(direction.kind for direction in lost) == ["rotation"] * 2 + ["translation"] * 2
        axes = [direction.axis for direction in lost if direction.kind == "translation"]
        assert any(parallel(axis, np.eye(3)[0]) for axis in axes)
        assert any(parallel(axis, np.eye(3)[2]) for axis in axes)
        assert all(abs(direction.axis[2]) < 1e-9 for direction in lost if direction.kind == "rotation")
        for direction in lost:
            assert_felt_by_no_drive(p, direction)
    report = found.report()
    assert report.startswith("singular: rank 8 of 12 (nearby 9), mobility 2")
    assert "forward dynamics refuses" in report
    assert report.count("lost: arm 'arm1' cannot") == 4


def test_bent_parallelogram():
    """Bent, each crank only loses the line through its own two joints: rank 9 as everywhere."""
    p = as_chain(planar_parallelogram(0.5))
    found = diagnose(p.chain, p.state)
    assert (found.status, found.rank, found.generic_rank, found.mobility) == ("indeterminate", 9, 9, 1)
    assert_indeterminate_forces(p, found)
    crank = np.array([np.cos(0.5), np.sin(0.5), 0.0])
    for name in ("arm1", "arm2"):
        lost = [d for d in found.lost_directions if d.arm == name and d.kind == "translation"]
        assert any(parallel(direction.axis, crank) for direction in lost)


@pytest.mark.parametrize("tilted", [False, True])
def test_planar_arms(tilted):
    """Planar arms lose the normal and turns within the plane, arm by arm; six forces stay open."""
    p = as_chain(planar_three_arms(3, tilted=tilted))
    motion = motion_of(p)
    arm = motion.arms["arm1"]
    normal = arm.at.R[0] @ arm.arm.joints[0].axis
    found = diagnose(p.chain, p.state)
    assert (found.status, found.rank, found.generic_rank, found.mobility) == ("indeterminate", 12, 12, 13)
    assert_indeterminate_forces(p, found)
    assert len(found.lost_directions) == 9
    for direction in found.lost_directions:
        assert direction.strength == 0.0
        assert_felt_by_no_drive(p, direction)
        if direction.kind == "translation":
            assert parallel(direction.axis, normal)
        else:
            assert direction.kind == "rotation"
            assert abs(direction.axis @ normal) < 1e-9
    kinds = [(direction.arm, direction.kind) for direction in found.lost_directions]
    for name in ("arm1", "arm2", "arm3"):
        assert kinds.count((name, "translation")) == 1
        assert kinds.count((name, "rotation")) == 2
    assert "accelerations are unique" in found.report()


@pytest.mark.parametrize("opposed", [True, False])
@pytest.mark.parametrize("seed", range(2))
def test_collinear_arms(opposed, seed):
    """Both arms lose the line they are stretched along; a squeeze along it stays open: singular."""
    p = as_chain(two_collinear_stretched_6r(seed, opposed=opposed))
    c = motion_of(p).contacts
    line = (c[1].offset - c[0].offset) / np.linalg.norm(c[1].offset - c[0].offset)
    found = diagnose(p.chain, p.state)
    assert (found.status, found.rank, found.mobility) == ("singular", 11, 7)
    assert [(d.arm, d.kind) for d in found.lost_directions] == [("arm1", "translation"), ("arm2", "translation")]
    origin = p.state.object_frame.p
    for direction in found.lost_directions:
        assert parallel(direction.axis, line)
        off = direction.point - (origin + c[0].offset)
        assert np.linalg.norm(off - (off @ line) * line) < 1e-9  # the line runs through both contacts
        assert_felt_by_no_drive(p, direction)
    assert_indeterminate_forces(p, found)
    words = found.indeterminate_forces[0].words
    assert words.count("force") == 2
    assert "at 'arm1' (rigid) against force" in words


@pytest.mark.parametrize("bend", [0.0, 1e-6, 1e-3])
def test_one_straight_arm(bend):
    """A straight arm among others is named with its strength, but the chain is regular."""
    p = as_chain(one_straight_arm_of_three(bend, which=(1,)))
    found = diagnose(p.chain, p.state)
    assert (found.status, found.rank, found.mobility) == ("regular", 18, 6)
    (direction,) = found.lost_directions
    assert direction.arm == "arm2"
    assert direction.words.startswith("arm 'arm2' cannot" if bend == 0.0 else "arm 'arm2' can hardly (relative")
    assert direction.strength == 0.0 if bend == 0.0 else 0.01 * bend < direction.strength < bend
    at = motion_of(p).arms["arm2"].at
    along = at.reach[0] / np.linalg.norm(at.reach[0])
    assert abs(abs(direction.axis @ along) - 1) < 10 * bend + 1e-9


def test_a_bent_arm_is_not_listed():
    """A tenth of a radian is far enough from straight."""
    p = as_chain(one_straight_arm_of_three(0.1))
    assert diagnose(p.chain, p.state).lost_directions == ()


@pytest.mark.parametrize(("length", "mass"), [(1e3, 1.0), (1e-3, 1.0), (1.0, 1e3), (1e3, 1e-3)])
@pytest.mark.parametrize("system", ["mixed", "straight", "planar", "flat", "collinear"])
def test_no_units(system, length, mass):
    """Millimetres or kilometres, grams or tonnes: status, rank and condition stay."""
    make = {
        "mixed": lambda: stored("mixed_4arm_all_types"),
        "straight": lambda: as_chain(one_straight_arm_of_three(1e-3)),
        "planar": lambda: stored("planar_3arm_6_7_6_omega_singular"),
        "flat": lambda: as_chain(planar_parallelogram(0.0)),
        "collinear": lambda: as_chain(two_collinear_stretched_6r(0)),
    }
    p = make[system]()
    other, _ = rescaled(p, length, mass)
    before, after = diagnose(p.chain, p.state), diagnose(other.chain, other.state)
    for key in ("status", "rank", "mobility"):
        assert getattr(after, key) == getattr(before, key)
    assert after.condition == pytest.approx(before.condition, rel=1e-6)
    assert [d.arm for d in after.lost_directions] == [d.arm for d in before.lost_directions]
    strengths = [[d.strength for d in found.lost_directions] for found in (before, after)]
    np.testing.assert_allclose(strengths[1], strengths[0], rtol=1e-6, atol=1e-9)


def test_velocities_do_not_enter():
    """Diagnosis is of the configuration alone."""
    p = stored("planar_2arm_6_6_omega_singular")
    fast = State(p.state.q, 7 * p.state.qd + 1, p.state.object_pose, -p.state.object_twist)
    assert diagnose(p.chain, fast).report() == diagnose(p.chain, p.state).report()


def test_nobody_holds():
    """Without grasps everything is free, and nothing can be badly conditioned."""
    p = stored("rigid_1arm_6R")
    found = diagnose(p.chain.without_grasp("arm1"), p.state)
    assert (found.status, found.rank, found.rows, found.mobility, found.condition) == ("regular", 0, 0, 12, 1.0)
