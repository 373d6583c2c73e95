"""Real robots from wheels on PyPI (`make robots`): every arm loads or is refused by name, and agrees with Pinocchio."""

from __future__ import annotations

import os
import re
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast import HoldfastError, load_urdf_trunk
from holdfast.model.tip_direction import tip_advice, tip_angle
from holdfast.robots import ROBOTS
from holdfast.robots.arms_on_trunk import ArmsOnTrunk
from holdfast.robots.urdf import UrdfChain, UrdfRobot, read_urdf, urdf_chain, urdf_visuals
from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.vocabulary import VOCABULARY, is_off, of_drive
from tests.acceptance.comparison import relative
from tests.robots.arm_dynamics import mass_jacobian_bias
from tests.systems.problems import largest_gaps

pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")
from benchmarks import free_robots

from tests.robots.pinocchio_closed import closed_gaps
from tests.robots.pinocchio_trunk import gaps as trunk_gaps
from tests.robots.pinocchio_urdf import Models

FOLDER = Path(os.environ.get("HOLDFAST_ROBOTS", "results/robots"))
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not any(FOLDER.rglob("*.urdf")), reason="no robots fetched: make robots"),
]
TOLERANCE = 1e-10
NAMED = re.compile(r"^.*:\d+: \S")  # file, line, element
STATES = 2
PAIRS = 12  # of base and tip anywhere in the robot


def gaps(models: Models, chain: UrdfChain, rng: np.random.Generator) -> np.ndarray:
    """Return the relative gaps of M, J and bias, the worst over states."""
    worst, least = np.zeros(3), models.rounding(chain)
    for _ in range(STATES):
        q, qd = rng.uniform(-1.5, 1.5, (2, chain.arm.joint_count))
        M, J, bias = mass_jacobian_bias(chain.arm, q, qd)
        M_pin, J_pin, bias_pin = models.mass_jacobian_bias(chain, q, qd)
        torque = max(float(np.abs(M_pin).max()) * float(qd @ qd), 10 * least)  # where gravity does no work
        gap = [relative(M, M_pin, least), relative(J, J_pin), relative(bias, bias_pin, torque)]
        worst = np.maximum(worst, gap)
    return worst


def pairs(robot: UrdfRobot, rng: np.random.Generator) -> list[tuple[str, str]]:
    """Return base and tip of every arm from the root to a leaf, and some between any two links."""
    leaves = [link for link in robot.links if not robot.joints_below[link]]
    links = list(robot.links)
    chosen = [tuple(rng.choice(links, 2)) for _ in range(PAIRS)]
    return [(robot.root, leaf) for leaf in leaves] + [(str(a), str(b)) for a, b in chosen]


def urdf_files() -> list[Path]:
    """Return the fetched files, one of each content."""
    found: dict[bytes, Path] = {}
    for path in sorted(FOLDER.rglob("*.urdf")):
        found.setdefault(path.read_bytes(), path)
    return list(found.values())


def compare(path: Path) -> tuple[Counter[str], np.ndarray]:
    """Return how many arms of a file load, or are refused and why, and the worst gaps."""
    rng, counts, worst = np.random.default_rng(0), Counter[str](), np.zeros(3)
    try:
        robot = read_urdf(path)
    except HoldfastError as refusal:
        return Counter({named(refusal, path): 1}), worst
    models = read_by_pinocchio(path)
    for base, tip in pairs(robot, rng):
        try:
            chain = load(path, base, tip, counts)
        except HoldfastError as refusal:
            counts[kind(named(refusal, path))] += 1
            continue
        try:
            urdf_visuals(chain)
        except HoldfastError as refusal:
            counts[named(refusal, path)] += 1
        counts["arms" if models else "arms that Pinocchio does not read"] += 1
        if models:
            worst = np.maximum(worst, gaps(models, chain, rng))
    return counts, worst


def read_by_pinocchio(path: Path) -> Models | None:
    """Return Pinocchio's models of a file, None if it refuses it."""
    try:
        return Models(path.read_text(encoding="utf-8"))
    except ValueError:
        return None


def named(refusal: HoldfastError, path: Path) -> str:
    """Return a refusal without its folder; it must name file, line and element."""
    assert NAMED.match(str(refusal)), refusal
    return str(refusal).replace(f"{path.parent}/", "")


def load(path: Path, base: str, tip: str, counts: Counter[str]) -> UrdfChain:
    """Return an arm, with impossible inertias if it has some."""
    try:
        return urdf_chain(path, base=base, tip=tip, lock_others=True)
    except HoldfastError as refusal:
        if "physical=False" not in str(refusal):
            raise
        counts["physical=False"] += 1
        return urdf_chain(path, base=base, tip=tip, lock_others=True, physical=False)


