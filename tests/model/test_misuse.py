"""What cannot exist is refused at every public constructor, by our errors: part, field, what was expected and given."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast import Inputs, Pose, State
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.spatial import rotation
from tests.model.parts import BOX, arm, bar, chain

EYE, ZERO, REST = np.eye(3), np.zeros(3), [1, 0, 0, 0, 0, 0, 0]
LINK, JOINT = hf.Link(1.0, ZERO, EYE), hf.Joint()
ARM, OBJECT = hf.Arm([JOINT], [LINK]), hf.HeldObject(1.0, EYE)
CHAIN, STATE = hf.ClosedChain({"a": ARM}, OBJECT, {"a": hf.Grasp("rigid")}), hf.State([0.0], [0.0], REST)
PATH = hf.control.RestToRest(REST)

# Nothing takes any of these: no number, no vector, no name, no part.
NEVER = {
    "complex": 1j,
    "bytes": b"1",
    "nan": np.nan,
    "huge": 10**400,
    "masked entry": np.ma.masked,
    "masked": np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False]),
    "truths": np.array([True, False, True]),
    "texts": np.array(["1", "2", "3"], dtype=object),
    "nans": np.full((3, 3), np.nan),
    "object": object(),
    "dates": np.array(["2020-01-01"] * 3, dtype="M8[D]"),
    "set": {1.0, 2.0, 3.0},
    "ragged": [[1.0], [1.0, 2.0]],
}
NOT_A_NUMBER = NEVER | {"truth": True, "text": "1", "vector": [1.0, 2.0], "nothing": None, "minus": -1.0}
PLACES = {
    "Link.mass": (lambda x: hf.Link(x), NOT_A_NUMBER),
    "Link.com": (lambda x: hf.Link(1.0, x), NEVER),
    "Link.inertia": (lambda x: hf.Link(1.0, ZERO, x), NOT_A_NUMBER),
    "Link.name": (lambda x: hf.Link(1.0, name=x), NEVER),
    "Link.physical": (lambda x: hf.Link(1.0, physical=x), NEVER | {"text": "no", "zero": 0}),
    "Joint.axis": (lambda x: hf.Joint(axis=x), NEVER),
    "Joint.kind": (lambda x: hf.Joint(x), NEVER),
    "Joint.name": (lambda x: hf.Joint(name=x), NEVER),
    "Joint.placement": (lambda x: hf.Joint(placement=x), NEVER),
    "Joint.position_limits": (lambda x: hf.Joint(position_limits=x), NEVER),
    "Joint.rate_limit": (lambda x: hf.Joint(rate_limit=x), NOT_A_NUMBER),
    "Joint.effort_limit": (lambda x: hf.Joint(effort_limit=x), NOT_A_NUMBER),
    "Joint.armature": (lambda x: hf.Joint(armature=x), NOT_A_NUMBER),
    "Arm.joints": (lambda x: hf.Arm(x, [LINK]), NEVER),
    "Arm.tip": (lambda x: hf.Arm([JOINT], [LINK], x), NEVER),
    "Arm.at": (ARM.at, NEVER),
    "Arm.name": (lambda x: hf.Arm([JOINT], [LINK], name=x), NEVER),
    "HeldObject.mass": (lambda x: hf.HeldObject(x, EYE), NOT_A_NUMBER | {"zero": 0.0}),
    "HeldObject.com": (lambda x: hf.HeldObject(1.0, EYE, x), NEVER),
    "HeldObject.physical": (lambda x: hf.HeldObject(1.0, EYE, physical=x), NEVER),
    "box mass": (lambda x: hf.HeldObject.box(x, 1.0, 1.0, 1.0), NOT_A_NUMBER | {"zero": 0.0}),
    "box x": (lambda x: hf.HeldObject.box(1.0, x, 1.0, 1.0), NOT_A_NUMBER | {"zero": 0.0}),
    "box y": (lambda x: hf.HeldObject.box(1.0, 1.0, x, 1.0), NOT_A_NUMBER | {"zero": 0.0}),
    "box z": (lambda x: hf.HeldObject.box(1.0, 1.0, 1.0, x), NOT_A_NUMBER | {"zero": 0.0}),
    "Grasp.kind": (lambda x: hf.Grasp(x), NEVER),
    "Grasp.frame": (lambda x: hf.Grasp("rigid", x), NEVER),
    "Grasp.contact": (lambda x: hf.Grasp("ball", contact=x), NEVER),
    "Friction.mu": (lambda x: hf.Friction(x), NOT_A_NUMBER | {"zero": 0.0}),
    "WrenchLimits.force": (lambda x: hf.WrenchLimits(force=x), NOT_A_NUMBER | {"zero": 0.0}),
    "ClosedChain.arms": (lambda x: hf.ClosedChain(x, OBJECT, {}), NEVER),
    "ClosedChain names": (lambda x: hf.ClosedChain({x: ARM}, OBJECT, {}), {"number": 1, "none": None, "tuple": (1,)}),
    "ClosedChain.gravity": (lambda x: hf.ClosedChain({"a": ARM}, OBJECT, {}, x), NOT_A_NUMBER),
    "with_bases": (CHAIN.with_bases, NEVER),
    "without_grasp": (CHAIN.without_grasp, NEVER),
    "with_grasp": (lambda x: CHAIN.with_grasp(x, hf.Grasp("rigid")), NEVER),
    "Pose.R": (lambda x: hf.Pose(x, ZERO), NOT_A_NUMBER),
    "Pose.p": (lambda x: hf.Pose(EYE, x), NOT_A_NUMBER),
    "Pose.from_wxyz_xyz": (hf.Pose.from_wxyz_xyz, NEVER | {"six": [1, 0, 0, 0, 0, 0], "twice": [2, 0, 0, 0, 0, 0, 0]}),
    "Pose.from_xyzw": (hf.Pose.from_xyzw, NEVER | {"three": [1, 0, 0], "twice": [2, 0, 0, 0]}),
    "Pose.from_matrix": (hf.Pose.from_matrix, NEVER | {"zeros": np.zeros((4, 4)), "three rows": np.eye(4)[:3]}),
    "Pose.from_rpy": (lambda x: hf.Pose.from_rpy(x, 0.0, 0.0), NEVER),
    "Pose.looking at": (lambda x: hf.Pose.looking(at=x), NEVER | {"itself": [0.0, 0.0, 0.0]}),
    "Pose.looking x": (lambda x: hf.Pose.looking(z=[0.0, 0.0, 1.0], x=x), NEVER | {"along z": [0, 0, -2]}),
    "contact_frame into": (lambda x: hf.contact_frame([0.0, 0.0, 0.0], x), NEVER | {"zero": [0.0, 0.0, 0.0]}),
    "sphere radius": (lambda x: hf.HeldObject.sphere(1.0, x), NOT_A_NUMBER | {"zero": 0.0}),
    "cylinder radius": (lambda x: hf.HeldObject.cylinder(1.0, x, 1.0), NOT_A_NUMBER | {"zero": 0.0}),
    "cylinder length": (lambda x: hf.HeldObject.cylinder(1.0, 1.0, x), NOT_A_NUMBER | {"zero": 0.0}),
    "from_mesh path": (lambda x: hf.HeldObject.from_mesh(x, mass=1.0), NEVER),
    "from_mesh mass": (lambda x: hf.HeldObject.from_mesh("none.stl", mass=x), NOT_A_NUMBER | {"zero": 0.0}),
    "from_urdf path": (hf.HeldObject.from_urdf, NEVER),
    "State.q": (lambda x: hf.State(x, [0.0], REST), NEVER),
    "State.object_pose": (lambda x: hf.State([0.0], [0.0], x), NEVER | {"far from unit": [1e200] * 7}),
    "Inputs": (lambda x: hf.Inputs(x).shaped(CHAIN), NEVER),
    "GravityCompensation.chain": (hf.control.GravityCompensation, NOT_A_NUMBER),
    "GravityCompensation.internal_force": (
        lambda x: hf.control.GravityCompensation(CHAIN, x),
        NEVER | {"text": "1", "truth": True},
    ),
    "ObjectTracking.path": (lambda x: hf.control.ObjectTracking(CHAIN, x), NEVER),
    "ObjectTracking.damping": (lambda x: hf.control.ObjectTracking(CHAIN, PATH.at, damping=x), NEVER),
    "TorqueSchedule.coefficients": (
        lambda x: hf.control.TorqueSchedule([0.0], x),
        NEVER | {"masked table": [NEVER["masked"]]},
    ),
    "forward_dynamics chain": (lambda x: hf.forward_dynamics(x, STATE, [0.0]), NEVER),
    "forward_dynamics state": (lambda x: hf.forward_dynamics(CHAIN, x, [0.0]), NEVER),
    "forward_dynamics tau": (lambda x: hf.forward_dynamics(CHAIN, STATE, x), NOT_A_NUMBER),
    "compile chain": (hf.compile, NEVER),
    "compile parameters": (lambda x: hf.compile(CHAIN, parameters=x), NEVER | {"text": "link_inertia"}),
    "compile rank": (lambda x: hf.compile(CHAIN, generic_rank=x), NEVER | {"truth": True, "text": "1"}),
}


@pytest.mark.parametrize("place", PLACES)
def test_refused(place):
    """On one line; no warning, no bare error of Python's or NumPy's, and never in silence."""
    make, never = PLACES[place]
    for kind, x in never.items():
        if kind == "minus" and place in ("Pose.p", "ClosedChain.gravity"):
            continue
        with pytest.raises(hf.HoldfastError) as caught:
            make(x)
        assert "\n" not in str(caught.value), kind


@pytest.mark.parametrize(
    "R",
    [2.0 * EYE, np.diag([1.0, 1.0, -1.0]), EYE + 0.01 * np.eye(3, k=1), np.zeros((3, 3)), np.full((3, 3), 1e200)],
    ids=["scaled", "mirrored", "sheared", "nothing", "huge"],
)
def test_poses_are_rigid(R):
    """Scaled, sheared and mirrored matrices are no poses, alone or in a state; rounding is mended."""
    with pytest.raises(hf.errors.ModelError, match="pose: R: expected a rotation matrix"):
        hf.State([0.0], [0.0], hf.Pose(R, ZERO))
    off = hf.Pose(EYE + 3e-7 * np.ones((3, 3)), ZERO)
    np.testing.assert_allclose(off.R.T @ off.R, EYE, rtol=0, atol=1e-14)
    seven = hf.Pose.from_wxyz_xyz([1.0 + 4e-7, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(seven.R, EYE)


def field(make, **good):
    """Return a constructor that is given what is good but for some fields."""
    return lambda **given: make(**{**good, **given})


MIRROR, DOUBLE = Pose.unchecked(-EYE, ZERO), Pose.unchecked(2 * EYE, ZERO)
BALL, FINGER, EDGE = hf.Friction(0.5), hf.Friction(0.5, torsion_radius=0.01), hf.Friction(0.5, half_length=0.05)
MAKE = {
    "joint 'elbow': ": field(hf.Joint, name="elbow"),
    "link 'forearm': ": field(hf.Link, mass=1.0, name="forearm"),
    "object: ": field(hf.HeldObject, mass=1.0, inertia=EYE),
    "arm 'left'": field(hf.Arm, joints=[JOINT], links=[bar()], name="left"),
    "grasp: ": field(hf.Grasp, kind="ball"),
    "friction: ": field(hf.Friction, mu=0.5),
    "wrench_limits: ": hf.WrenchLimits,
    "": field(hf.ClosedChain, arms={"left": arm(), "right": arm()}, held_object=BOX, grasps={"left": hf.Grasp("ball")}),
    "state: ": field(hf.State, q=[0.0, 0.0], qd=[0.0, 0.0], object_pose=REST),
}
# what is made, what it is given, what the message says after its name
REFUSED = [
    ("joint 'elbow': ", {"kind": "free"}, r"kind: expected 'revolute' or 'prismatic' or .* or 'spherical', got 'free'"),
    ("joint 'elbow': ", {"axis": [0, 0, 2]}, r"axis: expected a unit vector, got length 2"),
    ("joint 'elbow': ", {"axis": [0, 1]}, r"axis: expected shape \(3,\)"),
    ("joint 'elbow': ", {"axis": "z"}, r"axis: expected numbers"),
    ("joint 'elbow': ", {"placement": MIRROR}, r"placement: rotation: expected"),
    ("joint 'elbow': ", {"placement": Pose.unchecked(EYE, np.array([0, np.nan, 0]))}, r"placement: position"),
    ("joint 'elbow': ", {"armature": -1e-9}, r"armature: expected >= 0, got -1e-09"),
    ("joint 'elbow': ", {"damping": -1.0}, r"damping: expected >= 0"),
    ("joint 'elbow': ", {"friction": "rough"}, r"friction: expected a number"),
    ("joint 'elbow': ", {"rate_limit": 0.0}, r"rate_limit: expected > 0, got 0.0"),
    ("joint 'elbow': ", {"effort_limit": "87"}, r"effort_limit: expected a number, got '87'"),
    ("joint 'elbow': ", {"position_limits": (1, -1)}, r"position_limits: expected lower <= upper, got 1"),
    ("joint 'elbow': ", {"position_limits": (np.nan, 1)}, r"position_limits: expected lower <= upper"),
    ("joint 'elbow': ", {"position_limits": (0, 1, 2)}, r"position_limits: expected two numbers"),
    ("link 'forearm': ", {"mass": -0.1}, r"mass: expected > 0, got -0.1"),
    ("link 'forearm': ", {"com": [0, 0]}, r"com: expected shape \(3,\), got shape \(2,\)"),
    ("link 'forearm': ", {"inertia": [1, 1, 1]}, r"inertia: expected shape \(3, 3\)"),
    ("link 'forearm': ", {"inertia": EYE + np.eye(3, k=1)}, r"inertia: expected a symmetric matrix"),
    ("link 'forearm': ", {"inertia": np.diag([1, 1, -0.1])}, r"inertia: expected principal moments >= 0"),
    ("link 'forearm': ", {"inertia": np.diag([1, 1, 2.1])}, r"inertia: no mass distribution .*physical=False"),
    ("object: ", {"mass": np.inf}, r"mass: expected finite"),
    ("object: ", {"inertia": np.diag([0.0, 1, 1])}, r"inertia: expected principal moments > 0, got 0, 1, 1"),
    ("object: ", {"inertia": np.diag([1, 1, 3])}, r"inertia: no mass distribution"),
    ("arm 'left'", {"joints": [], "links": []}, r": expected at least one joint, got none"),
    ("arm 'left'", {"links": [bar()] * 2}, r": expected one link per joint, got 1 joints and 2 links"),
    ("arm 'left'", {"joints": hf.Joint()}, r": joints: expected a list, got Joint"),
    ("arm 'left'", {"joints": [bar()]}, r", joints\[0\]: expected a Joint, got Link"),
    ("arm 'left'", {"links": ["x"]}, r", links\[0\]: expected a Link, got str"),
    ("arm 'left'", {"tip": [0, 0, 1]}, r": tip \(wxyz_xyz\): expected shape \(7,\), got shape \(3,\)"),
    ("arm 'left'", {"tip": [2, 0, 0, 0, 0, 0, 1]}, r": tip: expected a unit quaternion .* got length 2"),
    ("arm 'left'", {"base": DOUBLE}, r": base: rotation: expected a rotation matrix"),
    ("grasp: ", {"kind": "rigit"}, r"kind: expected one of rigid, hinge, softfinger, ball, .*, got 'rigit'.*'rigid'"),
    ("grasp: ", {"frame": DOUBLE}, r"frame: rotation: expected"),
    ("grasp: ", {"kind": "rigid", "contact": BALL}, r".*a rigid grasp is two-sided; expected contact=None"),
    ("grasp: ", {"contact": 0.5}, r"contact: expected None or Friction, got float"),
    ("grasp: ", {"contact": FINGER}, r".*a ball contact has no torsion_radius"),
    ("grasp: ", {"contact": EDGE}, r".*a ball contact has no half_length"),
    ("grasp: ", {"kind": "softfinger", "contact": BALL}, r".*a softfinger contact needs torsion_radius"),
    ("grasp: ", {"kind": "softfinger", "contact": EDGE}, r".*a softfinger contact needs torsion_radius"),
    ("grasp: ", {"kind": "hinge", "contact": BALL}, r".*a hinge contact needs half_length"),
    ("grasp: ", {"kind": "hinge", "contact": FINGER}, r".*a hinge contact has no torsion_radius"),
    ("grasp: ", {"kind": "sole", "contact": EDGE}, r".*a sole contact has no half_length"),
    ("grasp: ", {"kind": "sole", "contact": BALL}, r".*a sole contact needs half_lengths"),
    ("friction: ", {"half_lengths": 0.1}, r"half_lengths: expected shape \(2,\)"),
    ("friction: ", {"half_lengths": (0.1, -0.1)}, r"half_lengths: expected > 0, got -0.1"),
    ("grasp: ", {"wrench_limits": 50.0}, r"wrench_limits: expected None or WrenchLimits, got float"),
    *(("friction: ", {key: 0.0}, rf"{key}: expected") for key in ("mu", "torsion_radius", "half_length")),
    *(("wrench_limits: ", {key: x}, rf"{key}: expected") for key in ("moment", "force") for x in (0.0, -np.inf)),
    ("", {"arms": [arm()]}, r"chain: expected arms and grasps as mappings"),
    ("", {"grasps": [hf.Grasp("ball")]}, r"chain: expected arms and grasps as mappings"),
    ("", {"arms": {}, "grasps": {}, "held_object": None}, r"chain: expected at least one arm or an object, got none"),
    ("", {"arms": {"left": BALL}}, r"arm 'left': expected an Arm, got Friction"),
    ("", {"held_object": arm()}, r"object: expected a HeldObject, got Arm"),
    ("", {"grasps": {"left": "ball"}}, r"grasp 'left': expected a Grasp, got str"),
    ("", {"grasps": {"lefft": hf.Grasp("ball")}}, r"grasp 'lefft': no such arm\. Did you mean 'left'\?"),
    ("", {"grasps": {"zzz": hf.Grasp("ball")}}, r"grasp 'zzz': no such arm\. Known: left, right\."),
    ("", {"gravity": [0, 0]}, r"chain: gravity: expected shape \(3,\)"),
    ("state: ", {"q": [[0.0], [0.0, 0.0]]}, r"q: expected an array of numbers, got"),
    ("state: ", {"q": [0.0, np.nan]}, r"q: expected finite"),
    ("state: ", {"qd": [0.0]}, r"qd: expected shape \(2,\), got shape \(1,\)"),
    ("state: ", {"object_pose": REST[:6]}, r"object_pose: expected shape \(7,\)"),
    ("state: ", {"object_pose": [2, 0, 0, 0, 0, 0, 0]}, r"object_pose: expected a unit quaternion .* got length 2"),
    ("state: ", {"object_twist": np.zeros(5)}, r"object_twist: expected shape \(6,\)"),
]


@pytest.mark.parametrize(("name", "given", "message"), REFUSED, ids=[f"{r[0]}{r[2]}" for r in REFUSED])
def test_message(name, given, message):
    """The message names part, field and value."""
    error = hf.errors.StateError if name == "state: " else hf.errors.ModelError
    with pytest.raises(error, match=f"^{name}{message}"):
        MAKE[name](**given)


TURN = rotation.exp(np.array([0.3, -0.4, 1.2]))


class Traced:
    """A stand-in for a scalar of which only the expression is known."""

    def where(self, a, b):
        """Mark it as one."""


def test_vectors():
    """Integers, booleans and other floats become float64; the result is a read-only copy."""
    given = np.array([1.0, 2.0, 3.0])
    for value in ([1, 2, 3], (1, 2.0, 10**30), np.float32([1, 2, 3]), given):
        a = checks.numbers(value, (3,), "v")
        assert (a.dtype, a.shape, a.flags.writeable) == (np.dtype(float), (3,), False)
        assert a is not value
    assert given.flags.writeable


def test_traced_scalars_pass():
    """Arrays that hold traced scalars keep them; plain objects beside them are not converted."""
    node = Traced()
    a = checks.numbers([node, 1, 2.0], (3,), "v")
    assert a.dtype == object
    assert a[0] is node


@pytest.mark.parametrize("entry", [1e200, -1e308])
def test_huge_entries_do_not_warn(entry):
    """Overflow inside a check is part of the refusal, not a warning."""
    matrix = np.eye(3)
    matrix[0, 1] = entry
    for check in (checks.rotation_matrix, checks.symmetric_matrix, checks.rotational_inertia):
        with pytest.raises(ModelError, match="expected a"):
            check(matrix, "R")
    with pytest.raises(ModelError, match="expected a unit vector"):
        checks.unit_vector([entry, 0.0, 0.0], "axis")
    with pytest.raises(ModelError, match="expected a unit quaternion"):
        checks.pose([entry, 0, 0, 0, 0, 0, 0], "pose")


def test_huge_inertias_are_inertias():
    """The largest doubles do not overflow while they are made symmetric."""
    J = checks.rotational_inertia(1.5e308 * np.eye(3), "inertia")
    np.testing.assert_array_equal(J, 1.5e308 * np.eye(3))


def test_mended_values_are_read_only():
    """What was off by rounding is made exact, and may not be written either."""
    R = checks.rotation_matrix(np.round(TURN, 8), "R")
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
    axis = checks.unit_vector(np.round(TURN[0], 8), "axis")
    assert np.linalg.norm(axis) == pytest.approx(1.0, abs=1e-15)
    assert not R.flags.writeable
    assert not axis.flags.writeable


def test_triangle_inequality():
    """A rod and a lamina are the limits; beyond them no mass distribution has such moments."""
    checks.rotational_inertia(np.diag([0.0, 1.0, 1.0]), "rod")
    checks.rotational_inertia(TURN @ np.diag([1.0, 2.0, 3.0]) @ TURN.T, "lamina")
    impossible = TURN @ np.diag([1.0, 2.0, 3.1]) @ TURN.T
    with pytest.raises(ModelError, match=r"no mass distribution has principal moments 1, 2, 3\.1"):
        checks.rotational_inertia(impossible, "body")
    checks.rotational_inertia(impossible, "body", physical=False)


def test_did_you_mean():
    """The closest name is found in any case; long lists of names are cut, so that a message stays a line."""
    assert checks.did_you_mean("Q ARM1/Joint1", ["q arm1/joint1", "q arm1/joint2"]) == " Did you mean 'q arm1/joint1'?"
    assert checks.did_you_mean("x", ["left", "right"]) == " Known: left, right."
    assert checks.did_you_mean("x", []) == " Known: none."
    assert checks.did_you_mean("x", map(str, range(500))).endswith(", 39 and 460 more.")


POSE = np.r_[1.0, np.zeros(6)]


def test_fits():
    """A state of another chain is refused with both lengths and the arms'."""
    state = State(np.zeros(4), np.zeros(4), POSE)
    state.fits(chain(left=2, right=2))
    with pytest.raises(StateError, match=r"expected 5 joint positions \(left: 2, right: 3\), got 4"):
        state.fits(chain(left=2, right=3))


