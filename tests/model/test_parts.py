"""Parts of a model: joints, links, objects, grasps and their kinds, arms and their notes, anchors."""

import ast
import dataclasses
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import holdfast
import holdfast as hf
from holdfast import Arm, Friction, Grasp, HeldObject, Joint, Link, Pose
from holdfast.model.fingerprint import fingerprint
from holdfast.model.grasp import WrenchLimits
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.model.joint_types import JOINT_TYPES
from holdfast.spatial import rotation
from tests.control.two_pandas import two_pandas
from tests.model.parts import arm, bar
from tests.systems.problems import largest_gaps

KINDS = {"rigid": 0, "hinge": 1, "softfinger": 2, "ball": 3}
CONTACTS = {
    "ball": Friction(0.5),
    "softfinger": Friction(0.5, torsion_radius=0.01),
    "hinge": Friction(0.5, half_length=0.05),
    "sole": Friction(0.5, half_lengths=(0.1, 0.05)),
}


def test_joints():
    """By default a frictionless revolute joint about z without limits; NumPy's numbers are numbers."""
    joint = Joint()
    assert (joint.kind, joint.position_limits, joint.rate_limit) == ("revolute", (-np.inf, np.inf), np.inf)
    assert (joint.armature, joint.damping, joint.friction) == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(joint.axis, [0, 0, 1])
    limited = Joint(rate_limit=np.float32(2.0), effort_limit=np.array([87])[0], position_limits=np.array([-1, 1]))
    assert (limited.rate_limit, limited.effort_limit, limited.position_limits) == (2.0, 87.0, (-1.0, 1.0))


@pytest.mark.parametrize("q", [0.0, 0.3, -2.0, 100.0])
def test_rotation_parts(q):
    """R0 Rot(axis, q) = F + cos(q) C + sin(q) S."""
    axis = np.array([0.36, 0.48, 0.8])
    R0 = rotation.exp(np.array([0.4, -1.0, 0.2]))
    joint = Joint("revolute", axis, Pose(R0, np.zeros(3)))
    F, C, S = joint.rotation_parts
    np.testing.assert_allclose(F + np.cos(q) * C + np.sin(q) * S, R0 @ rotation.exp(q * axis), atol=5e-14)
    np.testing.assert_allclose(dataclasses.replace(joint, kind="prismatic").parent_shift, R0 @ axis, atol=1e-15)


def test_bodies():
    """Massless links, rods, and unphysical moments where asked for; a box is m/12 (y^2 + z^2) about x."""
    assert Link(0.0).mass == 0.0
    assert Link(1.0, inertia=np.diag([0.0, 1.0, 1.0])).inertia[1, 1] == 1.0
    assert Link(1.0, inertia=np.diag([1.0, 1.0, 2.1]), physical=False).inertia[2, 2] == 2.1
    assert HeldObject(1.0, np.diag([1.0, 1.0, 3.0]), physical=False).inertia[2, 2] == 3.0
    box = HeldObject.box(12.0, 1.0, 2.0, 3.0)
    np.testing.assert_array_equal(box.inertia, np.diag([13.0, 10.0, 5.0]))
    np.testing.assert_array_equal(box.com, np.zeros(3))


def test_round_bodies():
    """A sphere has 2/5 m r^2; a long cylinder is a rod, m l^2 / 12, a short one a disc, m r^2 / 2 about z."""
    np.testing.assert_allclose(HeldObject.sphere(5.0, 0.3).inertia, 0.18 * np.eye(3), rtol=1e-15)
    cylinder = HeldObject.cylinder(12.0, 0.2, 3.0)
    np.testing.assert_allclose(cylinder.inertia, np.diag([9.12, 9.12, 0.24]), rtol=1e-15)
    np.testing.assert_array_equal(cylinder.com, np.zeros(3))


def test_spatial_inertia():
    """Steiner: about the origin the inertia grows by m (d^2 1 - d d^T)."""
    com = np.array([0.1, -0.2, 0.3])
    steiner = 2.0 * (com @ com * np.eye(3) - np.outer(com, com))
    inertia = np.diag([0.3, 0.4, 0.5])
    for body in (Link(2.0, com, inertia), HeldObject(2.0, inertia, com)):
        np.testing.assert_allclose(body.spatial_inertia.I, inertia + steiner, atol=1e-15)
        np.testing.assert_allclose(body.spatial_inertia.h, 2.0 * com)
        assert body.spatial_inertia.m == 2.0


