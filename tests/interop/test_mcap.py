"""An MCAP file of a run, read back with rosbags: every number, to the bit."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from holdfast import ClosedChain, HeldObject, Pose, State, simulate
from holdfast.errors import MissingExtra, ResultError
from holdfast.interop import mcap_writer
from holdfast.interop.mcap_writer import write_mcap
from holdfast.spatial import rotation
from holdfast.world import HalfSpace, Touching
from tests.systems.anchored import pinned
from tests.systems.problems import random_problem
from tests.systems.trunk_runs import still_base
from tests.view.runs import lifted

pytest.importorskip("mcap_ros2", reason="needs mcap-ros2-support: pip install 'holdfast[ros]'")
highlevel = pytest.importorskip("rosbags.highlevel", reason="needs rosbags: pip install rosbags")
typesys = pytest.importorskip("rosbags.typesys")


def written(folder, *arguments):
    """Return the messages of a run's file by topic, as (time [ns], message)."""
    path = folder / "run.mcap"
    chain, run, *more = arguments
    write_mcap(chain, run, path, *more)
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    found = {}
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        for connection, time, raw in reader.messages():
            found.setdefault(connection.topic, []).append((time, reader.deserialize(raw, connection.msgtype)))
    return found


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """The messages of a lift."""
    return written(tmp_path_factory.mktemp("mcap"), *lifted())


def test_topics(bag):
    """A message of each kind for every sample, stamped with the run's time."""
    _, run = lifted()
    expected = {"/joint_states", "/object_pose", "/tf"}
    expected |= {f"/{arm}/{what}" for arm in ("left", "right") for what in ("grasp_wrench", "internal_wrench")}
    assert set(bag) == expected
    for topic, messages in bag.items():
        assert [time for time, _ in messages] == [round(1e9 * t) for t in run.t], topic
    for time, message in bag["/joint_states"]:
        assert time == 10**9 * message.header.stamp.sec + message.header.stamp.nanosec


def test_joint_states_and_object_pose(bag):
    """Positions, rates, torques and pose come back bit for bit; the quaternion's scalar is last, as ROS has it."""
    chain, run = lifted()
    for k, ((_, joints), (_, held)) in enumerate(zip(bag["/joint_states"], bag["/object_pose"], strict=True)):
        assert joints.name == chain.joint_names()
        assert (joints.position == run.q[k]).all()
        assert (joints.velocity == run.qd[k]).all()
        assert (joints.effort == run.tau[k]).all()
        assert held.header.frame_id == "world"
        p, o = held.pose.position, held.pose.orientation
        assert [o.w, o.x, o.y, o.z, p.x, p.y, p.z] == run.object_pose[k].tolist()


def test_transforms_lead_to_the_tips_and_wrenches_are_in_them(bag):
    """World to tip along the frames is where the contact is; the wrench turned back is the run's."""
    chain, run = lifted()
    for k, (_, message) in enumerate(bag["/tf"]):
        frames = frames_of(message)
        assert len(frames) == len(message.transforms) == 1 + 2 + 2 * (1 + 7 + 1)
        for i, (name, grasp) in enumerate(chain.grasps.items()):
            tip, contact = (in_world(frames, frame) for frame in (f"{name}/tip", f"object/{name}"))
            assert tip.p == pytest.approx(contact.p, abs=1e-9)
            held = Pose.from_wxyz_xyz(run.object_pose[k]) @ grasp.frame
            assert np.abs(contact.R - held.R).max() < 1e-12
            for what, wrenches in (("grasp_wrench", run.grasp_wrench), ("internal_wrench", run.internal_wrench)):
                stamped = bag[f"/{name}/{what}"][k][1]
                assert stamped.header.frame_id == f"{name}/tip"
                m, f = stamped.wrench.torque, stamped.wrench.force
                turned = np.concatenate([tip.R @ [m.x, m.y, m.z], tip.R @ [f.x, f.y, f.z]])
                assert turned == pytest.approx(wrenches[k, i], abs=1e-9)
        m, f = bag["/left/grasp_wrench"][k][1].wrench.torque, bag["/left/grasp_wrench"][k][1].wrench.force
        assert [m.x, m.y, m.z, f.x, f.y, f.z] == pytest.approx(run.wrist_wrench[k, 0], abs=1e-12)


def pose(transform) -> Pose:
    t, r = transform.translation, transform.rotation
    return Pose(rotation.from_quaternion(np.array([r.w, r.x, r.y, r.z])), np.array([t.x, t.y, t.z]))


def frames_of(message) -> dict[str, tuple[str, Pose]]:
    """Return every frame's parent and its pose in it."""
    return {t.child_frame_id: (t.header.frame_id, pose(t.transform)) for t in message.transforms}


def in_world(frames, name) -> Pose:
    at = Pose.identity()
    while name != "world":
        name, here = frames[name]
        at = here @ at
    return at


