"""What a configuration can and cannot do: rank, lost directions, open forces, and a condition without units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast
from holdfast import ClosedChain, State, diagnose, forward_dynamics
from holdfast.dynamics import METHODS
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.diagnose import Diagnosis
from holdfast.errors import MethodNotApplicable, SingularChainError
from tests.dynamics.problems import motion_of
from tests.laws.transformed import rescaled
from tests.longer import mostly_long, mostly_slow
from tests.systems import one_straight_arm_of_three, planar_parallelogram, planar_three_arms, two_collinear_stretched_6r
from tests.systems.anchored import pinned
from tests.systems.as_chain import Problem, as_chain, mounted
from tests.systems.problems import CASES, STATE, random_problem, stored

ORDINARY = 100.0


def diagnosed(p: Problem) -> Diagnosis:
    """Return the diagnosis of a problem's configuration."""
    return diagnose(p.chain, p.state)


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
    """Assert that every listed pattern causes no joint torque and no net force on the object, and is all of them."""
    s = Stacked(motion_of(p))
    patterns = np.array([force.wrenches.ravel() for force in found.indeterminate_forces])
    assert len(patterns) == found.rows - found.rank == np.linalg.matrix_rank(patterns)
    for force, f in zip(found.indeterminate_forces, patterns, strict=True):
        assert np.abs(s.J.T @ f).max() < 1e-9
        assert np.abs(s.A.T @ f).max() < 1e-9
        assert "causes no joint torque" in force.words


@pytest.mark.parametrize("seed", range(2))
def test_regular(seed):
    """A sound chain: full rank, nothing lost, nothing indeterminate, mobility by counting."""
    p = random_problem(seed, grasps=("rigid", "hinge", "softfinger", "ball"), joints=(7, 6, 7, 7))
    found = diagnosed(p)
    assert (found.status, found.rank, found.generic_rank, found.rows) == ("regular", 24, 24, 24)
    assert found.mobility == 27 + 6 + 6 - 24
    assert found.lost_directions == found.indeterminate_forces == ()
    assert found.report() == f"regular: rank 24 of 24 (nearby 24), mobility 15, condition {found.condition:.3g}"


@pytest.mark.parametrize("name", CASES)
def test_stored_cases(name):
    """Mobility and rank as stored, the rank that of singular values, no condition near the singularity meter's."""
    p, tags = stored(name), CASES[name]["tags"]
    found, s = diagnosed(p), Stacked(motion_of(p))
    assert (found.mobility, found.rank) == (tags["mobility"], tags["constraint_rank"])
    assert found.rank == np.linalg.matrix_rank(np.hstack([s.J, -s.A, s.HT]), tol=1e-9)
    assert found.status == ("regular" if tags["f_unique"] else "indeterminate")
    assert 1.0 <= found.condition < ORDINARY


def test_flat_parallelogram():
    """Flat, both cranks lose their common line and the chain one more row: singular, in words."""
    p = as_chain(planar_parallelogram(0.0))
    found = diagnosed(p)
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
    found = diagnosed(p)
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
    arm = motion_of(p).arms["arm1"]
    normal = arm.at.R[0] @ arm.arm.joints[0].axis
    found = diagnosed(p)
    assert (found.status, found.rank, found.generic_rank, found.mobility) == ("indeterminate", 12, 12, 13)
    assert_indeterminate_forces(p, found)
    for direction in found.lost_directions:
        assert direction.strength == 0.0
        assert_felt_by_no_drive(p, direction)
        across = abs(direction.axis @ normal)
        assert abs(across - (direction.kind == "translation")) < 1e-9
    kinds = [(direction.arm, direction.kind) for direction in found.lost_directions]
    lost = ["translation", "rotation", "rotation"]
    assert sorted(kinds) == sorted((name, kind) for name in p.chain.names for kind in lost)
    assert "accelerations are unique" in found.report()


