"""Arms out of a URDF: geometry, welding, holding, mounting, and every value that the file gives."""

import math
import re

import numpy as np
import pytest

from holdfast import Pose
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.errors import SceneError
from holdfast.robots.urdf import load_urdf, load_urdf_arms, read_urdf, urdf_chain, urdf_chains, urdf_tree
from holdfast.spatial import rotation
from tests.robots.arm_dynamics import mass_jacobian_bias
from tests.robots.two_armed import TWO_ARMED

LEFT = {"base": "torso", "tip": "left_grasp", "lock_others": True}
WAYS = [
    ("base", "left_grasp"),
    ("torso", "right_grasp"),
    ("left_upper", "left_finger1_link"),
    ("left_grasp", "torso"),
    ("left_hand", "right_hand"),
    ("head", "left_box"),
    ("left_box", "torso"),
]


def test_springs():
    """A spring as SDF names it, read from the joint's dynamics, along the joint's own sign."""
    text = TWO_ARMED.replace('damping="0.5"', 'damping="0.5" spring_stiffness="40" spring_reference="-0.2"', 1)
    for ends in (LEFT, {"base": "left_grasp", "tip": "torso", "lock_others": True}):
        joints = load_urdf(text, **ends).joints
        assert [(j.stiffness, j.rest) for j in joints if j.name == "left_shoulder"] == [(40.0, -0.2)]
        assert not any(j.stiffness for j in joints if j.name != "left_shoulder")


@pytest.mark.parametrize(("base", "tip"), WAYS)
def test_agrees_with_pinocchio(base, tip):
    """M, J and bias of arms down, up, and over the torso, side branches held: <= 1e-12."""
    pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")
    from tests.robots.pinocchio_urdf import Models

    rng = np.random.default_rng(1)
    chain = urdf_chain(TWO_ARMED, base=base, tip=tip, lock_others=True, locked={"left_finger1": 0.03})
    q, qd = rng.uniform(-1, 1, (2, chain.arm.joint_count))
    expected = Models(TWO_ARMED).mass_jacobian_bias(chain, q, qd)
    for ours, theirs in zip(mass_jacobian_bias(chain.arm, q, qd), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12 * np.abs(theirs).max(), rtol=0)


