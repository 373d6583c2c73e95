"""Scenes whose arms stand on a trunk: the chain that the library's own constructors give, closed; what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import closure
from holdfast.model.fingerprint import fingerprint
from holdfast.scenario.build import load_scene
from tests.robots.two_armed import TWO_ARMED
from tests.scenario.test_build import loaded, refusal
from tests.systems.problems import largest_gaps

TORSO = """
gravity = [0, 0, -9.81]
simulation = { duration = 0.02, step = 0.005 }
object = { mass = 3, box = [0.3, 0.5, 0.1], pose = { position = [0.5, 0.05, 0.9], rpy = [0, 0, 0.1] } }

[trunk]
base = { position = [0, 0, 0.1], rpy = [0, 0, 0.2] }
q = [0.1, 0.2]

[[trunk.joints]]
name = "lift"
kind = "prismatic"
position_limits = [0, 0.4]
armature = 2.0
link = { name = "column", mass = 15, box = [0.2, 0.2, 0.6], com = [0, 0, 0.1] }

[[trunk.joints]]
name = "waist"
position = [0, 0, 0.3]
effort_limit = 300
damping = 4
stiffness = 50
rest = 0.2
link = { name = "chest", mass = 12, com = [0, 0, 0.2], inertia = [[0.4, 0, 0], [0, 0.3, 0], [0, 0, 0.2]] }

[[arms]]
name = "left"
robot = "panda"
mount = "chest"
base = { position = [0, 0.3, 0] }

[[arms]]
name = "right"
robot = "panda"
mount = 1
base = { position = [0, -0.3, 0] }

[[grasps]]
arm = "left"
kind = "rigid"
position = [0, 0.2, 0.05]
rpy = [3.141592653589793, 0, 0]

