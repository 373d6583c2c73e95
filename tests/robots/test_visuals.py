"""Solids for a viewer: plain data that follows the robot's shape."""

import numpy as np
import pytest

from holdfast import Arm, Joint, Link, Pose
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.errors import ModelError, SceneError
from holdfast.model.visuals import Box, Capsule, Cylinder, Mesh, Sphere
from holdfast.robots import HOME, ROBOTS, stewart_platform, three_finger_hand
from holdfast.robots.primitive import LINK_COLOURS, Primitive, rod, sphere
from holdfast.robots.urdf import urdf_chain, urdf_visuals
from holdfast.robots.visuals import visuals_of
from tests.robots.two_armed import TWO_ARMED


def frames(arm, q):
    """Return the poses of base and links in the world."""
    at = forward_kinematics(arm, q)
    found, p = [arm.base], arm.base.p
    for k, R in enumerate(at.R):
        p = p + found[-1].R @ at.l[k]
        found.append(Pose(R, p))
    return found


@pytest.mark.parametrize("name", ROBOTS)
def test_built_in_robots(name):
    """A list for the base and for each link; every joint and the flange lie in or near a solid."""
    arm = ROBOTS[name]()
    visuals = visuals_of(arm)
    assert len(visuals) == arm.joint_count + 1
    assert all(solids for solids in visuals)
    at = frames(arm, HOME[name])
    points = []
    for frame, solids in zip(at, visuals, strict=True):
        for solid in solids:
            half = 0.5 * solid.size[1] if solid.kind in ("capsule", "cylinder") else 0.0
            points += [frame @ solid.pose @ Pose.translation(0.0, 0.0, s) for s in (-half, 0.0, half)]
    for target in (*(frame.p for frame in at[1:]), forward_kinematics(arm, HOME[name]).tip.p):
        assert min(np.linalg.norm(point.p - target) for point in points) < 0.2
    lowest = min(float(point.p[2]) for point in points)
    assert lowest > -0.1


def test_drawn_from_kinematics():
    """Rods end at the next joint or the tip; drums stand on their axes; sizes go with the arm."""
    axis = np.array([0.6, 0.0, 0.8])
    turning = Joint(axis=axis, placement=Pose.translation(0.0, 0.0, 0.3))
    sliding = Joint("prismatic", placement=Pose.translation(0.5, 0.0, 0.0))
    arm = Arm([turning, sliding], [Link(1.0, inertia=np.eye(3))] * 2, Pose.translation(0.0, 0.2, 0.0))
    base, first, second = visuals_of(arm)
    assert [solid.kind for solid in base] == ["capsule", "box"]
    (link, drum), (last, bar, hand) = first, second
    assert link.pose.p == pytest.approx([0.25, 0.0, 0.0])
    assert np.abs(link.pose.R[:, 2]) == pytest.approx([1.0, 0.0, 0.0])
    assert link.size[1] == pytest.approx(0.5)
    assert drum.pose.R[:, 2] == pytest.approx(axis)
    assert bar.size[1] > drum.size[1] * 0.5
    assert last.pose.p == pytest.approx([0.0, 0.1, 0.0])
    assert hand.pose.p == pytest.approx([0.0, 0.2, 0.0])
    longer = Arm([Joint(), Joint(placement=Pose.translation(2.0, 0, 0))], arm.links, Pose.translation(2.0, 0, 0))
    assert visuals_of(longer)[1][0].size[0] > 2 * link.size[0]


def test_any_arm_can_be_drawn():
    """Legs, fingers, and an arm without any length."""
    for parts in (stewart_platform(), three_finger_hand()):
        for arm in parts.arms.values():
            assert len(visuals_of(arm)) == arm.joint_count + 1
    assert len(visuals_of(Arm([Joint()], [Link(1.0, inertia=np.eye(3))]))) == 2


def test_rod_stands_between_its_ends():
    """Its z axis runs from one to the other."""
    one, other = np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.2, -0.1])
    solid = rod("cylinder", one, other, 0.05, "accent")
    half = 0.5 * solid.size[1] * solid.pose.R[:, 2]
    assert solid.pose.p - half == pytest.approx(one)
    assert solid.pose.p + half == pytest.approx(other)
    assert solid.colour in LINK_COLOURS


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Primitive("cone", Pose.identity(), (1, 1)), "kind: expected one of"),
        (lambda: Primitive("box", Pose.identity(), (1, 1)), "size of a box: expected shape"),
        (lambda: Primitive("sphere", Pose.identity(), (-1,)), "expected lengths > 0"),
        (lambda: sphere((0, 0, 0), 1.0, "pink"), "no colour 'pink'"),
        (lambda: rod("capsule", (1, 1, 1), (1, 1, 1), 0.1), "expected two points"),
    ],
)
def test_refused(make, message):
    """A solid that cannot be drawn is refused."""
    with pytest.raises(ModelError, match=message):
        make()


ARM = {"base": "torso", "tip": "left_grasp", "lock_others": True}


def shown(text: str = TWO_ARMED, **options):
    """Return the visuals of an arm."""
    return urdf_visuals(urdf_chain(text, **{**ARM, **options}))


def test_one_list_a_body():
    """Base, then arm links; welded links' shapes stand in the arm link's frame."""
    base, upper, lower, hand = shown()
    assert [visual.link for visual in base] == ["torso"]
    assert base[0].shape == Box((0.3, 0.2, 0.4)) and base[0].rgba == (0.5, 0.5, 0.5, 1.0)
    np.testing.assert_allclose(base[0].pose.p, [0.0, 0.0, 0.2])
    assert upper[0].shape == Cylinder(0.05, 0.3) and upper[0].rgba is None
    assert lower == ()
    assert hand[0].shape == Mesh("package://two_armed/finger.stl", (1.0, -1.0, 1.0))
    np.testing.assert_allclose(hand[0].pose.p, [0.0, -0.01, 0.06], atol=1e-15)  # held at 0.01 along its turned y


def test_shapes():
    """Every primitive of the format."""
    for given, shape in {
        '<sphere radius="0.1"/>': Sphere(0.1),
        '<capsule radius="0.1" length="0.2"/>': Capsule(0.1, 0.2),
        '<mesh filename="a.dae"/>': Mesh("a.dae", (1.0, 1.0, 1.0)),
    }.items():
        assert shown(TWO_ARMED.replace('<box size="0.3 0.2 0.4"/>', given))[0][0].shape == shape


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("", r"link 'torso', visual, geometry: expected one of box, .*, got 0 of them"),
        ('<box size="1 2"/>', "geometry, box: size: expected 3 numbers"),
        ('<sphere radius="-1"/>', "sphere: radius: expected >= 0"),
        ("<mesh/>", "mesh: filename: expected a file name, got no such attribute"),
    ],
)
def test_shapes_that_are_none(given, said):
    """A picture's fault is told when the picture is asked for, and not before."""
    text = TWO_ARMED.replace('<box size="0.3 0.2 0.4"/>', given)
    chain = urdf_chain(text, **ARM)
    with pytest.raises(SceneError, match=said):
        urdf_visuals(chain)


def test_colours_by_name():
    """A material that is defined in one place colours all that name it; its own colour goes first."""
    own = '<material name="grey"><color rgba="1 0 0 1"/></material>'
    text = TWO_ARMED.replace('<material name="grey"/>', own)
    assert shown(text)[0][0].rgba == (1.0, 0.0, 0.0, 1.0)
    assert shown(TWO_ARMED.replace('<material name="grey"/>', '<material name="blue"/>'))[0][0].rgba is None
