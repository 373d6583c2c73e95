"""Arms come out of MJCF as MuJoCo moves them."""

import sys

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, HeldObject, Pose, State
from holdfast.dynamics import tip_pose
from holdfast.errors import MissingExtra, ModelError, SceneError
from holdfast.interop.mjcf_reader import load_mjcf
from holdfast.interop.mjcf_writer import to_mjcf
from holdfast.robots import ROBOTS, stewart_platform, three_finger_hand
from tests.interop.test_mjcf_writer import massless
from tests.robots.arm_dynamics import mass_jacobian_bias
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")

ROUND_TRIP = 1e-12
GRAVITY = np.array([1.0, 2.0, -9.0])

# anchors off the body's origin, references that are not 0, two joints in one body, a turned inertia, geoms for
# inertia, fingers on the hand, a stand that moves, a mesh that is not there
WITH_EVERYTHING = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <asset><mesh name="shell" file="nowhere.stl"/></asset>
  <default><joint damping="0.2"/></default>
  <worldbody>
    <body name="stand" pos="0.1 0.2 0.3" quat="0.8 0 0.6 0">
      <body name="shoulder" pos="0 0 0.2" euler="0.3 0.1 -0.2">
        <joint name="lift" type="slide" axis="1 2 2" ref="0.1" range="-0.5 0.5" armature="0.3"/>
        <joint name="turn" axis="0 1 1" pos="0.1 0.02 0.03" ref="0.4" frictionloss="0.7" actuatorfrcrange="-5 6"/>
        <inertial mass="2" pos="0.1 0.2 0.1" quat="0.5 0.1 0.7 0.2" diaginertia="0.1 0.2 0.25"/>
        <geom type="mesh" mesh="shell"/>
        <body name="bracket" pos="0 0.1 0" euler="0 0.4 0">
          <geom type="box" size="0.05 0.1 0.02" pos="0 0 0.1"/>
          <body name="elbow" pos="0.3 0 0.1">
            <joint name="bend" axis="0.6 0 0.8" pos="0.01 0 0.05" damping="0.9"/>
            <geom type="capsule" size="0.03" fromto="0 0 0 0.2 0 0.1"/>
            <body name="finger" pos="0.2 0 0.1">
              <joint name="grip" type="slide" axis="0 1 0" range="0 0.04"/>
              <geom type="sphere" size="0.02"/>
            </body>
            <site name="palm" pos="0.25 0 0.1" quat="0.6 0.8 0 0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="bend" gear="2" forcerange="-3 3"/></actuator>
</mujoco>
"""


def oracle(text, q, qd, names, locked):
    """Return MuJoCo's tip position, attitude, M and bias over the named joints."""
    model = mujoco.MjModel.from_xml_string(text.replace('<geom type="mesh" mesh="shell"/>', "").replace(
        '<asset><mesh name="shell" file="nowhere.stl"/></asset>', ""))  # fmt: skip
    model.opt.gravity = GRAVITY
    data, places = mujoco.MjData(model), []
    for name, x, v in zip(names, q, qd, strict=True):
        joint = model.joint(name)
        data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]] = x, v
        places.append(joint.dofadr[0])
    for name, x in locked.items():
        data.qpos[model.joint(name).qposadr[0]] = x
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    site = model.site("palm").id
    return data.site_xpos[site], data.site_xmat[site].reshape(3, 3), M[np.ix_(places, places)], data.qfrc_bias[places]


@pytest.mark.parametrize("q", [[0.1, 0.4, 0.0], [0.0, 0.0, 0.0], [-0.3, 1.2, -2.0]])
def test_as_mujoco_moves_it(q):
    """Tip, mass matrix, bias and parameters, whatever the file does to its frames."""
    locked = {"grip": 0.03}
    arm = load_mjcf(WITH_EVERYTHING, tip="palm", locked=locked)
    qd = np.array([0.5, -1.0, 2.0])
    p, R, M, bias = oracle(WITH_EVERYTHING, q, qd, ["lift", "turn", "bend"], locked)
    ours = mass_jacobian_bias(arm, np.array(q), qd, GRAVITY)
    assert tip_pose(arm, np.array(q)).p == pytest.approx(p, abs=1e-14)
    assert pytest.approx(R, abs=1e-14) == tip_pose(arm, np.array(q)).R
    assert ours[0] == pytest.approx(M, abs=1e-13)
    assert ours[2] == pytest.approx(bias, abs=1e-12)