[[grasps]]
arm = "right"
kind = "ball"
position = [0, -0.2, 0.05]
rpy = [3.141592653589793, 0, 0]
"""
MOVING = """[trunk]
floating = { mass = 200, box = [1, 1, 1] }
twist = [0.01, 0.02, -0.03, 0.1, 0.05, 0]"""
FLYER = TORSO.replace("[trunk]", MOVING).replace("box = [0.3,", "twist = [0, 0, 0.1, 0.2, 0, 0], box = [0.3,")


def test_joints_and_mounts(tmp_path):
    """The chain is the one that Trunk, Joint and Link give by hand; object and trunk stand where the file says."""
    found = loaded(tmp_path, TORSO)
    lift = hf.Joint("prismatic", name="lift", position_limits=(0, 0.4), armature=2.0)
    waist = hf.Joint(
        "revolute", placement=hf.Pose.translation(0, 0, 0.3), name="waist", effort_limit=300, damping=4, stiffness=50,
        rest=0.2,
    )  # fmt: skip
    column = hf.Link(15, [0, 0, 0.1], hf.HeldObject.box(15, 0.2, 0.2, 0.6).inertia, "column")
    chest = hf.Link(12, [0, 0, 0.2], np.diag([0.4, 0.3, 0.2]), "chest")
    trunk = hf.Trunk([lift, waist], [column, chest], hf.Pose.from_rpy(0, 0, 0.2, [0, 0, 0.1]))
    arms = {name: hf.robots.panda(hf.Pose.translation(0, y, 0)) for name, y in (("left", 0.3), ("right", -0.3))}
    down = hf.Pose.from_rpy(np.pi, 0, 0)
    grasps = {
        name: hf.Grasp(kind, hf.Pose(down.R, [0, y, 0.05]))
        for name, kind, y in (("left", "rigid", 0.2), ("right", "ball", -0.2))
    }
    chain = hf.ClosedChain(
        arms, hf.HeldObject.box(3, 0.3, 0.5, 0.1), grasps, trunk=trunk, mounts={"left": "chest", "right": 1}
    )
    assert fingerprint(chain) == fingerprint(found.chain)
    state, tau = found.state, np.linspace(-1, 1, 16)
    theirs, ours = (hf.forward_dynamics(c, state, tau) for c in (found.chain, chain))
    assert np.array_equal(theirs.qdd, ours.qdd)
    assert state.q[:2].tolist() == [0.1, 0.2]
    assert state.object_pose[4:].tolist() == [0.5, 0.05, 0.9]
    assert largest_gaps(closure(found.chain, state))[0] < 1e-10
    assert not found.controller(0.3, state, None)[0].any()


def test_floating(tmp_path):
    """A free body below the joints, which sets out with the twist given, and an object that the arms can follow."""
    found = loaded(tmp_path, FLYER)
    floating = found.chain.trunk.floating
    assert (floating.mass, floating.inertia[0, 0]) == (200.0, pytest.approx(200 / 6))
    assert found.state.base_pose == pytest.approx(hf.Pose.from_rpy(0, 0, 0.2, [0, 0, 0.1]).wxyz_xyz)
    assert found.state.base_twist == pytest.approx([0.01, 0.02, -0.03, 0.1, 0.05, 0], abs=1e-14)
    assert found.state.object_twist == pytest.approx([0, 0, 0.1, 0.2, 0, 0], abs=1e-14)
    assert largest_gaps(closure(found.chain, found.state)).max() < 1e-10
    assert found.state.qd[:2] == pytest.approx(0.0, abs=1e-14)


def test_base_alone(tmp_path):
    """A free body needs no joints; arms stand on it by the name "base"."""
    text = TORSO[: TORSO.index("[trunk]")] + "trunk = { floating = { mass = 200, box = [1, 1, 1] } }\n"
    text += TORSO[TORSO.index("[[arms]]") :].replace('"chest"', '"base"').replace("mount = 1", 'mount = "base"')
    chain = loaded(tmp_path, text.replace("0.05, 0.9]", "0.0, 0.5]")).chain
    assert chain.floats and chain.trunk.joint_count == 0 and dict(chain.mounts) == {"left": "base", "right": "base"}


def test_an_arm_below_a_hand(tmp_path):
    """A built-in robot is a trunk; its home is where it begins."""
    text = TORSO[: TORSO.index("[trunk]")] + 'trunk = { robot = "panda" }\n'
    text = text.replace(
        "pose = { position = [0.5, 0.05, 0.9], rpy = [0, 0, 0.1] }", "pose = { position = [0.55, 0, 0.4] }"
    )
    finger = '[[arms]]\nname = "f{k}"\nmount = 6\njoints = [{joints}]\ntip = {{ position = [0, 0, 0.05] }}\n'
    joint = "{{ axis = [{axis}], position = [{at}], link = {{ mass = 0.1, box = [0.01, 0.01, 0.01] }} }}"
    joints = ", ".join(joint.format(axis=a, at=p) for a, p in (("0, 1, 0", "0.05, 0, 0.1"), ("1, 0, 0", "0, 0, 0.05")))
    found = loaded(tmp_path, text + finger.format(k=1, joints=joints))
    assert found.state.q[:7] == pytest.approx(hf.robots.HOME["panda"])
    arm = found.chain.arms["f1"]
    assert [j.placement.p.tolist() for j in arm.joints] == [[0.05, 0, 0.1], [0, 0, 0.05]]
    assert arm.tip.p.tolist() == [0, 0, 0.05]


def test_out_of_one_file(tmp_path):
    """Trunk and arms of a URDF file as `load_urdf_trunk` reads them, with drives; tools and guesses of the scene."""
    (tmp_path / "two.urdf").write_text(TWO_ARMED)
    tips = {"left": "left_grasp", "right": "right_grasp"}
    text = """