def kind(refusal: str) -> str:
    """Return a refusal in a few words."""
    kinds = {
        "expected a joint that moves": "no joint",
        "expected <inertial>": "no <inertial>",
        "mimic:": "mimic",
        "moves link": "mimic",  # lock_others holds all but those that follow the arm's own joints
        "principal moments >= 0": "inertia < 0",
        "type:": "joint type",
        "gravity off": "gravity off",
        "closes a loop": "loop",
    }
    return next((short for words, short in kinds.items() if words in refusal), refusal)


def test_real_robots():
    """Every arm between root and leaves, and between any two links: loads and agrees, or is refused by name."""
    total, robots, overall = Counter[str](), 0, np.zeros(3)
    for path in urdf_files():
        counts, worst = compare(path)
        total, robots, overall = total + counts, robots + (counts["arms"] > 0), np.maximum(overall, worst)
        facts = ", ".join(f"{count} {what}" for what, count in counts.items())
        print(f"{path.name:45s} M {worst[0]:.1e}  J {worst[1]:.1e}  bias {worst[2]:.1e}  {facts}")
    print(f"{robots} robots, {total['arms']} arms: M {overall[0]:.1e}, J {overall[1]:.1e}, bias {overall[2]:.1e}")
    print("; ".join(f"{count} {what}" for what, count in total.items() if len(what) < 40))
    assert robots >= 30
    assert overall.max() <= TOLERANCE


INSIDE = {  # elements of extensions, and the row of the elements in them
    "gazebo": "gazebo", "transmission": "transmission", "ros2_control": "ros2_control", "actuator": "transmission part",
    "leftActuator": "transmission part", "rightActuator": "transmission part", "joint": "transmission part",
    "passive_joint": "transmission part", "gap_joint": "transmission part", "rollJoint": "transmission part",
    "flexJoint": "transmission part",
}  # fmt: skip


def elements(robot: UrdfRobot) -> Iterator[tuple[str, Element]]:
    """Yield each element of a file that stands beside visuals, sensors and plugins, with the effect of its row."""
    waiting = [(child, "robot") for child in robot.element.children]
    for element, row in waiting:  # the loop appends to this list
        effect = VOCABULARY[row].effect(element.tag) or ("read" if of_drive(element.tag) else "")
        yield effect, element
        if effect == "read" and row == "robot" and element.tag in ("link", "joint"):
            waiting += [(child, element.tag) for child in element.children]
        elif effect == "read" and element.tag in INSIDE:
            waiting += [(child, INSIDE[element.tag]) for child in element.children]


def test_every_element():
    """Each element of every real robot is read, noted, refused, or has no effect; what has no row is noted by name."""
    counts, files = Counter[str](), 0
    for path in urdf_files():
        try:
            robot = read_urdf(path)
        except HoldfastError as refusal:
            counts["files refused"] += bool(named(refusal, path))
            continue
        files += 1
        parts = [robot, *robot.links.values(), *robot.joints.values()]
        noted = {note.rpartition(": ")[0] for part in parts for note in part.notes}
        coupled = {coupling.element for coupling in robot.couplings}
        for effect, element in elements(robot):
            counts[effect or "unknown"] += 1
            if effect == "refused":
                assert element in coupled
            elif effect == "" or (effect == "noted" and not is_off(element)):
                place = element.message("").rstrip(": ")
                assert place in noted or any(note.startswith(place) for note in noted), place
    print(f"{files} files;", ", ".join(f"{count} {effect}" for effect, count in sorted(counts.items())))
    assert files >= 160
    assert counts["refused"] >= 6  # the grippers of the PR2
    assert counts["read"] > 10_000


CONFIGURATIONS = 40
SPARE = 0.05  # of each joint's range, that the configuration to be found again has on either side
KEPT = 0.02  # the same, that is asked for

# file, base, tip, and the angle of its z axis with the way from the last joint [deg]; None where that tells nothing
TIPS = [
    ("ur5_robot", None, "tool0", 0),
    ("ur5_robot", None, "ee_link", 90),
    ("ur10_robot", None, "tool0", 0),
    ("ur10_robot", None, "ee_link", 90),
    ("talos_reduced", "torso_2_link", "gripper_left_base_link", 180),
    ("talos_reduced", "torso_2_link", "wrist_right_ft_tool_link", 180),
    ("talos_reduced", "torso_2_link", "arm_left_7_link", None),
    ("tiago_no_hand", "torso_lift_link", "wrist_ft_tool_link", 90),
    ("tiago", None, "hand_grasping_frame", 90),
    ("panda", None, "panda_hand_tcp", 0),
    ("panda", None, "panda_link7", None),
    ("baxter", None, "left_gripper", 0),
]
REACHING = [*[tip[:3] for tip in TIPS if tip[2] in ("tool0", "wrist_ft_tool_link", "panda_hand_tcp", "left_gripper")]]
REACHING += [("ur5_joint_limited_robot", None, "tool0"), *[tip[:3] for tip in TIPS[4:6]]]


