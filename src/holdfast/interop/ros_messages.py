"""The ROS 2 messages that a run is written as: their definitions, and messages from arrays."""

from __future__ import annotations

from typing import Any

from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

JOINT_STATE = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"

# What each message is made of; a definition in a file has those of its parts after it.
FIELDS = {
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
    JOINT_STATE: ("std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"),
    WRENCH: "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    POSE: "std_msgs/Header header\ngeometry_msgs/Pose pose",
    TRANSFORMS: "geometry_msgs/TransformStamped[] transforms",
}


def definition(message: str) -> str:
    """Return the definition of a message with those of all its parts, as MCAP files carry it."""
    parts = [message]
    for part in parts:  # grows
        kinds = (line.split()[0].removesuffix("[]") for line in FIELDS[part].splitlines())
        parts += [kind for kind in dict.fromkeys(kinds) if kind in FIELDS and kind not in parts]
    texts = [FIELDS[message], *(f"MSG: {part}\n{FIELDS[part]}" for part in parts[1:])]
    return f"\n{'=' * 80}\n".join(texts) + "\n"


def header(nanoseconds: int, frame: str) -> dict[str, Any]:
    """Return the header of something at a time [ns], in the axes of a frame."""
    sec, nanosec = divmod(nanoseconds, 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def joint_state(nanoseconds: int, names: list[str], q: Array, qd: Array, tau: Array) -> dict[str, Any]:
    """Return a JointState; q, qd, tau are (n,)."""
    return {
        "header": header(nanoseconds, ""),
        "name": names,
        "position": q.tolist(),
        "velocity": qd.tolist(),
        "effort": tau.tolist(),
    }


def wrench(nanoseconds: int, frame: str, moment_force: Array) -> dict[str, Any]:
    """Return a WrenchStamped from [moment; force] (6,) about a frame's origin, in its axes."""
    return {
        "header": header(nanoseconds, frame),
        "wrench": {"force": _xyz(moment_force[3:]), "torque": _xyz(moment_force[:3])},
    }


def pose(nanoseconds: int, frame: str, wxyz_xyz: Array) -> dict[str, Any]:
    """Return a PoseStamped from wxyz_xyz (7,) in a frame."""
    placed = {"position": _xyz(wxyz_xyz[4:]), "orientation": _xyzw(wxyz_xyz[:4])}
    return {"header": header(nanoseconds, frame), "pose": placed}


def transform(nanoseconds: int, parent: str, child: str, at: Pose) -> dict[str, Any]:
    """Return a TransformStamped: where a child frame is in its parent."""
    placed = {"translation": _xyz(at.p), "rotation": _xyzw(rotation.to_quaternion(at.R))}
    return {"header": header(nanoseconds, parent), "child_frame_id": child, "transform": placed}


def _xyz(vector: Array) -> dict[str, float]:
    return dict(zip("xyz", vector.tolist(), strict=True))


def _xyzw(wxyz: Array) -> dict[str, float]:
    return dict(zip("wxyz", wxyz.tolist(), strict=True))