simulation = { duration = 0.02, step = 0.005 }
object = { mass = 2, box = [0.3, 0.3, 0.3], pose = { position = [0, 0, 3] } }
[trunk]
base = { position = [0, 0, 0.5] }
q = [0.1]
urdf = { file = "two.urdf", lock_others = true, TIPS, armature = { lift = 3, right_elbow = 0.25 } }
[[arms]]
name = "right"
tip = { position = [0, 0, 0.02] }
[[arms]]
name = "left"
q = [0.1, 0.2, 0.1]
""".replace("TIPS", f'tips = {{ left = "{tips["left"]}", right = "{tips["right"]}" }}')
    found = loaded(tmp_path, text)
    by_hand = hf.load_urdf_trunk(TWO_ARMED, tips, lock_others=True, mount=hf.Pose.translation(0, 0, 0.5))
    chain = found.chain
    kinds = ("shoulder", "elbow", "slide")
    of_arms = [f"{side}/{side}_{joint}" for side in ("right", "left") for joint in kinds]
    assert chain.joint_names() == ["trunk/lift", *of_arms]
    assert dict(chain.mounts) == dict(by_hand.mounts) and chain.trunk.base.p.tolist() == [0, 0, 0.5]
    assert chain.trunk.joints[0].armature == 3 and chain.arms["right"].joints[1].armature == 0.25
    assert chain.arms["left"].joints[1].armature == 0.0
    assert chain.arms["right"].tip.p == pytest.approx((by_hand.arms["right"].tip @ hf.Pose.translation(0, 0, 0.02)).p)
    assert chain.arms["left"].base.wxyz_xyz == pytest.approx(by_hand.arms["left"].base.wxyz_xyz)
    assert found.state.q[[0, 4, 5, 6]].tolist() == [0.1, 0.1, 0.2, 0.1]
    assert set(found.sources) == {"trunk", "left", "right"}
    assert [note.partition(":")[2] for note in found.notes] == [note.partition(":")[2] for note in by_hand.notes]
    for old, new, message in (
        ('left = "left', 'lift = "left', "$.trunk.urdf.tips: no arm 'lift'. Did you mean 'left'?"),
        ("lock_others", 'tip = "torso", lock_others', "$.trunk.urdf: expected tip or tips, got both"),
        ('name = "left"', 'name = "left"\nmount = "torso"', "$.arms[1].mount: expected none, as the arm is from"),
        ('name = "left"', 'name = "left"\nrobot = "panda"', "$.arms[1].robot: expected none, as the arm is from"),
        ("armature = { lift", "armature = { lit", "$.trunk.urdf.armature: no moving joint 'lit'. Did you mean 'lift'?"),
        ("lock_others = true, ", "", "$.trunk.urdf: "),
        ("[trunk]", "[trunk]\nfloating = { mass = 1, box = [1, 1, 1] }", "$.trunk.floating: expected none together"),
    ):
        assert old in text
        assert message in refusal(tmp_path / "bad.toml", text.replace(old, new, 1))


def test_one_file_of_the_trunk_alone(tmp_path):
    """Without tips of arms a file's joints from base to tip are the trunk; on a free body, if one is given."""
    (tmp_path / "two.urdf").write_text(TWO_ARMED)
    urdf = 'urdf = { file = "two.urdf", tip = "left_lower", lock_others = true, armature = { left_elbow = 0.5 } }'
    head, rest = TORSO[: TORSO.index("[trunk]")], '[[arms]]\nname = "a"\nrobot = "panda"\nmount = "left_lower"\n'
    head = head.replace("[0.5, 0.05, 0.9]", "[5, 5, 5]")
    chain = loaded(tmp_path, f"{head}[trunk]\n{urdf}\n{rest}").chain
    assert [joint.name for joint in chain.trunk.joints] == ["lift", "left_shoulder", "left_elbow"]
    assert chain.trunk.joints[2].armature == 0.5
    free = loaded(tmp_path, f"{head}[trunk]\nfloating = {{ mass = 9, box = [1, 1, 1] }}\n{urdf}\n{rest}")
    assert free.chain.floats and free.chain.trunk.joint_count == 3
    said = refusal(tmp_path / "bad.toml", f"{head}[trunk]\n{urdf.replace('tip =', 'floating = true, tip =')}\n{rest}")
    assert "$.trunk.urdf.floating: expected tips of arms with it, got none; try trunk.floating" in said


def test_swaying(tmp_path):
    """The base of a trunk in the world may sway, about where it stands."""
    sway = "base_motion = { shift = { amplitude = [0.1, 0, 0], frequency = [1, 0, 0] }, smooth_start = 0.01 }\n[[trunk."
    moving = loaded(tmp_path, TORSO.replace("[[trunk.", sway, 1)).options["base_motion"]
    pose, twist, _ = moving["trunk"](0.25)
    assert pose.p == pytest.approx([0.1, 0, 0.1])
    assert twist[3:] == pytest.approx(0, abs=1e-12)