def test_pose():
    """A Pose or seven numbers; a quaternion off by rounding is normalised."""
    frame = Pose(rotation.exp(np.array([0.1, -0.2, 0.3])), np.array([1.0, 2.0, 3.0]))
    for given in (frame, frame.wxyz_xyz, frame.wxyz_xyz + np.r_[1e-8, np.zeros(6)]):
        state = State([0.0], [0.0], given)
        np.testing.assert_allclose(state.object_frame.R, frame.R, atol=3e-8)
        assert np.linalg.norm(state.object_pose[:4]) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_array_equal(state.object_twist, np.zeros(6))


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_that_was_normalised_keeps_its_bits(seed):
    """However often a state is made of another one's pose."""
    x = np.random.default_rng(seed).normal(size=7)
    pose = State([0.0], [0.0], np.r_[x[:4] / np.sqrt((x[:4] ** 2).sum()) * (1 + 3e-7), x[4:]]).object_pose
    for _ in range(5):
        again = State([0.0], [0.0], pose).object_pose
        np.testing.assert_array_equal(again, pose)
        pose = again


def test_inputs():
    """Missing inputs are zero; only link wrenches stay away; each shape is checked by name."""
    made = chain(left=2, right=3)
    empty = Inputs().shaped(made)
    assert empty.link_wrenches is None
    np.testing.assert_array_equal(empty.object_wrench, np.zeros(6))
    np.testing.assert_array_equal(empty.base_twists, np.zeros((2, 6)))
    np.testing.assert_array_equal(empty.base_accelerations, np.zeros((2, 6)))
    shapes = {"object_wrench": (6,), "link_wrenches": (5, 6), "base_twists": (2, 6), "base_accelerations": (2, 6)}
    for field, shape in shapes.items():
        assert getattr(Inputs(**{field: np.ones(shape)}).shaped(made), field).shape == shape
        with pytest.raises(StateError, match=rf"inputs: {field}: expected shape \({shape[0]}"):
            Inputs(**{field: np.zeros((9, 9))}).shaped(made)
        with pytest.raises(StateError, match=rf"inputs: {field}: expected finite"):
            Inputs(**{field: np.full(shape, np.nan)}).shaped(made)


def test_inputs_of_lists():
    """Whatever is given, arrays are held; what is none is refused at once."""
    assert isinstance(Inputs(object_wrench=[0, 0, 0, 0, 0, 1]).object_wrench, np.ndarray)
    with pytest.raises(StateError, match="inputs: base_twists: expected an array of numbers, got"):
        Inputs(base_twists=[[0], [0, 0]])


def test_state_without_the_pose_of_the_object():
    """What is lacking is said, not the shape of what is not there."""
    with pytest.raises(StateError, match=r"object_pose: expected shape \(7,\), got none; hf.assemble finds it"):
        hf.forward_dynamics(CHAIN, State([0.0], [0.0]), [0.0])