def test_parameters():
    """Names, kinds, limits, damping, armature, friction; efforts of the joint or of its only drive."""
    arm = load_mjcf(WITH_EVERYTHING, tip="palm", lock_others=True)
    lift, turn, bend = arm.joints
    assert [joint.name for joint in arm.joints] == ["lift", "turn", "bend"]
    assert [link.name for link in arm.links] == ["", "shoulder", "elbow"]
    assert [joint.kind for joint in arm.joints] == ["prismatic", "revolute", "revolute"]
    assert lift.position_limits == (-0.5, 0.5)
    assert turn.position_limits == (-np.inf, np.inf)
    assert (lift.effort_limit, turn.effort_limit, bend.effort_limit) == (np.inf, 5.0, 6.0)
    assert (lift.damping, turn.damping, bend.damping) == (0.2, 0.2, 0.9)
    assert (lift.armature, turn.friction) == (0.3, 0.7)
    assert arm.links[0].mass == 0.0


def test_base_and_mount():
    """A base may be any body on the way; it stands where the model has it, or where it is told to."""
    arm = load_mjcf(WITH_EVERYTHING, base="shoulder", tip="palm", lock_others=True)
    assert [joint.name for joint in arm.joints] == ["bend"]
    placed = load_mjcf(WITH_EVERYTHING, base="stand", tip="palm", lock_others=True, mount=[1, 0, 0, 0, 3, 4, 5])
    assert placed.base.p.tolist() == [3.0, 4.0, 5.0]
    whole = load_mjcf(WITH_EVERYTHING, base="stand", tip="palm", lock_others=True)
    assert whole.base.p.tolist() == [0.1, 0.2, 0.3]
    q = np.array([0.1, 0.2, 0.3])
    from_world = load_mjcf(WITH_EVERYTHING, tip="palm", lock_others=True)
    assert tip_pose(whole, q).p == pytest.approx(tip_pose(from_world, q).p, abs=1e-15)


def gaps(arm: Arm, again: Arm, rng) -> float:
    """Return the largest difference of M, J and bias at a random state, relative to the largest entries."""
    q, qd = rng.normal(size=(2, arm.joint_count))
    pairs = zip(mass_jacobian_bias(arm, q, qd, GRAVITY), mass_jacobian_bias(again, q, qd, GRAVITY), strict=True)
    return max(np.abs(a - b).max() / np.abs(a).max() for a, b in pairs)


def test_round_trip():
    """`load_mjcf(to_mjcf(chain))` gives every arm back: M, J, bias, where it stands, limits and losses."""
    rng = np.random.default_rng(7)
    robots = {name: make([0.6, 0.8, 0, 0, 1, 2, 3], armature=0.2) for name, make in ROBOTS.items()}
    random = [well_conditioned_system(k, grasps=["rigid", "hinge"], joints=[7, 6], moving_base=False) for k in range(2)]
    chains = [
        ClosedChain(robots, HeldObject.box(1, 1, 1, 1), {}),
        ClosedChain(*stewart_platform()),
        ClosedChain(*three_finger_hand()),
        *(as_chain(case).chain for case in random),
    ]
    for chain in chains:
        text = to_mjcf(chain)
        for name, arm in chain.arms.items():
            again = load_mjcf(text, base=name, tip=f"{name}/tip")
            assert gaps(arm, again, rng) <= ROUND_TRIP
            assert again.base.p == pytest.approx(arm.base.p, abs=0)
            assert again.name == name
            for joint, other in zip(arm.joints, again.joints, strict=True):
                assert other.kind == joint.kind
                assert other.position_limits == joint.position_limits
                assert other.effort_limit == joint.effort_limit
                assert (other.armature, other.damping, other.friction) == (
                    joint.armature, joint.damping, joint.friction)  # fmt: skip