REFUSED = [
    ('mount = "chest"', 'mount = "chst"', "$.arms[0].mount: expected a link of the trunk, by its name ('column',"),
    ("mount = 1", "mount = 2", "$.arms[1].mount: expected a link of the trunk"),
    ("mount = 1", "mount = 1\nbase_motion = {}", "$.arms[1].base_motion: expected none, as the arm is mounted"),
    ("[[arms]]", '[[arms]]\nname = "trunk"\nrobot = "panda"\n[[arms]]', "$.arms[0].name: 'trunk' is reserved"),
    ("q = [0.1, 0.2]", "q = [0.1]", "$.trunk.q: expected 2 joint positions for a trunk, got 1"),
    ("q = [0.1, 0.2]", "twist = [0, 0, 0, 0, 0, 1]", "$.trunk.twist: expected none, as the trunk's base is fixed"),
    ("q = [0.1, 0.2]", 'robot = "panda"', "$.trunk: expected one of robot, urdf and joints or floating, got robot and"),
    ("armature = 2.0", "armature = -2.0", "$.trunk.joints[0].armature: expected >= 0"),
    ("box = [0.2, 0.2, 0.6], ", "", "$.trunk.joints[0].link: expected box, sphere, cylinder or inertia, got none"),
    ("[[trunk.joints]]", "floating = { mass = 0 }\n[[trunk.joints]]", "$.trunk.floating.mass: expected > 0, since"),
    ('name = "waist"', 'name = "lift"', "$.trunk.joints[1].name: 'lift' is already used at $.trunk.joints[0].name"),
    ('name = "chest"', 'name = "a/b"', "$.trunk.joints[1].link.name: expected 1 to 64 letters"),
    ("mass = 12", "mass = -12", "$.trunk.joints[1].link.mass: expected > 0"),
    ("position_limits = [0, 0.4]", "position_limits = [1, 0.4]", "$.trunk.joints[0].position_limits: expected lower"),
    ('kind = "prismatic"', 'kind = "floating"', "$.trunk.joints[0].kind: Invalid enum value 'floating'"),
    ("[[trunk.joints]]", "floating = { mass = 1, box = [1, 1, 1] }\nbase_motion = {}\n[[trunk.joints]]",
     "$.trunk.base_motion: expected none, as the trunk's base floats; try twist"),
    ("box = [0.3, 0.5, 0.1],", "box = [0.3, 0.5, 0.1], twist = [9e8, 0, 0, 0, 0, 0, 0],", "$.object.twist: Expected"),
    ("[[grasps]]", 'springs = [{ a = { body = "world" }, b = { body = "object" }, stiffness = 1 }]\n[[grasps]]',
     "unknown field `springs`"),
    ("gravity =", 'springs = [{ a = { body = "trunk", link = 9 }, b = { body = "object" }, stiffness = 1 }]\ngravity =',
     "$.springs[0]: point on 'trunk': expected a link of the trunk"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), REFUSED)
def test_refusals(old, new, message, tmp_path):
    """One line that names the place and what is wrong there."""
    assert old in TORSO
    assert message in refusal(tmp_path / "bad.toml", TORSO.replace(old, new, 1))


def test_mount_without_a_trunk(tmp_path):
    """It is refused, not passed over."""
    text = TORSO[: TORSO.index("[trunk]")] + TORSO[TORSO.index("[[arms]]") :]
    assert "$.arms[0].mount: expected none, as the scene has no trunk" in refusal(tmp_path / "bad.toml", text)


def test_a_motion_that_arms_cannot_follow(tmp_path):
    """Two joints cannot carry a body that moves in all six ways."""
    text = """
simulation = { duration = 0.02, step = 0.005 }
object = { mass = 1, box = [0.1, 0.1, 0.1], pose = { position = [0, 0, 0.5] }, twist = [0, 0, 0, 0, 0, 1] }
grasps = [{ arm = "a", kind = "rigid" }]
[[arms]]
name = "a"
joints = [{ axis = [0, 1, 0], link = { mass = 1, box = [0.1, 0.1, 0.5] } }]
tip = { position = [0, 0, 0.5] }
"""
    said = refusal(tmp_path / "bad.toml", text)
    assert "$.object.twist: expected a motion of object and trunk that the arms can follow: the state does not" in said
    (tmp_path / "good.toml").write_text(text.replace("[0, 0, 0, 0, 0, 1]", "[0, 2, 0, 1, 0, 0]"))
    assert load_scene(tmp_path / "good.toml").state.qd == pytest.approx([2.0])