@pytest.mark.parametrize(("opposed", "seed"), mostly_long([(True, 0), (True, 2), (False, 0)], [(True, 0), (False, 0)]))
def test_collinear_arms(opposed, seed):
    """Both arms lose the line they are stretched along: singular, whether or not neighbours show rank 12."""
    p = as_chain(two_collinear_stretched_6r(seed, opposed=opposed))
    c = motion_of(p).contacts
    line = (c[1].offset - c[0].offset) / np.linalg.norm(c[1].offset - c[0].offset)
    found = diagnosed(p)
    assert (found.status, found.rank, found.mobility, found.condition) == ("singular", 11, 7, np.inf)
    assert [(d.arm, d.kind) for d in found.lost_directions] == [("arm1", "translation"), ("arm2", "translation")]
    for direction in found.lost_directions:
        assert parallel(direction.axis, line)
        off = direction.point - (p.state.object_frame.p + c[0].offset)
        assert np.linalg.norm(off - (off @ line) * line) < 1e-9  # the line runs through both contacts
        assert_felt_by_no_drive(p, direction)
    assert_indeterminate_forces(p, found)
    words = found.indeterminate_forces[0].words
    assert words.count("force") == 2
    assert "at 'arm1' (rigid) against force" in words
    nearby = "but 12 nearby" if found.generic_rank == 12 else "and some velocities it allows begin no motion"
    with pytest.raises(SingularChainError, match=rf"rank 11 of 12 here, {nearby}: a singular configuration.*diagnose"):
        p.solved()


@pytest.mark.parametrize("bend", [0.0, 1e-6, 1e-3])
def test_one_straight_arm(bend):
    """A straight arm among others is named with its strength, but the chain is regular."""
    p = as_chain(one_straight_arm_of_three(bend, which=(1,)))
    found = diagnosed(p)
    assert (found.status, found.rank, found.mobility) == ("regular", 18, 6)
    (direction,) = found.lost_directions
    assert direction.arm == "arm2"
    assert direction.words.startswith("arm 'arm2' cannot" if bend == 0.0 else "arm 'arm2' can hardly (relative")
    assert direction.strength == 0.0 if bend == 0.0 else 0.01 * bend < direction.strength < bend
    at = motion_of(p).arms["arm2"].at
    along = at.reach[0] / np.linalg.norm(at.reach[0])
    assert abs(abs(direction.axis @ along) - 1) < 10 * bend + 1e-9


def test_straight_arms_are_no_singularity():
    """Three straight arms on different lines: full rank all the same; one bent by a tenth of a radian is not listed."""
    found = diagnosed(as_chain(one_straight_arm_of_three(0.0, which=(0, 1, 2))))
    assert (found.status, found.rank) == ("regular", 18)
    assert diagnosed(as_chain(one_straight_arm_of_three(0.1))).lost_directions == ()


@pytest.mark.parametrize(("length", "mass"), [(1e3, 1.0), (1e-3, 1e3)])
@pytest.mark.parametrize(
    "system", mostly_slow(["mixed", "flat", "legs", "straight", "planar", "bent", "collinear"], ["mixed", "flat"])
)
def test_no_units(system, length, mass):
    """Millimetres or kilometres, grams or tonnes: status, ranks and condition stay."""
    make = {
        "mixed": lambda: stored("mixed_4arm_all_types"),
        "legs": lambda: stored("stewart_6_RRP_ball"),
        "straight": lambda: as_chain(one_straight_arm_of_three(1e-3)),
        "planar": lambda: stored("planar_3arm_6_7_6_omega_singular"),
        "bent": lambda: as_chain(planar_parallelogram(0.03)),
        "flat": lambda: as_chain(planar_parallelogram(0.0)),
        "collinear": lambda: as_chain(two_collinear_stretched_6r(0)),
    }
    p = make[system]()
    before, after = diagnosed(p), diagnosed(rescaled(p, length, mass)[0])
    for key in ("status", "rank", "generic_rank", "mobility"):
        assert getattr(after, key) == getattr(before, key)
    assert after.condition == pytest.approx(before.condition, rel=1e-8)
    assert [d.arm for d in after.lost_directions] == [d.arm for d in before.lost_directions]
    strengths = [[d.strength for d in found.lost_directions] for found in (before, after)]
    np.testing.assert_allclose(strengths[1], strengths[0], rtol=1e-6, atol=1e-9)


def test_velocities_do_not_enter():
    """Diagnosis is of the configuration alone."""
    p = stored("planar_2arm_6_6_omega_singular")
    fast = State(p.state.q, 7 * p.state.qd + 1, p.state.object_pose, -p.state.object_twist)
    assert diagnose(p.chain, fast).report() == diagnosed(p).report()