def test_round_trip_of_massless_links():
    """Links that share a body come apart again."""
    case = as_chain(well_conditioned_system(1, grasps=["rigid"], joints=[7], moving_base=False))
    ((name, arm),) = case.chain.arms.items()
    light = massless(arm)
    again = load_mjcf(to_mjcf(ClosedChain({name: light}, case.chain.held_object, {})), base=name, tip=f"{name}/tip")
    assert gaps(light, again, np.random.default_rng(1)) <= ROUND_TRIP


BODY = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
ARM = f'<body name="a"><joint name="j"/>{BODY}<body name="b" pos="1 0 0"><joint name="k"/>{BODY}</body></body>'


def mjcf(bodies: str, more: str = "") -> str:
    """Return a file of these bodies."""
    return f"<mujoco><worldbody>{bodies}</worldbody>{more}</mujoco>"


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (mjcf(ARM.replace('name="j"', 'name="j" type="ball"')), {}, "joint 'j': expected a hinge or a slide"),
        (mjcf(ARM.replace('<joint name="j"/>', '<freejoint name="f"/>')), {}, "joint 'f': .*got a free joint"),
        (mjcf(ARM.replace('name="j"', 'name="j" stiffness="3 1"')), {}, "joint 'j': .*a spring"),
        (mjcf(ARM.replace('name="j"', 'name="j" damping="1 2"')), {}, "joint 'j': .*not linear"),
        (mjcf(ARM.replace('body name="b"', 'body name="b" gravcomp="1"')), {}, "body 'b': gravcomp"),
        (mjcf(ARM, '<equality><joint name="e" joint1="j" joint2="k"/></equality>'), {}, "'e': .*without loops"),
        (mjcf(ARM, '<equality><connect body1="a" body2="world" anchor="0 0 0"/></equality>'), {}, "without loops"),
        (mjcf(ARM, '<tendon><fixed name="t" stiffness="2"><joint joint="j" coef="1"/></fixed></tendon>'), {}, "'t'"),
        (mjcf(ARM), {"base": "c"}, "base: no body 'c'"),
        (mjcf(ARM), {"tip": "bb"}, "tip: no site or body 'bb'. Did you mean 'b'"),
        (mjcf(ARM), {"base": "b", "tip": "a"}, "expected a tip that hangs on the base"),
        (mjcf(ARM), {"locked": {"l": 0}}, "locked: no joint 'l'"),
        (mjcf(ARM), {"locked": {"j": 0, "k": 0}}, "expected a joint between base and tip"),
        (mjcf(ARM), {"locked": {"j": "left"}}, "locked: j: expected a number"),
        (mjcf(ARM), {"tip": "a"}, "joint 'k' hangs on the arm"),
        (mjcf(ARM + f'<body name="c"><joint/>{BODY}</body>'), {}, "expected one end, got 2"),
        (mjcf('<body name="a"><joint name="j"/></body>'), {}, "MuJoCo cannot compile it: .*mjMINVAL"),
        ("<mujoco>", {}, "not well-formed XML"),
        ("<robot/>", {}, "try load_urdf"),
        ("nowhere.xml", {}, "nowhere.xml: cannot be read"),
    ],
)  # fmt: skip
def test_refused_by_name(text, options, message):
    """What an arm of ours cannot have, and what is not there, is refused and named."""
    with pytest.raises(SceneError, match=message):
        load_mjcf(text, **options)
    with pytest.raises(ModelError, match="mount"):
        load_mjcf(mjcf(ARM), mount="table")


def test_ties_to_others_are_not_the_arms():
    """A weld to another moving body is a grasp and leaves the arm alone."""
    other = f'<body name="thing"><freejoint/>{BODY}</body>'
    arm = load_mjcf(mjcf(ARM + other, '<equality><weld body1="b" body2="thing"/></equality>'), base="world", tip="b")
    assert arm.joint_count == 2
    assert tip_pose(arm, np.zeros(2)).p == pytest.approx([1.0, 0.0, 0.0])