def test_values():
    """Limits, damping and friction as the file says; axes of unit length; right angles exact; a rate of 0 is none."""
    arm = load_urdf(TWO_ARMED, **LEFT)
    for tip in ("left_grasp", "right_grasp"):
        R = load_urdf(TWO_ARMED, base="torso", tip=tip, lock_others=True).joints[0].placement.R
        assert set(np.abs(R).ravel()) == {0.0, 1.0} and not np.signbit(R[R == 0]).any()
    shoulder, elbow, slide = arm.joints
    assert arm.name == "two_armed"
    assert [link.name for link in arm.links] == ["left_upper", "left_lower", "left_hand"]
    assert (shoulder.name, shoulder.kind, slide.kind) == ("left_shoulder", "revolute", "prismatic")
    assert (shoulder.position_limits, shoulder.rate_limit, shoulder.effort_limit) == ((-2.0, 2.5), 2.0, 80.0)
    assert (shoulder.damping, shoulder.friction, elbow.damping) == (0.5, 0.1, 0.0)
    assert elbow.rate_limit == math.inf and elbow.effort_limit == 60.0
    np.testing.assert_array_equal(shoulder.axis, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(slide.axis, np.array([0.0, 0.1, 1.0]) / math.hypot(0.1, 1.0), rtol=1e-15)
    neck = load_urdf(TWO_ARMED, base="torso", tip="head").joints[0]
    assert (neck.kind, neck.position_limits, neck.effort_limit) == ("revolute", (-math.inf, math.inf), 5.0)


def test_welding_adds_up():
    """A box that is fixed to a link adds its mass, and moves the mass centre by the lever rule."""
    upper = load_urdf(TWO_ARMED, **LEFT).links[0]
    assert upper.mass == 3.5
    np.testing.assert_allclose(upper.com, (3 * np.array([0, 0.02, 0.15]) + 0.5 * np.array([0.05, 0, 0.1])) / 3.5)
    bare = load_urdf(TWO_ARMED.replace('<mass value="0.5"/>', '<mass value="0"/>'), **LEFT).links[0]
    assert np.trace(upper.inertia) > np.trace(bare.inertia)


def test_held_joint_is_a_fixed_joint():
    """Holding a joint at q is what a fixed joint at that place does."""
    held = load_urdf(TWO_ARMED, base="base", tip="left_grasp", lock_others=True, locked={"lift": 0.2})
    text = TWO_ARMED.replace('name="lift" type="prismatic"', 'name="lift" type="fixed"').replace(
        "0 0 0.4", "0 0 0.6", 1
    )
    fixed = load_urdf(text, base="base", tip="left_grasp", lock_others=True)
    q, qd = np.array([0.3, 0.7, 0.1]), np.array([1.0, -2.0, 0.5])
    for a, b in zip(mass_jacobian_bias(held, q, qd), mass_jacobian_bias(fixed, q, qd), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-13)


def test_held_joints_and_those_that_mimic_them():
    """A finger that mimics a held one is held with it; others at 0, or at the limit nearest to it."""
    given = urdf_chain(TWO_ARMED, base="torso", tip="left_hand", locked={"left_finger1": 0.03})
    assert given.locked == {"left_finger1": 0.03, "left_finger2": 0.03}
    assert given.arm.links[-1].mass == pytest.approx(1.0)
    others = urdf_chain(TWO_ARMED, **LEFT)
    assert others.locked == {"left_finger1": 0.01, "left_finger2": 0.01}
    both = urdf_chain(TWO_ARMED, tip="left_hand", base="torso", locked={"left_finger1": 0.03, "left_finger2": 0.0})
    assert both.locked == {"left_finger1": 0.03, "left_finger2": 0.0}


def test_what_becomes_of_every_link():
    """Each link is welded somewhere or named as elsewhere; poses agree with the arm's."""
    chain = urdf_chain(TWO_ARMED, base="torso", tip="left_grasp", lock_others=True)
    named = [name for links in chain.bodies for name in links]
    assert sorted([*named, *chain.elsewhere]) == sorted(chain.robot.links)
    assert list(chain.bodies[1]) == ["left_upper", "left_box"]
    np.testing.assert_allclose(chain.bodies[3]["left_grasp"].p, chain.arm.tip.p)
    assert {"base", "head", "right_upper"} <= set(chain.elsewhere)
    assert any("velocity: 0, taken as unlimited" in note for note in chain.notes)
    assert any("'left_grasp': no <inertial>, taken as massless" in note for note in chain.notes)
    assert not any("right_" in note for note in chain.notes)


def test_base_and_tip_by_default():
    """The root and the only end; several ends are listed with where they part."""
    chain = urdf_chain(_serial(2))
    assert (chain.base, chain.tip, chain.arm.joint_count) == ("l0", "l2", 2)
    with pytest.raises(SceneError, match=r"several ends .*'left_finger1_link' \(5\).* they part at 'torso' \(1\)"):
        load_urdf(TWO_ARMED)
    with pytest.raises(SceneError, match="try tip='left_hand'"):
        load_urdf(TWO_ARMED, base="left_upper")


def test_two_arms_stand_where_the_robot_has_them():
    """Each arm of the robot is the arm loaded alone from the root; the mount moves both."""
    mount = Pose(rotation.exp(np.array([0.1, -0.2, 0.3])), np.array([1.0, 2.0, 3.0]))
    pair = {"left": ("torso", "left_grasp"), "right": ("right_upper", "right_grasp")}
    locked = {"lift": 0.25, "right_shoulder": 0.4}
    arms = load_urdf_arms(TWO_ARMED, pair, locked=locked, lock_others=True, mount=mount)
    assert [arm.joint_count for arm in arms.values()] == [3, 2]
    for side, q in (("left", [0.1, 0.2, 0.15]), ("right", [0.2, 0.15])):
        alone = load_urdf(TWO_ARMED, tip=f"{side}_grasp", locked=locked, lock_others=True, mount=mount)
        tip, expected = forward_kinematics(arms[side], np.array(q)).tip, forward_kinematics(alone, np.array(q)).tip
        np.testing.assert_allclose(tip.p, expected.p, atol=1e-14)
        np.testing.assert_allclose(tip.R, expected.R, atol=1e-14)


def test_shared_joints():
    """A joint that moves both arms, or an arm's base, or hangs one on the other, is refused by name."""
    pair = {"left": ("base", "left_grasp"), "right": ("base", "right_grasp")}
    with pytest.raises(SceneError, match="joint 'lift': moves both arm 'left' and arm 'right'; try locked=") as refused:
        load_urdf_arms(TWO_ARMED, pair, lock_others=True)
    assert len(load_urdf_arms(TWO_ARMED, pair, lock_others=True, locked=locks_to_try(refused.value))) == 2
    chained = {"a": ("torso", "left_upper"), "b": ("left_upper", "left_grasp")}
    with pytest.raises(SceneError, match="'left_shoulder': moves the base 'left_upper' of arm 'b'"):
        load_urdf_arms(TWO_ARMED, chained, locked={"lift": 0.0})


# a robot whose arms stand on a torso of two joints, as many humanoids' do; the second one cannot be at 0
WAIST = """<link name="waist"/>
  <joint name="bow" type="revolute">
    <parent link="waist"/> <child link="torso"/> <axis xyz="0 1 0"/>
    <limit lower="0.1" upper="0.5" effort="50" velocity="1"/>
  </joint>
  <link name="torso">"""
ON_A_TORSO = TWO_ARMED.replace('<child link="torso"/>', '<child link="waist"/>').replace('<link name="torso">', WAIST)
SIDES = {side: ("torso", f"{side}_grasp") for side in ("left", "right")}


def locks_to_try(refusal: SceneError) -> dict[str, float]:
    """Return the `locked=` that a refusal says to try."""
    found = re.search(r"try locked=({.*?})", str(refusal))
    assert found, refusal
    return eval(found[1])


def test_everything_that_moves_is_refused_at_once():
    """One refusal lists the torso's joints and the fingers, and what it says to try serves."""
    with pytest.raises(SceneError) as refused:
        load_urdf_arms(ON_A_TORSO, SIDES)
    said = str(refused.value)
    base = "moves the base 'torso' of arm 'left' and the base 'torso' of arm 'right', as does 'bow'"
    assert said.startswith("URDF text:5: joint 'lift': " + base)
    assert said.endswith("or lock_others=True")
    wanted = {"lift": 0.0, "bow": 0.1, "left_finger1": 0.01, "right_finger1": 0.01}
    assert locks_to_try(refused.value) == wanted
    arms = load_urdf_arms(ON_A_TORSO, SIDES, locked=wanted)
    assert [arm.joint_count for arm in arms.values()] == [3, 3]


def test_lock_others_holds_the_torso():
    """Joints below the bases, which are on no arm's way, are held too, at 0 or the limit nearest to it, and noted."""
    chains = urdf_chains(ON_A_TORSO, SIDES, lock_others=True)
    held = load_urdf_arms(ON_A_TORSO, SIDES, lock_others=True, locked={"lift": 0.0, "bow": 0.1})
    for name, chain in chains.items():
        assert (chain.arm.base.wxyz_xyz == held[name].base.wxyz_xyz).all()
        assert "joint 'bow': locked at 0.1, since it moves the base 'torso'" in "".join(chain.notes)
    lifted = load_urdf_arms(ON_A_TORSO, SIDES, lock_others=True, locked={"lift": 0.2})
    assert (lifted["left"].base.p - held["left"].base.p).tolist() == pytest.approx([0.0, 0.0, 0.2])
    floating = TWO_ARMED.replace('name="lift" type="prismatic"', 'name="lift" type="floating"')
    with pytest.raises(SceneError, match="expected a joint that can be locked, since it moves the base 'torso' of arm"):
        load_urdf_arms(floating, SIDES, lock_others=True)


def test_listing():
    """One line a link, with the joint that moves it and its limits."""
    lines = urdf_tree(read_urdf(TWO_ARMED)).splitlines()
    assert lines[:2] == ["base", "  torso   lift: prismatic, 0 to 0.3 m, 0.1 m/s, 500 N"]
    assert len(lines) == len(read_urdf(TWO_ARMED).links)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "iso-8859-1"])