def test_arms():
    """`at` mounts a copy elsewhere, `with_tip` changes the tool; joint data stands base to tip; the original stays."""
    original, tool = arm(), Pose.translation(0, 0, 0.1)
    for base in (Pose.translation(1, 2, 3), [1, 0, 0, 0, 1, 2, 3]):
        mounted = original.at(base)
        np.testing.assert_array_equal(mounted.base.p, [1, 2, 3])
        assert mounted.joints == original.joints
    np.testing.assert_array_equal(original.base.p, np.zeros(3))
    np.testing.assert_array_equal(original.with_tip(tool).tip.p, tool.p)
    np.testing.assert_array_equal(original.tip.p, [0.5, 0, 0])
    joints = [Joint(armature=0.1, damping=0.2, position_limits=(-1, 1)), Joint(armature=0.3, damping=0.4)]
    made = Arm(joints, [bar(), Link(1.0)])
    assert made.joint_count == 2
    np.testing.assert_array_equal(made.armature, [0.1, 0.3])
    np.testing.assert_array_equal(made.damping, [0.2, 0.4])
    np.testing.assert_array_equal(made.position_limits, [[-1, 1], [-np.inf, np.inf]])


@pytest.mark.parametrize("kind", KINDS)
def test_freedom_and_transmission(kind):
    """Transmitted and free directions together are the six; K has orthonormal rows and K h = 0; limits go with all."""
    limits = WrenchLimits(5.0, 100.0)
    grasp = Grasp(kind, contact=CONTACTS.get(kind), wrench_limits=limits)
    assert (grasp.contact, grasp.wrench_limits, Grasp(kind).contact) == (CONTACTS.get(kind), limits, None)
    assert len(grasp.free) == KINDS[kind]
    assert sorted(grasp.transmitted + grasp.free) == list(range(6))
    K = grasp.transmission
    assert K.shape == (6 - KINDS[kind], 6)
    np.testing.assert_array_equal(K @ K.T, np.eye(len(K)))
    np.testing.assert_array_equal(K @ np.eye(6)[:, list(grasp.free)], 0)


