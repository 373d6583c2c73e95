"""Arms that share joints come out of MJCF as the trunk that they stand on, as they do out of URDF."""

import numpy as np
import pytest

import holdfast as hf
from holdfast import load_urdf_trunk
from holdfast.interop import load_mjcf, load_mjcf_arms, load_mjcf_trunk, to_mjcf
from tests.interop.test_mjcf_writer import on_a_trunk
from tests.robots.test_urdf_trunk import FREE_FINGERS, HANDS, HEAVY_BASE

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")

WRITTEN = 1e-5  # relative: MuJoCo writes six digits
ROUND_TRIP = 1e-12
FINGERS = {"one": "left_finger1_link", "two": "left_finger2_link", "right": "right_grasp"}


def as_mjcf(urdf: str, free: str = "") -> str:
    """Return a URDF as MuJoCo reads and writes it, without what its equalities couple; body `free` floats."""
    spec = mujoco.MjSpec.from_string(urdf)
    spec.compiler.fusestatic = False
    for part in [*spec.geoms, *spec.meshes, *spec.equalities]:
        spec.delete(part)
    if free:
        spec.body(free).add_freejoint(name="free")
    spec.compile()
    return spec.to_xml()


def bodies_gap(ours, wanted):
    """Return the largest relative gap of masses, mass centres, inertias and joint frames."""
    pairs = [(a.placement.wxyz_xyz, b.placement.wxyz_xyz) for a, b in zip(ours.joints, wanted.joints, strict=True)]
    pairs += [(a.axis, b.axis) for a, b in zip(ours.joints, wanted.joints, strict=True)]
    for a, b in zip(ours.links, wanted.links, strict=True):
        pairs += [(a.mass, b.mass), (a.com, b.com), (a.inertia, b.inertia)]
    return max(np.abs(np.subtract(a, b)).max() / max(np.abs(b).max(), 0.1) for a, b in pairs)


@pytest.mark.parametrize("way", ["a torso", "held at a place", "on several links", "floating"])
def test_as_from_urdf(way):
    """Trunk, arms, mounts and held joints of a file that MuJoCo has translated."""
    urdf, tips = (FREE_FINGERS, FINGERS) if way == "on several links" else (HEAVY_BASE, HANDS)
    locked = {"lift": 0.2, "left_elbow": 0.5} if way == "held at a place" else {}
    wanted = load_urdf_trunk(urdf, tips, locked=locked, lock_others=True, floating=way == "floating")
    text = as_mjcf(urdf, "base" if way == "floating" else "")
    found = load_mjcf_trunk(text, tips, locked=wanted.locked)
    assert {name: found.trunk.body(m, name) for name, m in found.mounts.items()} == {
        name: wanted.trunk.body(m, name) for name, m in wanted.mounts.items()
    }
    assert found.locked == wanted.locked
    assert bodies_gap(found.trunk, wanted.trunk) < WRITTEN
    assert (found.trunk.floating is None) == (way != "floating")
    for name, arm in wanted.arms.items():
        ours = found.arms[name]
        assert [joint.name for joint in ours.joints] == [joint.name for joint in arm.joints]
        assert bodies_gap(ours, arm) < WRITTEN
        np.testing.assert_allclose(ours.base.wxyz_xyz, arm.base.wxyz_xyz, atol=WRITTEN)
        np.testing.assert_allclose(ours.tip.wxyz_xyz, arm.tip.wxyz_xyz, atol=WRITTEN)


def test_others_are_held_where_the_model_has_them():
    """`lock_others` holds a head and fingers."""
    found = load_mjcf_trunk(as_mjcf(HEAVY_BASE), HANDS, lock_others=True)
    assert found.locked == dict.fromkeys(
        ["neck", "left_finger1", "left_finger2", "right_finger1", "right_finger2"], 0.0
    )
    assert found.trunk.links[1].mass == pytest.approx(22.0)


