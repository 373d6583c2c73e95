"""The five-line start: closed, nearest to the preferred configuration, reproducible, and plain about what failed."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.assembly.assemble import assemble, distance
from holdfast.dynamics import closure
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.object_level import motion_basis
from holdfast.robots import HOME, ROBOTS, stewart_platform, three_finger_hand
from holdfast.spatial import rotation
from holdfast.world import HalfSpace, Touching, corners
from tests.control.two_pandas import ELBOW_UP, LEFT, RIGHT
from tests.longer import mostly_slow
from tests.systems.problems import largest_gaps

BOX = hf.HeldObject.box(3.0, 0.3, 0.2, 0.2)
CLOSED = 1e-10
STATIONARY = 1e-8  # slope of the distance along any self-motion
MENDED = hf.Pose.from_wxyz_xyz([0.5**0.5, 0, 0.5**0.5, 0, 0, 0, 0])
APART = {"panda": 0.55, "iiwa14": 0.75, "ur5e": 0.6, "gen3": 0.55}  # [m]


def facing(robot: str, kinds=("rigid", "rigid")):
    """Return two robots on either side of the box, and grasps on its end faces."""
    turned = hf.Pose(rotation.exp(np.array([0.0, 0.0, np.pi])), np.array([APART[robot], 0.0, 0.0]))
    arms = {"left": ROBOTS[robot](hf.Pose.translation(-APART[robot], 0.0, 0.0)), "right": ROBOTS[robot](turned)}
    return arms, BOX, {"left": hf.Grasp(kinds[0], LEFT), "right": hf.Grasp(kinds[1], RIGHT)}


def slope(chain, state, preferred, *, hold_object: bool) -> float:
    """Return how fast the distance to the preferred configuration changes along the steepest self-motion.

    Self-motions from `motion_basis`, all joints inside their limits.
    """
    basis = motion_basis(chain, state)
    if hold_object:
        _, sizes, Vt = np.linalg.svd(basis[-6:])
        basis = basis @ Vt[int((sizes > 1e-9).sum()) :].T
        assert np.abs(basis[-6:]).max(initial=0.0) < 1e-12
    basis, _ = np.linalg.qr(basis)
    return float(np.linalg.norm(basis[:-6].T @ (state.q - preferred)))


@pytest.mark.parametrize("robot", mostly_slow(ROBOTS, ("panda", "ur5e")))
@pytest.mark.parametrize("pose", [None, [1, 0, 0, 0, 0, 0, 0.6]], ids=["found", "given"])
def test_two_of_every_robot(robot, pose):
    """Closed, inside the limits, at rest, where the object was put, and stationary along every self-motion."""
    chain, state = assemble(*facing(robot), object_pose=pose)
    limits = np.concatenate([arm.position_limits for arm in chain.arms.values()])
    assert largest_gaps(closure(chain, state))[0] <= CLOSED
    assert ((limits[:, 0] < state.q) & (state.q < limits[:, 1])).all()
    assert not state.qd.any()
    if pose is not None:
        assert state.object_pose.tolist() == pose
    preferred = np.tile(HOME[robot], 2)
    assert slope(chain, state, preferred, hold_object=pose is not None) <= STATIONARY
    assert np.isfinite(hf.forward_dynamics(chain, state, np.zeros(len(state.q))).qdd).all()


@pytest.mark.parametrize("kinds", [("rigid", "ball"), ("hinge", "rigid"), ("ball", "hinge")])
def test_other_grasps(kinds):
    """Freedom at the grasps is used for the configuration too."""
    wish = {"left": ELBOW_UP, "right": ELBOW_UP}
    chain, state = assemble(*facing("panda", kinds), object_pose=[1, 0, 0, 0, 0, 0, 0.7], q=wish)
    rigid, firm = assemble(*facing("panda"), object_pose=[1, 0, 0, 0, 0, 0, 0.7], q=wish)
    preferred = np.tile(ELBOW_UP, 2)
    assert largest_gaps(closure(chain, state))[0] <= CLOSED
    assert slope(chain, state, preferred, hold_object=True) <= STATIONARY
    assert distance(chain, state, preferred) < distance(rigid, firm, preferred)


def test_it_is_a_minimum():
    """Elbows moved either way and closed again are farther from the preferred configuration."""
    chain, state = assemble(*facing("iiwa14"), object_pose=[1, 0, 0, 0, 0, 0, 0.6])
    preferred = np.tile(HOME["iiwa14"], 2)
    basis = motion_basis(chain, state)
    _, sizes, Vt = np.linalg.svd(basis[-6:])
    for elbow in (basis @ Vt[int((sizes > 1e-9).sum()) :].T)[:-6].T:
        for step in (-0.1, 0.1):
            wish = dict(zip(chain.names, np.split(state.q + step * elbow, 2), strict=True))
            swung = assemble(*facing("iiwa14"), object_pose=state.object_pose, q=wish).state
            assert np.linalg.norm(swung.q - state.q) > 0.05
            assert distance(chain, swung, preferred) > distance(chain, state, preferred)


def test_a_joint_at_its_limit_stays_there():
    """A wish beyond a limit ends at the limit; along what is left of the self-motions nothing is gained."""
    arms, box, grasps = facing("panda", ("ball", "ball"))
    wish = {"left": ELBOW_UP + np.array([0, 0, 0, 0, 0, 2.0, 0]), "right": ELBOW_UP}
    chain, state = assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.7], q=wish)
    assert state.q[5] == arms["left"].joints[5].position_limits[1]
    basis = motion_basis(chain, state)
    fixed = np.concatenate([basis[-6:], basis[5:6]])
    _, sizes, Vt = np.linalg.svd(fixed)
    free, _ = np.linalg.qr(basis @ Vt[int((sizes > 1e-9).sum()) :].T)
    preferred = np.concatenate(list(wish.values()))
    assert np.linalg.norm(free[:-6].T @ (state.q - preferred)) <= STATIONARY
    assert largest_gaps(closure(chain, state))[0] <= CLOSED


def test_the_same_every_time():
    """Two calls give the same bits."""
    first, second = (assemble(*facing("panda")).state for _ in range(2))
    assert (first.q == second.q).all()
    assert (first.object_pose == second.object_pose).all()


def test_moved_as_a_whole():
    """Arms and object displaced together: the joints do not notice."""
    arms, box, grasps = facing("panda")
    shift = hf.Pose(rotation.exp(np.array([0.3, -0.2, 1.0])), np.array([1.0, 2.0, -0.5]))
    pose = hf.Pose.translation(0.0, 0.0, 0.7)
    here = assemble(arms, box, grasps, object_pose=pose).state
    moved = {name: arm.at(shift @ arm.base) for name, arm in arms.items()}
    there = assemble(moved, box, grasps, object_pose=shift @ pose).state
    assert there.q == pytest.approx(here.q, abs=1e-8)


@pytest.mark.slow
def test_mechanisms():
    """The platform comes to rest level with its drives at mid stroke; the hand pinches at the middle of its range."""
    chain, state = assemble(*stewart_platform())
    assert state.q == pytest.approx(np.zeros(18), abs=1e-9)
    assert state.object_pose == pytest.approx([1, 0, 0, 0, 0, 0, 0.45], abs=1e-9)
    assert hf.diagnose(chain, state).mobility == 6
    chain, state = assemble(*three_finger_hand())
    assert state.q == pytest.approx(np.tile(state.q[:4], 3), abs=1e-9)
    assert largest_gaps(closure(chain, state))[0] <= CLOSED
    assert hf.diagnose(chain, state).mobility == 6


def test_an_arm_that_holds_nothing():
    """It takes its preferred configuration, and the report says that it holds nothing."""
    arms, box, grasps = facing("ur5e")
    assembly = assemble(arms, box, {"left": grasps["left"]}, object_pose=[1, 0, 0, 0, 0, 0, 0.6])
    assert assembly.state.q[6:] == pytest.approx(HOME["ur5e"])
    assert "right: holds nothing" in str(assembly.report)


def test_what_acts_on_the_object():
    """Springs and what may touch the world belong to the chain, and the state is the same without them."""
    world = Touching(corners(0.3, 0.2, 0.2), {"table": HalfSpace(offset=0.1)})
    spring = hf.Spring(("world", np.zeros(3)), ("object", np.zeros(3)), 100.0)
    chain, state = assemble(*facing("ur5e"), object_pose=[1, 0, 0, 0, 0, 0, 0.6], springs=[spring], touching=world)
    assert chain.touching is world and len(chain.springs) == 1
    assert "world: table, 8 contacts possible" in repr(chain)
    plain = assemble(*facing("ur5e"), object_pose=[1, 0, 0, 0, 0, 0, 0.6]).state
    assert np.array_equal(plain.q, state.q)


def test_report():
    """Reach, nearest limit, closure and mobility, in numbers and in words."""
    assembly = assemble(*facing("panda"), object_pose=[1, 0, 0, 0, 0, 0, 0.7])
    chain, state = assembly
    report = assembly.report
    left = report.arms[0]
    assert report.mobility == hf.diagnose(chain, state).mobility == 8
    assert (report.rank, report.rows) == (12, 12)
    assert left.reach == pytest.approx(np.hypot(0.4, 0.7 - 0.333))
    # joints 2 to 7 are at most 0.316, 0.0825, sqrt(0.0825^2 + 0.384^2), 0.088 apart, the flange 0.107 on
    assert left.longest == pytest.approx(0.316 + 0.0825 + np.hypot(0.0825, 0.384) + 0.088 + 0.107)
    low, high = chain.arms["left"].position_limits.T
    margins = np.minimum(state.q[:7] - low, high - state.q[:7])
    assert left.margin == pytest.approx(margins.min())
    assert left.joint == f"joint{np.argmin(margins) + 1}"
    assert left.residual <= CLOSED
    words = str(report)
    assert words.count("closed to") == 2
    assert "mobility 8, rank 12 of 12" in words
    assert "not checked: collisions" in words


def test_report_of_dependent_rows():
    """Fewer independent rows than rows are pointed out."""
    along_x = lambda x: hf.Pose.translation(x, 0.0, 0.0)  # noqa: E731
    joints = [hf.Joint(placement=along_x(x), position_limits=(-3.0, 3.0)) for x in (0.0, 0.5, 0.5)]
    planar = hf.Arm(joints, [hf.Link(1.0, inertia=np.eye(3))] * 3, along_x(0.5))
    grasps = {name: hf.Grasp("rigid", along_x(x)) for name, x in (("a", -0.1), ("b", 0.1))}
    held, q = hf.HeldObject.box(1, 0.2, 0.2, 0.2), {"a": [0.5, 0.6, 0.7], "b": [0.6, 0.5, 0.6]}
    assembly = assemble({"a": planar, "b": planar.at(along_x(0.3))}, held, grasps, q=q)
    assert "rows are dependent" in str(assembly.report)


def test_too_far():
    """Every arm that no configuration brings there is named with what it lacks."""
    with pytest.raises(hf.errors.ClosureError) as caught:
        assemble(*facing("panda"), object_pose=[1, 0, 0, 0, 1, 1, 0.5])
    assert "arm 'left' is 0.742 m short" in str(caught.value)
    assert "arm 'right' is 0.192 m short" in str(caught.value)
    assert "Try" in str(caught.value)


def test_within_reach_but_not_that_way():
    """An attitude that the joint limits forbid: the arm, and what is left of the gap."""
    with pytest.raises(hf.errors.ClosureError, match=r"arm 'left' misses its grasp by 0.* Try"):
        assemble(*facing("panda"), object_pose=[1, 0, 0, 0, 0, 0, 0.3])


def narrowed(robot: str, widest: float) -> hf.Arm:
    """Return a built-in robot whose joints turn no farther than so far from 0."""
    arm = ROBOTS[robot]()
    limits = np.clip(arm.position_limits, -widest, widest)
    pairs = zip(arm.joints, limits, strict=True)
    return replace(arm, joints=[replace(joint, position_limits=tuple(pair)) for joint, pair in pairs])


@pytest.mark.parametrize("kind", ["rigid", "hinge", "ball"])
@pytest.mark.parametrize(
    ("robot", "widest", "draws"),
    mostly_slow([("ur5e", 2.5, range(4)), ("panda", 9.0, (7, 19, 27))], [("panda", 9.0, (7, 19, 27))]),
)
def test_other_configurations_are_tried(robot, widest, draws, kind):
    """Where a configuration with 5 % of every range to spare exists, the one found has the 2 % that are asked for."""
    arm, random = narrowed(robot, widest), np.random.default_rng(1)
    low, high = arm.position_limits.T
    configurations = random.uniform(low + 0.05 * (high - low), high - 0.05 * (high - low), (max(draws) + 1, len(low)))
    for k in draws:
        grasps = {"arm": hf.Grasp(kind, hf.Pose.identity())}
        chain, state = assemble({"arm": arm}, BOX, grasps, object_pose=forward_kinematics(arm, configurations[k]).tip)
        assert largest_gaps(closure(chain, state))[0] <= CLOSED
        assert (np.minimum(state.q - low, high - state.q) >= (0.02 - 1e-9) * (high - low)).all()


def sideways(robot: str = "panda") -> tuple[dict[str, hf.Arm], hf.HeldObject, dict[str, hf.Grasp]]:
    """Return two robots on either side of the box whose tips point sideways, as a UR's `ee_link` does."""
    arms, box, grasps = facing(robot)
    turn = hf.Pose(rotation.exp(np.array([0.0, -np.pi / 2, 0.0])), np.zeros(3))
    return {name: arm.with_tip(arm.tip @ turn) for name, arm in arms.items()}, box, grasps