def test_file(tmp_path):
    """A path works as the text does; included files are found beside it."""
    (tmp_path / "arm.xml").write_text(mjcf('<include file="parts.xml"/>'))
    (tmp_path / "parts.xml").write_text(f"<mujocoinclude>{ARM}</mujocoinclude>")
    assert load_mjcf(tmp_path / "arm.xml").joint_count == 2
    assert Pose.identity().p == pytest.approx(load_mjcf(str(tmp_path / "arm.xml")).base.p)


def test_deprecated_attributes():
    """What MuJoCo calls deprecated it still does, and says nothing to our users."""
    arm = load_mjcf(mjcf(ARM).replace("<mujoco>", '<mujoco><compiler settotalmass="6"/>'))
    assert sum(link.mass for link in arm.links) == pytest.approx(6.0)


def test_without_mujoco(monkeypatch):
    """The extra that brings it is named."""
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtra, match=r"pip install 'holdfast\[mjcf\]'"):
        load_mjcf(mjcf(ARM))


def test_state_in_keyframe():
    """The keyframe of a state reads back as that state."""
    chain = ClosedChain(*three_finger_hand())
    turn = np.array([0.5, 0.5, -0.5, 0.5])
    state = State(np.arange(12.0) / 10, np.ones(12), np.r_[turn, 1, 2, 3], np.arange(6.0))
    model = mujoco.MjModel.from_xml_string(to_mjcf(chain, state))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    twist = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, model.body("object").id, twist, 0)
    assert twist == pytest.approx(state.object_twist, abs=1e-14)
    assert data.qpos[:12].tolist() == state.q.tolist()
    assert data.body("object").xpos.tolist() == [1.0, 2.0, 3.0]
    assert data.body("object").xquat == pytest.approx(turn)


BOUNDED = """<mujoco>{}<worldbody><body name="bar"><joint name="hinge"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
{}</body></worldbody></mujoco>"""
COPY = '<replicate count="2000"><replicate count="2000"><site/></replicate></replicate>'


@pytest.mark.parametrize(
    ("before", "inside", "message"),
    [
        ('<!DOCTYPE x [<!ENTITY a "b">]>', "", "DOCTYPE"),
        ("", COPY, "expected at most 10,000 copies of it (replicate), got 4e+06"),
        ('<asset><texture name="t" type="2d" builtin="flat" width="900000" height="900000"/></asset>', "", "texture"),
        ('<asset><hfield name="h" nrow="90000" ncol="90000" size="1 1 1 1"/></asset>', "", "hfield"),
        ('<size nuserdata="2000000000"/>', "", "expected counts up to 16,777,216, got 2e+09"),
        ('<include file="more.xml"/>', "", "more.xml:1: "),
    ],
)
def test_counts_beyond_a_machine(before, inside, message, tmp_path):
    """Refused by file, line and element, before MuJoCo makes room."""
    text = BOUNDED.format(before, inside)
    if before.startswith("<!"):
        text = before + BOUNDED.format("", "")
    (tmp_path / "arm.xml").write_text(text)
    (tmp_path / "more.xml").write_text(f"<mujoco><worldbody>{COPY}</worldbody></mujoco>")
    with pytest.raises(SceneError) as caught:
        load_mjcf(tmp_path / "arm.xml")
    assert message in str(caught.value)


def test_usual_counts(tmp_path):
    """Some copies, a texture, an included file."""
    (tmp_path / "more.xml").write_text(
        '<mujoco><asset><texture name="t" type="2d" builtin="flat" width="64" height="64"/></asset></mujoco>'
    )
    (tmp_path / "arm.xml").write_text(
        BOUNDED.format('<include file="more.xml"/>', '<replicate count="3"><site/></replicate>')
    )
    assert load_mjcf(tmp_path / "arm.xml", tip="bar").joint_count == 1