def test_nobody_holds():
    """Without grasps everything is free, and nothing can be badly conditioned."""
    p = stored("rigid_1arm_6R")
    found = diagnose(p.chain.without_grasp("arm1"), p.state)
    assert (found.status, found.rank, found.rows, found.mobility, found.condition) == ("regular", 0, 0, 12, 1.0)


def test_condition_is_the_same_wherever_it_is_asked_for():
    """Diagnosis, every method of forward dynamics and machine code, alone and in a batch."""
    p = stored("mixed_2arm_fast")
    expected = diagnosed(p).condition
    for method in METHODS:
        try:
            found = p.solved(method=method)
        except MethodNotApplicable:
            continue
        assert found.condition == pytest.approx(expected, rel=1e-9), method
    fast = holdfast.compile(p.chain)
    given = {name: getattr(p.state, name) for name in STATE} | {"tau": p.tau}
    assert fast.forward_dynamics(**given).condition == pytest.approx(expected, rel=1e-9)
    batch = fast.forward_dynamics(**{name: np.tile(x, (3, 1)) for name, x in given.items()})
    np.testing.assert_allclose(batch.condition, expected, rtol=1e-9)


@pytest.mark.parametrize("name", ["rigid_2arm_7R_gravity", "rigid_5arm_9link", "softfinger_3arm"])
def test_a_light_object_is_no_singularity(name):
    """An object of a milligram or a gram between arms of kilograms: as regular as one of a kilogram."""
    p = stored(name)
    body = p.chain.held_object
    for lightness in (1e-6, 1e-3):
        light = replace(body, mass=lightness * body.mass, inertia=lightness * body.inertia)
        assert diagnose(replace(p.chain, held_object=light), p.state).condition < ORDINARY


def condition_at(chain: ClosedChain, state: State, rank: int) -> float:
    """Return the condition as forward dynamics has it, of the configuration at rest."""
    still = State(state.q, 0.0 * state.qd, state.object_pose)
    return forward_dynamics(chain, still, np.zeros(chain.joint_count), generic_rank=rank).condition


def test_condition_of_a_flattening_parallelogram():
    """It grows at every step, as 1 / angle^2, and is infinite when the cranks lie flat."""
    angles = np.geomspace(0.5, 1e-4, 25).tolist()
    chains = [as_chain(planar_parallelogram(angle)) for angle in angles]
    found = np.array([condition_at(p.chain, p.state, 9) for p in chains])
    assert (np.diff(found) > 0.0).all()
    assert np.log(found[-1] / found[-9]) / np.log(angles[-9] / angles[-1]) == pytest.approx(2.0, abs=0.02)
    assert diagnosed(as_chain(planar_parallelogram(0.0))).condition == np.inf


@pytest.mark.parametrize(("opposed", "seed"), [(True, 0), (False, 1)])
def test_condition_of_two_arms_that_stretch_along_one_line(seed, opposed):
    """As 1 / bend^2, over five orders of magnitude of it; bases follow so that the grasps still hold."""
    p = as_chain(two_collinear_stretched_6r(seed, opposed))

    def bent(bend: float) -> tuple[ClosedChain, State]:
        q = p.state.q + bend * np.random.default_rng(0).normal(size=len(p.state.q))
        return mounted(p.chain, q, p.state.object_frame), State(q, 0.0 * q, p.state.object_pose)

    bends = np.geomspace(0.1, 1e-4, 13)
    found = np.array([condition_at(*bent(bend), 12) for bend in bends])
    assert (np.diff(found) > 0.0).all()
    assert np.diff(np.log(found)) / -np.diff(np.log(bends)) == pytest.approx(2.0, abs=0.5)
    assert np.log(found[-1] / found[-5]) / np.log(bends[-5] / bends[-1]) == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("kind", ["hinge", "rigid"])
def test_anchors_lose_no_directions(kind):
    """What an anchor holds is no fault of the configuration: said by itself; the arms' own directions stay."""
    free = as_chain(one_straight_arm_of_three(0.0, which=(1,)))
    p = pinned(free, (kind,), moving=False)
    found = diagnosed(p)
    assert [lost.arm for lost in found.lost_directions] == [lost.arm for lost in diagnosed(free).lost_directions]
    (held,) = found.anchors
    assert held in found.report() and f"anchor 'pin1' ({kind})" in held
    assert f"the {len(p.chain.grasps['pin1'].transmitted)} directions" in held