def test_lever():
    """A moment counts as a force at the ratio of the limits; with one limit only, at 1 m."""
    assert WrenchLimits(3.0, 60.0).lever == 0.05
    assert [WrenchLimits(**x).lever for x in ({}, {"moment": 3}, {"force": np.float64(60)})] == [1.0] * 3
    assert WrenchLimits(np.inf, 10**400 // 10**399).force == 10.0


def test_arrays_are_not_shared_with_the_caller():
    """What the caller changes later does not reach the model."""
    a, inertia = np.array([1.0, 0.0, 0.0]), np.eye(3)
    made = Joint(axis=a, placement=Pose(np.eye(3), a)), Link(1, a, inertia), Grasp("hinge", Pose(inertia, a))
    a[:], inertia[:] = 7.0, 9.0
    for array in (made[0].axis, made[0].placement.p, made[1].com, made[1].inertia[0], made[2].frame.p):
        np.testing.assert_array_equal(array, [1, 0, 0])
    np.testing.assert_array_equal(made[2].frame.R, np.eye(3))


@pytest.mark.parametrize("notes", [3, "text", ["a", 3], None])
def test_no_notes(notes):
    """Anything but a list of strings is refused."""
    arm = hf.robots.panda()
    with pytest.raises(hf.errors.ModelError, match="arm 'panda': notes: expected a list of strings"):
        replace(arm, notes=notes)
    with pytest.raises(hf.errors.ModelError, match="trunk: notes: expected a list of strings"):
        hf.Trunk(arm.joints, arm.links, notes=notes)


def test_same_model():
    """An arm with notes gives the same runs as one without, and keeps them with another tip or base."""
    arm = hf.robots.panda()
    noted = replace(arm, notes=["a note"])
    assert fingerprint(noted) == fingerprint(arm)
    assert noted.with_tip(hf.Pose.identity()).at(hf.Pose.identity()).notes == ("a note",)


BOX = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
PLACE = hf.Pose.from_rpy(0.1, 0.2, 0.3, [1.0, 2.0, 3.0])


def test_an_arm_without_joints():
    """It has a place in the chain and none in q; its tip is where it stands."""
    chain = hf.ClosedChain({"left": arm(2), "pin": hf.Anchor(PLACE)}, BOX, {"pin": hf.Grasp("ball")})
    pin = chain.arms["pin"]
    assert isinstance(pin, hf.Anchor) and isinstance(pin, hf.Arm)
    assert (pin.name, pin.joints, pin.links, pin.joint_count, pin.length) == ("pin", (), (), 0, 0.0)
    assert chain.joints["pin"] == slice(2, 2) and chain.joint_names() == ["left/joint1", "left/joint2"]
    assert pin.position_limits.shape == (0, 2)
    np.testing.assert_array_equal(hf.dynamics.tip_pose(pin, []).p, PLACE.p)
    assert hf.dynamics.link_poses(pin, []) == []
    assert hf.dynamics.joint_mass_matrix(pin, []).shape == (0, 0)
    assert hf.dynamics.tip_jacobian(pin, []).shape == (6, 0)


def test_moved_and_copied():
    """What moves an arm moves an anchor and leaves it one; texts and fingerprints are its own."""
    pin = hf.Anchor(PLACE, "pin")
    for other in (pin.at(hf.Pose.identity()), pin.with_tip(PLACE), pin.of(), replace(pin, name="other")):
        assert type(other) is hf.Anchor
    pickled = pickle.loads(pickle.dumps(pin))
    assert type(pickled) is hf.Anchor and fingerprint(pickled) == fingerprint(pin)
    assert fingerprint(pin.at(hf.Pose.identity())) != fingerprint(pin)
    assert repr(pin).startswith("<Anchor 'pin': base at ")
    lever = hf.Anchor(PLACE, tip=hf.Pose.translation(0.1, 0, 0))
    assert lever.length == 0.1
    np.testing.assert_allclose(hf.dynamics.tip_pose(lever, []).p, PLACE.p + 0.1 * PLACE.R[:, 0], rtol=1e-15)


def test_what_is_refused():
    """Places and names that are none, joints, and an arm that has lost its joints."""
    with pytest.raises(hf.errors.ModelError, match="anchor: base "):
        hf.Anchor([1, 0, 0])
    with pytest.raises(hf.errors.ModelError, match="anchor 'pin': tip "):
        hf.Anchor(PLACE, "pin", tip=3)
    with pytest.raises(hf.errors.ModelError, match="anchor: name: expected str"):
        hf.Anchor(PLACE, 3)
    with pytest.raises(TypeError, match="joints"):
        hf.Anchor(PLACE, joints=[hf.Joint()])
    with pytest.raises(hf.errors.ModelError, match=r"at least one joint, got none; try holdfast\.Anchor\(pose\)"):
        hf.Arm([], [])


def test_assembled():
    """Arms are brought to an object that an anchor pins, wherever that is; the report says so, and a miss is named."""
    chain, state = two_pandas()
    pin = hf.contact_frame([0, 0, 0.1], into=[0, 0, -1])
    at = state.object_frame @ pin
    arms, grasps = {**chain.arms, "pin": hf.Anchor(at)}, {**chain.grasps, "pin": hf.Grasp("ball", pin)}
    for given in (state.object_frame, None):
        found = hf.assemble(arms, chain.held_object, grasps, object_pose=given)
        assert largest_gaps(hf.dynamics.closure(*found))[0] < 1e-10
        (line,) = (line for line in str(found.report).splitlines() if line.startswith("pin:"))
        assert line.startswith("pin: an anchor, closed to ")
        assert found.report.arms[2].reach_used == 1.0
    with pytest.raises(hf.errors.ClosureError, match="'pin' misses its grasp"):
        hf.assemble(arms, chain.held_object, grasps, object_pose=hf.Pose.translation(0, 0, 0.75))
    alone = hf.assemble({"pin": hf.Anchor(at)}, chain.held_object, {"pin": hf.Grasp("rigid", pin)})
    assert np.abs(alone.state.object_pose - state.object_pose).max() < 1e-12
    assert "an anchor" in str(alone.report)


ROOT = Path(holdfast.__file__).parent
TABLES = ("grasp_kinds", "joint_kinds", "joint_types")
NAMES = {*GRASP_KINDS, *JOINT_TYPES}
# MuJoCo's joints, shapes and motions, which share a name with a grasp
SHAPES = {"robots/primitive.py", "model/visuals.py", "robots/urdf/visuals.py", "view/link_meshes.py"}
OTHERS = {"interop/mjcf_tree.py", "dynamics/near_singular.py"} | SHAPES
OTHERS |= {"robots/sdf/joints.py", "robots/sdf/shapes.py"}  # joints and shapes of SDF, likewise


def named(node: ast.AST) -> bool:
    """Whether an expression holds the name of a kind."""
    return any(isinstance(part, ast.Constant) and part.value in NAMES for part in ast.walk(node))


def distinctions(tree: ast.AST) -> list[int]:
    """Return the lines that compare a name, or look something up by it."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare | ast.MatchValue) and named(node):
            found.append(node.lineno)
        if isinstance(node, ast.Dict):
            found += [key.lineno for key in node.keys if isinstance(key, ast.Constant) and key.value in NAMES]
    return found


def test_no_comparison():
    """No file but the tables tells kinds apart."""
    files = {path.relative_to(ROOT).as_posix(): path for path in sorted(ROOT.rglob("*.py"))}
    others = {name: path for name, path in files.items() if path.stem not in TABLES and name not in OTHERS}
    found = {name: distinctions(ast.parse(path.read_text(encoding="utf-8"))) for name, path in others.items()}
    assert {name: lines for name, lines in found.items() if lines} == {}


@pytest.mark.parametrize("text", ["x == 'rigid'", "kind in ('ball', None)", "{'hinge': 1}[kind]"])
def test_comparisons_are_seen(text):
    """The search finds what it looks for."""
    assert distinctions(ast.parse(text)) == [1]
