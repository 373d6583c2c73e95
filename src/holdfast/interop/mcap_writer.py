"""Writing a run as an MCAP file of ROS 2 messages, for Foxglove, PlotJuggler, rosbags and ROS itself."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from typing import IO, Any

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import joint_placement
from holdfast.dynamics.contact_places import tip_frames
from holdfast.errors import MissingExtra
from holdfast.io.files import file_path, write_atomically
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.serial_chain import serial_chain
from holdfast.model.trunk import TRUNK
from holdfast.simulation.environment import BaseMotion, Environment
from holdfast.simulation.trajectory import Trajectory, require_run_of
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate

JOINT_MESSAGE = "sensor_msgs/msg/JointState"
WRENCH_MESSAGE = "geometry_msgs/msg/WrenchStamped"
POSE_MESSAGE = "geometry_msgs/msg/PoseStamped"
TRANSFORM_MESSAGE = "tf2_msgs/msg/TFMessage"
NUMBERS_MESSAGE = "std_msgs/msg/Float64MultiArray"
TOUCH_TOPICS = ("touch_gap", "touch_mode", "touch_margin", "touch_status")  # topics with a number for each contact

# Fields of the messages; in a file, the definition of a message is followed by those of its parts.
MESSAGE_FIELDS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    JOINT_MESSAGE: ("std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"),
    WRENCH_MESSAGE: "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    POSE_MESSAGE: "std_msgs/Header header\ngeometry_msgs/Pose pose",
    TRANSFORM_MESSAGE: "geometry_msgs/TransformStamped[] transforms",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    NUMBERS_MESSAGE: "std_msgs/MultiArrayLayout layout\nfloat64[] data",
}
Message = tuple[str, str, dict[str, Any]]  # topic, kind, content


def write_mcap(
    chain: ClosedChain, run: Trajectory, path: str | PathLike[str], base_motion: Mapping[str, BaseMotion] | None = None
) -> None:
    """Write a run as an MCAP file with one message per topic and sample; an existing file is replaced.

    | topic | message | content |
    |---|---|---|
    | `/joint_states` | JointState | all joints as 'arm/joint': q, qd, tau |
    | `/object_pose` | PoseStamped | the object's frame in `world` |
    | `/ARM/grasp_wrench` | WrenchStamped | wrench of the arm on the object, about the tip's origin, `ARM/tip` axes |
    | `/ARM/internal_wrench` | WrenchStamped | its internal part, which does not move the object |
    | `/touch/POINT_SHAPE` | WrenchStamped | force of the world on the object at a candidate of `touching`, no torque |
    | `/touch_gap` | Float64MultiArray | distance of each candidate [m]; its label lists the names |
    | `/touch_mode` | Float64MultiArray | likewise, what it does, see `Trajectory` |
    | `/touch_margin` | Float64MultiArray | likewise, by how much its force keeps that [N] |
    | `/touch_status` | Float64MultiArray | one number, whether the forces are unique |
    | `/base_pose` | PoseStamped | the frame of a trunk's floating base in `world`, if there is one |
    | `/tf` | TFMessage | `world` > `ARM` > `ARM/link1` ... > `ARM/tip`; `world` > `object` > `object/ARM` (contact) |

    A trunk's frames are `world` > `trunk` > `trunk/link1` ...; the parent of an arm on it is the link on which the arm
    is mounted. Times are those of the run, starting from 0, in nanoseconds. Characters that ROS does not allow in topic
    names are replaced by '_', with more of them where two names would be equal. Numbers are bit for bit those of the
    run.

    Args:
        chain: the chain that was simulated.
        run: its run.
        path: path of the file.
        base_motion: as for `simulate`.

    Raises:
        MissingExtra: mcap-ros2-support is not installed.
        ModelError: a base motion is given for an arm that does not exist.
        StateError: `run` is not a run of this chain.
        ResultError: the file cannot be written.
    """
    try:
        from mcap_ros2.writer import Writer
    except ImportError as cause:
        raise MissingExtra("MCAP files need mcap-ros2-support; try pip install 'holdfast[ros]'") from cause
    serial_chain(chain, "write_mcap: chain")
    require_run_of(chain, run)
    place, environment = file_path(path, "path"), Environment(chain, base_motion or {})

    def write(file: IO[bytes]) -> None:
        writer = Writer(file)
        kinds = (JOINT_MESSAGE, POSE_MESSAGE, WRENCH_MESSAGE, TRANSFORM_MESSAGE)
        kinds = kinds if chain.touching is None else (*kinds, NUMBERS_MESSAGE)
        schemas = {kind: writer.register_msgdef(kind, definition(kind)) for kind in kinds}
        for k, t in enumerate(run.t.tolist()):
            time = round(t * 1e9)
            for topic, kind, content in _messages(environment.chain_at(t), run, k, time):
                writer.write_message(topic, schemas[kind], content, log_time=time, publish_time=time, sequence=k)
        writer.finish()

    write_atomically(place, write)


def _messages(chain: ClosedChain, run: Trajectory, k: int, time: int) -> Iterator[Message]:
    """Yield the messages of sample k.

    Args:
        chain: the chain, with its bases at their poses in the sample.
        run: the run.
        k: index of the sample.
        time: time of the sample [ns].
    """
    names = chain.joint_names()
    joints = {"position": run.q[k].tolist(), "velocity": run.qd[k].tolist(), "effort": run.tau[k].tolist()}
    yield "/joint_states", JOINT_MESSAGE, {"header": _header(time, ""), "name": names, **joints}
    yield "/object_pose", POSE_MESSAGE, _pose(time, "world", run.object_pose[k])
    if chain.floats:
        yield "/base_pose", POSE_MESSAGE, _pose(time, "world", run.base_pose[k])
    transforms = [_transform(time, "world", "object", Pose.from_wxyz_xyz(run.object_pose[k]))]
    for name, grasp in chain.grasps.items():
        transforms.append(_transform(time, "object", f"object/{name}", grasp.frame))
    state, bodies = run.state(k), trunk_frames(chain)
    if chain.trunk is not None:
        base = chain.trunk.base if state.base_frame is None else state.base_frame
        moved = _frames(TRUNK, chain.trunk.joints, chain.trunk.links, state.q[chain.joints[TRUNK]])
        transforms += [_transform(time, *frames) for frames in (("world", TRUNK, base), *moved)]
    tips, topics = tip_frames(chain, state, chain.names), _topic_names(chain.names)
    for i, (name, arm) in enumerate(chain.arms.items()):
        for what, wrenches in (("grasp_wrench", run.grasp_wrench), ("internal_wrench", run.internal_wrench)):
            yield (
                f"/{topics[name]}/{what}",
                WRENCH_MESSAGE,
                _wrench(time, f"{name}/tip", unrotate(tips[name].R, wrenches[k, i])),
            )
        below = bodies[chain.mounted_on[name]] if name in chain.mounts else "world"
        moved = list(_frames(name, arm.joints, arm.links, state.q[chain.joints[name]]))
        last = moved[-1][1] if moved else name  # an anchor has no links
        placed = [(below, name, arm.base), *moved, (last, f"{name}/tip", arm.tip)]
        transforms += [_transform(time, *frames) for frames in placed]
    touches = () if chain.touching is None else chain.touching.names
    for j, topic in enumerate(_topic_names(touches).values()):
        at_point = np.concatenate([np.zeros(3), run.touch_force[k, j]])
        yield f"/touch/{topic}", WRENCH_MESSAGE, _wrench(time, "world", at_point)
    for name in TOUCH_TOPICS if touches else ():
        numbers = np.atleast_1d(getattr(run, name)[k]).astype(float).tolist()
        along = {"label": " ".join(touches), "size": len(numbers), "stride": len(numbers)}
        yield f"/{name}", NUMBERS_MESSAGE, {"layout": {"dim": [along], "data_offset": 0}, "data": numbers}
    yield "/tf", TRANSFORM_MESSAGE, {"transforms": transforms}


def _topic_names(names: Iterable[str]) -> dict[str, str]:
    """Return names that ROS allows in topics by arm name, all different."""
    found: dict[str, str] = {}
    for name in names:
        topic = re.sub(r"[^A-Za-z0-9_]", "_", name) or "_"
        while topic in found.values():
            topic += "_"
        found[name] = topic
    return found


def trunk_frames(chain: ClosedChain) -> list[str]:
    """Return the frame names of a trunk's bodies, base outward: "trunk" for a floating base, then "trunk/..."."""
    if chain.trunk is None:
        return []
    links = [f"{TRUNK}/{link.name or f'link{i + 1}'}" for i, link in enumerate(chain.trunk.links)]
    return [*([TRUNK] if chain.floats else []), *links]