def real_arm(file: str, base: str | None, tip: str) -> UrdfChain:
    """Return an arm of a fetched robot, its fingers held."""
    path: Path = next(path for path in sorted(FOLDER.rglob(f"{file}.urdf")) if "example-robot-data" in str(path))
    return urdf_chain(path, base=base, tip=tip, lock_others=True, physical=False)


@pytest.mark.parametrize(("file", "base", "tip", "angle"), TIPS, ids=lambda part: str(part))
def test_which_way_it_points(file, base, tip, angle):
    """The angle; and the suggested turn brings z to the way within 10 degrees."""
    chain = real_arm(file, base, tip)
    if angle is None:
        assert np.isnan(tip_angle(chain.arm))
        assert chain.tip_note == ""
        return
    assert np.degrees(tip_angle(chain.arm)) == pytest.approx(angle, abs=0.1)
    assert bool(chain.tip_note) == (angle != 0)
    if angle:
        code = re.search(r"try (arm\.with_tip\(.*\)), in a scene", chain.tip_note)
        assert code
        assert tip_advice(eval(code[1], {"arm": chain.arm, "hf": hf})) == ""
        assert np.degrees(tip_angle(eval(code[1], {"arm": chain.arm, "hf": hf}))) < 10
    if tip == "ee_link":
        assert "tip='tool0'" in chain.tip_note


@pytest.mark.parametrize("robot", [*REACHING, *ROBOTS], ids=str)
def test_what_can_be_reached_is(robot):
    """Where a configuration has 5 % of every range to spare, assemble finds one with the 2 % that it asks for."""
    arm = ROBOTS[robot]() if isinstance(robot, str) else real_arm(*robot).arm
    low, high = np.where(np.isfinite(arm.position_limits), arm.position_limits, [-np.pi, np.pi]).T
    limits = arm.position_limits.T
    random, times = np.random.default_rng(1), []
    grasps, box = {"arm": hf.Grasp("rigid", hf.Pose.identity())}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
    for _ in range(CONFIGURATIONS):
        q = random.uniform(low + SPARE * (high - low), high - SPARE * (high - low))
        start = time.perf_counter()
        chain, state = hf.assemble({"arm": arm}, box, grasps, object_pose=hf.dynamics.tip_pose(arm, q))
        times.append(time.perf_counter() - start)
        assert largest_gaps(hf.dynamics.closure(chain, state))[0] < 1e-10
        assert (np.minimum(state.q - limits[0], limits[1] - state.q) >= (KEPT - 1e-9) * (high - low)).all()
    print(f"{robot}: {CONFIGURATIONS} of {CONFIGURATIONS}, median {np.median(times):.2f} s, longest {max(times):.2f} s")


TRUNK_STATES = 10

# file, its tips, and the joints that the arms share; Baxter's torso does not move, and its arms share none
ROBOTS_WITH_TRUNKS = [
    ("baxter", ("left_gripper", "right_gripper"), ()),
    ("tiago_dual", ("hand_left_grasping_frame", "hand_right_grasping_frame"), ("torso_lift_joint",)),
    ("tiago_pro", ("gripper_left_base_link", "gripper_right_base_link"), ("torso_lift_joint",)),
    ("pr2", ("l_gripper_tool_frame", "r_gripper_tool_frame"), ("torso_lift_joint",)),
    ("talos_reduced", ("gripper_left_base_link", "gripper_right_base_link"), ("torso_1_joint", "torso_2_joint")),
    ("talos_full_v2", ("gripper_left_base_link", "gripper_right_base_link"), ("torso_1_joint", "torso_2_joint")),
    (
        "g1_29dof_rev_1_0",
        ("left_rubber_hand", "right_rubber_hand"),
        ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint"),
    ),
    (
        "g1_29dof_with_hand_rev_1_0",
        ("left_hand_palm_link", "right_hand_palm_link"),
        ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint"),
    ),
    ("romeo", ("l_gripper", "r_gripper"), ("TrunkYaw",)),
    ("icub", ("l_gripper", "r_gripper"), ("torso_pitch", "torso_roll", "torso_yaw")),
    ("centauro", ("ball1_tip", "ball2_tip"), ("torso_yaw",)),
    ("alex_nub_hands", ("LeftGripperYawLink", "RightGripperYawLink"), ("SpineYaw", "SpineRoll", "SpinePitch")),
    ("simple_humanoid", ("l_wrist", "r_wrist"), ("WAIST_P", "WAIST_R", "CHEST")),
]
ON_A_TRUNK = [
    pytest.param(file, links, floating, id=f"{file}-{'floating' if floating else 'standing'}")
    for file, links, shared in ROBOTS_WITH_TRUNKS
    for floating in (False, True)
    if floating or shared
]