def test_a_tip_that_points_sideways():
    """Accepted, but the report says so with the angle and the turn, once for each arm that holds."""
    arms, box, grasps = sideways("gen3")
    assembly = assemble(arms, box, grasps)
    left = assembly.report.arms[0]
    assert np.degrees(left.tip_angle) == pytest.approx(90.0)
    assert "hf.Pose.from_wxyz_xyz([0.5**0.5, 0, 0.5**0.5, 0, 0, 0, 0])" in left.tip_note
    lines = str(assembly.report).splitlines()
    told = [line for line in lines if "the tip's z axis is 90 deg off" in line]
    assert [line.split(":")[1] for line in told] == [" left", " right"]
    straight = assemble(*facing("gen3")).report
    assert straight.arms[0].tip_angle == pytest.approx(0.0, abs=1e-7)
    assert "note:" not in str(straight)


def test_a_tip_that_points_sideways_cannot_reach():
    """The error has the reason: the angle, and the turn that mends it, once for arms that are alike."""
    arms, box, grasps = sideways()
    pose = [1, 0, 0, 0, 0, 0, 1.05]
    wanted = r"misses its grasp .* 90 deg off .* try arm\.with_tip\(arm\.tip @"
    with pytest.raises(hf.errors.ClosureError, match=wanted) as refused:
        assemble({"left": arms["left"]}, box, {"left": grasps["left"]}, object_pose=pose)
    assert len(str(refused.value)) < 600
    alike = hf.ClosedChain(arms, box, grasps)
    with pytest.raises(hf.errors.ClosureError, match="Of 'left', 'right': the tip's z axis") as refused:
        hf.close(alike, hf.State(np.tile(HOME["panda"], 2), np.zeros(14), pose), hold_object=True)
    assert str(refused.value).count("deg off") == 1
    turned = arms["left"].with_tip(arms["left"].tip @ MENDED)
    assemble({"left": turned}, box, {"left": grasps["left"]}, object_pose=pose)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"q": {"lft": np.zeros(7)}}, hf.errors.ModelError, "q: no arm 'lft'. Did you mean 'left'"),
        ({"q": np.zeros(14)}, hf.errors.ModelError, "q: expected joint positions by arm name"),
        ({"q": {"left": np.zeros(6)}}, hf.errors.StateError, "q of 'left': expected shape"),
        ({"object_pose": [0, 0, 0.7]}, hf.errors.ModelError, "object_pose"),
        ({"gravity": [0, 0]}, hf.errors.ModelError, "gravity"),
    ],
)
def test_bad_options(options, error, message):
    """What cannot be meant is refused by name."""
    with pytest.raises(error, match=message):
        assemble(*facing("panda"), **options)


def test_nothing_to_find():
    """Without grasps the object's pose has to be given."""
    arms, box, _ = facing("panda")
    with pytest.raises(hf.errors.ModelError, match="expected at least one grasp"):
        assemble(arms, box, {})
    assert assemble(arms, box, {}, object_pose=[1, 0, 0, 0, 0, 0, 0.7]).state.q == pytest.approx(
        np.tile(HOME["panda"], 2)
    )