def test_encodings(tmp_path, encoding):
    """A file is read in the encoding that it declares."""
    declared = encoding.removesuffix("-sig")
    path = tmp_path / "r.urdf"
    path.write_bytes(TWO_ARMED.replace("UTF-8", declared).replace("left_hand", "h\u00e4nd").encode(encoding))
    assert load_urdf(path, base="torso", tip="h\u00e4nd", lock_others=True).joint_count == 3


def test_long_chain():
    """1,100 joints in a row: no recursion runs out."""
    assert urdf_chain(_serial(1100)).arm.joint_count == 1100


def test_physical():
    """An inertia that no body has is refused with its line and the way round, which works."""
    text = TWO_ARMED.replace('izz="0.003"', 'izz="0.3"', 1)
    with pytest.raises(SceneError, match=r":\d+: link 'left_lower', inertial: inertia: .*try physical=False to accept"):
        load_urdf(text, **LEFT)
    assert not load_urdf(text, **LEFT, physical=False).links[1].physical


def test_rounding_for_an_inertia_is_zero():
    """A radius of gyration of some nanometres is an exporter's rounding, and noted."""
    moments = 'ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.003"'
    text = TWO_ARMED.replace(moments, 'ixx="0" ixy="0" ixz="2e-20" iyy="0" iyz="0" izz="0"', 1)
    chain = urdf_chain(text, **LEFT)
    np.testing.assert_array_equal(chain.arm.links[1].inertia, np.zeros((3, 3)))
    assert any("inertia up to 2e-20 kg m^2, taken as 0" in note for note in chain.notes)


def _serial(count: int) -> str:
    """Return a chain of so many hinges."""
    inertial = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    links = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="0 0 1"/>'
        f'<axis xyz="0 1 0"/></joint><link name="l{k}">{inertial}</link>'
        for k in range(1, count + 1)
    )
    return f'<robot name="serial"><link name="l0"/>{links}</robot>'