def test_moving_bases(tmp_path):
    """A base that moves takes its frame along."""
    chain, run = lifted()

    def rising(t):
        return Pose.translation(-0.55, 0.0, 0.2 * t), np.zeros(6), np.zeros(6)

    for time, message in written(tmp_path, chain, run, {"left": rising})["/tf"]:
        (base,) = (t for t in message.transforms if t.child_frame_id == "left")
        assert base.transform.translation.z == pytest.approx(0.2e-9 * time)


@pytest.mark.parametrize("floating", [False, True])
def test_trunks(floating, tmp_path):
    """Frames lead from the world through the trunk to every tip that holds, where the object's contact is."""
    arms = {"arms": 3, "grasps": "rigid", "joints": 7}
    p = still_base(4, 2, floating=floating, arms=arms, in_world=0.3)
    run = simulate(p.chain, p.state, lambda t, s, m: (p.tau, m), 0.01, 0.01, inputs=p.inputs)
    found = {topic: [message for _, message in rows] for topic, rows in written(tmp_path, p.chain, run).items()}
    assert found["/joint_states"][0].name == p.chain.joint_names()
    assert ("/base_pose" in found) is floating
    if floating:
        at = found["/base_pose"][1].pose
        o = at.orientation
        assert [o.w, o.x, o.y, o.z, at.position.x] == run.base_pose[1, :5].tolist()
    for k, message in enumerate(found["/tf"]):
        frames = frames_of(message)
        assert frames["trunk"][0] == "world"
        for name in p.chain.names:
            tip, contact = (in_world(frames, frame) for frame in (f"{name}/tip", f"object/{name}"))
            assert tip.p == pytest.approx(contact.p, abs=1e-9)
            force = found[f"/{name}/grasp_wrench"][k].wrench.force
            assert tip.R @ [force.x, force.y, force.z] == pytest.approx(
                run.grasp_wrench[k, p.chain.names.index(name), 3:]
            )


def test_anchors(tmp_path):
    """An anchor has no links: its tip hangs on its base, at the object's contact."""
    p = pinned(random_problem(4, arms=2, joints=7, grasps="rigid", moving_base=False), ("ball",), moving=False)
    run = simulate(p.chain, p.state, lambda t, s, m: (p.tau, m), 0.01, 0.01, inputs=p.inputs)
    for _, message in written(tmp_path, p.chain, run)["/tf"]:
        frames = frames_of(message)
        assert frames["pin1/tip"][0] == "pin1"
        assert in_world(frames, "pin1/tip").p == pytest.approx(in_world(frames, "object/pin1").p, abs=1e-9)


@pytest.mark.parametrize("kind", ["sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped",
                                  "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage",
                                  "std_msgs/msg/Float64MultiArray"])  # fmt: skip
def test_definitions_are_those_of_ros(kind):
    """Field for field what a ROS 2 installation says, parts and all."""
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)

    def parts(text):
        first, *others = text.split(f"{'=' * 80}\n")
        return {"": first.split(), **{part.split()[1]: part.split()[2:] for part in others}}

    assert parts(mcap_writer.definition(kind)) == parts(store.generate_msgdef(kind, ros_version=2)[0])


def test_contacts_with_the_world(tmp_path):
    """Forces, gaps, modes, margins and status of every sample come back, under the contacts' names."""
    touching = Touching({"a": [0, 0, -0.05], "b": [0.05, 0, -0.05]}, {"table": HalfSpace(friction=0.5)})
    chain = ClosedChain({}, HeldObject.box(2.0, 0.2, 0.2, 0.1), {}, touching=touching)
    start = State([], [], Pose.translation(0, 0, 0.05), np.zeros(6))
    run = simulate(chain, start, lambda t, s, m: (np.zeros(0), m), 0.02, 0.01, contacts="steps")
    found = written(tmp_path, chain, run)
    for name in ("touch_gap", "touch_mode", "touch_margin", "touch_status"):
        messages = [message for _, message in found[f"/{name}"]]
        np.testing.assert_array_equal([one.data for one in messages], getattr(run, name).reshape(len(run), -1))
        assert messages[0].layout.dim[0].label == "a/table b/table"
    forces = [message.wrench.force.z for _, message in found["/touch/a_table"]]
    np.testing.assert_array_equal(forces, run.touch_force[:, 0, 2])


def test_refused(tmp_path, monkeypatch):
    """A place that cannot be written, and a missing library."""
    chain, run = lifted()
    with pytest.raises(ResultError, match="cannot be written"):
        write_mcap(chain, run, tmp_path / "nowhere" / "run.mcap")
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(MissingExtra, match=r"pip install 'holdfast\[ros\]'"):
        write_mcap(chain, run, tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())


def test_topics_of_similar_names(tmp_path):
    """Arms whose names differ in characters that topics cannot have do not share a topic."""
    chain, run = lifted()
    names = {"left": "a-1", "right": "a.1"}
    arms, grasps = ({names[name]: of for name, of in part.items()} for part in (chain.arms, chain.grasps))
    found = written(tmp_path, replace(chain, arms=arms, grasps=grasps), run)
    assert {"/a_1/grasp_wrench", "/a_1_/grasp_wrench"} <= set(found)
    assert len(found["/a_1/grasp_wrench"]) == len(found["/a_1_/grasp_wrench"]) == len(run.t)