def _frames(name: str, joints: Sequence[Joint], links: Sequence[Link], q: Array) -> Iterator[tuple[str, str, Pose]]:
    """Yield parent, child and the child's pose in the parent, from the base to the last link."""
    parent = name
    for i, (joint, link) in enumerate(zip(joints, links, strict=True)):
        child = f"{name}/{link.name or f'link{i + 1}'}"
        yield parent, child, Pose(*joint_placement(joint, q[i]))
        parent = child


def definition(message: str) -> str:
    """Return the definition of a message, followed by those of all its parts, as in MCAP files."""
    parts = [message]
    for part in parts:  # the loop appends to this list
        kinds = (line.split()[0].removesuffix("[]") for line in MESSAGE_FIELDS[part].splitlines())
        parts += [kind for kind in dict.fromkeys(kinds) if kind in MESSAGE_FIELDS and kind not in parts]
    texts = [MESSAGE_FIELDS[message], *(f"MSG: {part}\n{MESSAGE_FIELDS[part]}" for part in parts[1:])]
    return f"\n{'=' * 80}\n".join(texts) + "\n"


def _header(nanoseconds: int, frame: str) -> dict[str, Any]:
    """Return a message header with a time [ns] and a frame."""
    sec, nanosec = divmod(nanoseconds, 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def _wrench(nanoseconds: int, frame: str, moment_force: Array) -> dict[str, Any]:
    """Return a WrenchStamped from [moment; force] (6,) about a frame's origin, in its axes."""
    return {
        "header": _header(nanoseconds, frame),
        "wrench": {"force": _xyz(moment_force[3:]), "torque": _xyz(moment_force[:3])},
    }


def _pose(nanoseconds: int, frame: str, wxyz_xyz: Array) -> dict[str, Any]:
    """Return a PoseStamped from wxyz_xyz (7,) in a frame."""
    placed = {"position": _xyz(wxyz_xyz[4:]), "orientation": _xyzw(wxyz_xyz[:4])}
    return {"header": _header(nanoseconds, frame), "pose": placed}


def _transform(nanoseconds: int, parent: str, child: str, at: Pose) -> dict[str, Any]:
    """Return a TransformStamped: the pose of a child frame in its parent."""
    placed = {"translation": _xyz(at.p), "rotation": _xyzw(rotation.to_quaternion(at.R))}
    return {"header": _header(nanoseconds, parent), "child_frame_id": child, "transform": placed}


def _xyz(vector: Array) -> dict[str, float]:
    return dict(zip("xyz", vector.tolist(), strict=True))


def _xyzw(wxyz: Array) -> dict[str, float]:
    return dict(zip("wxyz", wxyz.tolist(), strict=True))