@pytest.mark.parametrize(("seed", "floating"), [(9, False), (18, True)])
def test_round_trip(seed, floating):
    """`load_mjcf_trunk(to_mjcf(chain))` gives trunk, arms and mounts back, beside an arm in the world."""
    chain, state, tau = on_a_trunk(seed, 2, floating, "rigid")
    text = to_mjcf(chain, state)
    tips = {name: f"{name}/tip" for name in chain.arms}
    found = load_mjcf_trunk(text, tips)
    again = hf.ClosedChain(
        found.arms, chain.held_object, chain.grasps, trunk=found.trunk, mounts=found.mounts, gravity=chain.gravity
    )
    ours, wanted = (hf.forward_dynamics(one, state, tau) for one in (again, chain))
    np.testing.assert_allclose(ours.qdd, wanted.qdd, atol=ROUND_TRIP * np.abs(wanted.qdd).max())
    gap = np.abs(ours.grasp_wrench - wanted.grasp_wrench).max()
    assert gap <= ROUND_TRIP * np.abs(wanted.grasp_wrench).max()


def test_arms_alone():
    """Both arms of one file with the torso held are the arms that are loaded one by one."""
    text = as_mjcf(HEAVY_BASE)
    locked = {"lift": 0.2, "bow": 0.3}
    arms = {"left": ("torso", "left_grasp"), "right": ("torso", "right_grasp")}
    found = load_mjcf_arms(text, arms, locked=locked, lock_others=True, mount=hf.Pose.translation(1.0, 0.0, 0.0))
    from_world = {"left": ("world", "left_grasp"), "right": ("world", "right_grasp")}
    below = load_mjcf_arms(text, from_world, locked=locked, lock_others=True)
    for name, (base, tip) in arms.items():
        alone = load_mjcf(text, base=base, tip=tip, locked=locked, lock_others=True)
        assert found[name].joint_count == alone.joint_count == below[name].joint_count == 3
        np.testing.assert_allclose(found[name].base.p, np.add(alone.base.p, [1.0, 0.0, 0.0]), atol=1e-15)
        q = np.array([0.1, 0.2, 0.1])
        ours, whole = (hf.dynamics.tip_pose(arm, q).wxyz_xyz for arm in (alone, below[name]))
        np.testing.assert_allclose(ours, whole, atol=1e-15)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda x: load_mjcf_trunk(x, {"left": "left_grasp", "right": "left_hand"}), "no other arm, got none"),
        (lambda x: load_mjcf_trunk(x, "left_grasp"), "tips: expected sites or bodies by arm"),
        (lambda x: load_mjcf_trunk(x, HANDS), "joint 'neck' hangs on the arm"),
        (lambda x: load_mjcf_trunk(x, HANDS, base="torso"), "try load_mjcf_arms, or floating=True"),
        (lambda x: load_mjcf_trunk(x, HANDS, floating=True), "floating: .*got the world; try base="),
        (lambda x: load_mjcf_trunk(x, HANDS, base="base", floating=True, mount=hf.Pose.identity()), "mount: .*none"),
        (
            lambda x: load_mjcf_trunk(x, ["left_finger1_link", "left_finger2_link", "right_finger1_link",
                                          "right_finger2_link"]),
            "'right_shoulder' moves arms right_finger1_link, right_finger2_link, while 'left_shoulder' .*branches",
        ),
        (
            lambda x: load_mjcf_arms(x, {k: ("base", tip) for k, tip in HANDS.items()}),
            "'lift' moves both arm 'left' and arm 'right'; try locked.*load_mjcf_trunk",
        ),
        (
            lambda x: load_mjcf_arms(x, {k: ("torso", tip) for k, tip in HANDS.items()}),
            "'lift' moves the base of arm 'left'.*lock_others",
        ),
        (lambda x: load_mjcf_arms(x, {"left": "torso"}), "arm 'left': expected names of base and tip"),
        (lambda x: load_mjcf_arms(x, {}), "arms: expected"),
    ],
)  # fmt: skip
def test_refused_by_name(call, message):
    """What cannot be arms on one trunk says why, and what to try."""
    with pytest.raises(hf.errors.SceneError, match=message):
        call(as_mjcf(HEAVY_BASE))
