"""Real robots (`make robots`): which way their tips point, and configurations for whatever they can reach."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.model.tip_direction import tip_advice, tip_angle
from holdfast.robots import ROBOTS
from holdfast.robots.urdf import UrdfChain, urdf_chain
from tests.acceptance.test_real_robots import FOLDER
from tests.systems.problems import largest_gaps

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

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not any(FOLDER.rglob("ur5_robot.urdf")), reason="no robots fetched: make robots"),
]


def real(file: str, base: str | None, tip: str) -> UrdfChain:
    """Return an arm of a fetched robot, its fingers held."""
    path: Path = next(path for path in sorted(FOLDER.rglob(f"{file}.urdf")) if "example-robot-data" in str(path))
    return urdf_chain(path, base=base, tip=tip, lock_others=True, physical=False)


@pytest.mark.parametrize(("file", "base", "tip", "angle"), TIPS, ids=lambda part: str(part))
def test_which_way_it_points(file, base, tip, angle):
    """The angle; and the suggested turn brings z to the way within 10 degrees."""
    chain = real(file, base, tip)
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
    arm = ROBOTS[robot]() if isinstance(robot, str) else real(*robot).arm
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