def real(file: str) -> Path:
    """Return the file of a fetched robot."""
    return next(path for path in sorted(FOLDER.rglob(f"{file}.urdf")) if "example-robot-data" in str(path))


def test_a_hand_on_an_arm():
    """The Allegro hand on a UR5, each from its own file, is Pinocchio's tree of one file with both."""
    arm, hand = real("ur5_robot"), real("allegro_right_hand")
    at = hf.Pose.translation(0.01, 0.02, 0.03)
    tips = {f"finger{k}": f"link_{4 * k + 3}.0_tip" for k in range(4)}
    found = load_urdf_trunk(hand, tips, floating=True, physical=False).mounted_on(hf.load_urdf(arm, tip="tool0"), at)
    weld = """<joint name="weld" type="fixed"><parent link="tool0"/><child link="palm_link"/>
        <origin xyz="0.01 0.02 0.03"/></joint>"""
    parts = [re.search(r"<robot[^>]*>(.*)</robot>", path.read_text(), re.DOTALL)[1] for path in (arm, hand)]
    both = f'<robot name="both">{parts[0]}{parts[1]}{weld}</robot>'
    differs = trunk_gaps(both, found, tips, hf.HeldObject.box(0.1, 0.05, 0.05, 0.05), "ball")
    print("UR5 with Allegro hand " + "  ".join(f"{gap:.1e}" for gap in differs))
    assert max(differs) <= TOLERANCE


def loaded(file: str, links: tuple[str, str], *, floating: bool) -> tuple[ArmsOnTrunk, dict[str, str]]:
    """Return a robot that stands or floats, all but its arms held, and the links of its tips."""
    tips = dict(zip(("left", "right"), links, strict=True))
    return load_urdf_trunk(real(file), tips, floating=floating, lock_others=True, physical=False), tips


@pytest.mark.parametrize("floating", [False, True], ids=["standing", "floating"])
@pytest.mark.parametrize(
    ("file", "links", "shared"), ROBOTS_WITH_TRUNKS, ids=[robot[0] for robot in ROBOTS_WITH_TRUNKS]
)
def test_arms_on_their_trunk(file, links, shared, floating):
    """Frames, masses, and dynamics with a tray in both hands, the trunk's joints and a floating base included."""
    if not floating and not shared:
        with pytest.raises(hf.errors.SceneError, match="expected a joint that moves two of the arms, got none"):
            loaded(file, links, floating=floating)
        return
    found, tips = loaded(file, links, floating=floating)
    assert tuple(joint.name for joint in found.trunk.joints) == shared
    differs = trunk_gaps(real(file).read_text(encoding="utf-8"), found, tips)
    print(f"{file:30s} {'floating' if floating else 'standing'} " + "  ".join(f"{gap:.1e}" for gap in differs))
    assert max(differs) <= TOLERANCE


@pytest.mark.parametrize(("file", "links", "floating"), ON_A_TRUNK)
def test_closed_through_a_tray(file, links, floating):
    """Trunk, base, arms, tray and hands' wrenches in random closed states are those of `constraintDynamics`."""
    found, tips = loaded(file, links, floating=floating)
    xml = real(file).read_text(encoding="utf-8")
    worst = [
        max(gap) for gap in zip(*(closed_gaps(xml, found, tips, seed) for seed in range(TRUNK_STATES)), strict=True)
    ]
    print(f"{file:30s} {'floating' if floating else 'standing'} " + "  ".join(f"{gap:.1e}" for gap in worst))
    assert max(worst) <= TOLERANCE


def test_all_joints_free():
    """Every robot that Pinocchio reads, fingers and mimic joints free: accelerations agree, or it is refused by name.

    Where Pinocchio's articulated bodies and its mass matrix differ by more, as for links that almost have no inertia,
    ten times as much is allowed.
    """
    found = [one for path in free_robots.files(FOLDER) if (one := free_robots.compare(path)) is not None]
    loaded = [one for one in found if not one.refusal]
    assert all(NAMED.match(one.refusal) or "no inertia beyond" in one.refusal for one in found if one.refusal)
    assert len(loaded) >= 150 and sum(one.mimic > 0 for one in loaded) >= 30
    assert [one for one in loaded if one.gap > max(free_robots.BAR, 10 * one.own)] == []


@pytest.mark.parametrize("file", free_robots.CARRIERS)
def test_a_tray_with_free_grippers(file):
    """Trunk, arms, free grippers and tray: the elimination agrees with dense equations, and forces are unique."""
    differs, chain, status = free_robots.tray_gap(real(file), free_robots.CARRIERS[file])
    print(f"{file:30s} {chain.joint_count} joints, {len(chain.all_couplings)} mimic, {differs:.1e}")
    assert status == "OK" and differs <= TOLERANCE
