"""A run as an MCAP file of ROS 2 messages, for Foxglove, PlotJuggler, rosbags and ROS itself."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from os import PathLike
from typing import IO, Any

from holdfast.dynamics.arm.posture import Posture, joint_placement, posture
from holdfast.errors import MissingExtra
from holdfast.interop import ros_messages
from holdfast.interop.ros_messages import JOINT_STATE, POSE, TRANSFORMS, WRENCH
from holdfast.io.atomic import write_atomically
from holdfast.io.path import file_path
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.environment import BaseMotion, Environment
from holdfast.simulation.trajectory import Trajectory, require_run_of
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import unrotate

Message = tuple[str, str, dict[str, Any]]  # topic, kind, content


def write_mcap(
    chain: ClosedChain, run: Trajectory, path: str | PathLike[str], base_motion: Mapping[str, BaseMotion] | None = None
) -> None:
    """Write a run as an MCAP file; what is there is replaced. A message of each topic for every sample.

    | topic | message | holds |
    |---|---|---|
    | `/joint_states` | JointState | all joints as 'arm/joint': q, qd, tau |
    | `/object_pose` | PoseStamped | the object's frame in `world` |
    | `/ARM/grasp_wrench` | WrenchStamped | of the arm on the object, about the tip's origin, in `ARM/tip` axes |
    | `/ARM/internal_wrench` | WrenchStamped | the part of it that moves nothing |
    | `/tf` | TFMessage | `world` > `ARM` > `ARM/link1` ... > `ARM/tip`; `world` > `object` > `object/ARM` (contact) |

    Times are the run's, from 0 on, to the nanosecond. In names of topics, what ROS does not
    allow there becomes '_'. Numbers are bit for bit those of the run.

    Args:
        chain: the chain that was simulated.
        run: its run.
        path: of the file.
        base_motion: as for `simulate`.

    Raises:
        MissingExtra: mcap-ros2-support is not installed.
        ModelError: a moving base of no arm.
        StateError: what is no run, or not of this chain.
        ResultError: the file cannot be written.
    """
    try:
        from mcap_ros2.writer import Writer
    except ImportError as cause:
        raise MissingExtra("MCAP files need mcap-ros2-support; try pip install 'holdfast[ros]'") from cause
    require_run_of(chain, run)
    place, world = file_path(path, "path"), Environment(chain, base_motion or {})

    def write(file: IO[bytes]) -> None:
        writer = Writer(file)
        kinds = (JOINT_STATE, POSE, WRENCH, TRANSFORMS)
        schemas = {kind: writer.register_msgdef(kind, ros_messages.definition(kind)) for kind in kinds}
        for k, t in enumerate(run.t.tolist()):
            time = round(t * 1e9)
            for topic, kind, content in _messages(world.at(t)[0], run, k, time):
                writer.write_message(topic, schemas[kind], content, log_time=time, publish_time=time, sequence=k)
        writer.finish()

    write_atomically(place, write)


def _messages(chain: ClosedChain, run: Trajectory, k: int, time: int) -> Iterator[Message]:
    """Yield everything that sample k says.

    Args:
        chain: the chain, its bases where they are then.
        run: the run.
        k: the sample.
        time: [ns].
    """
    names = chain.joint_names()
    yield "/joint_states", JOINT_STATE, ros_messages.joint_state(time, names, run.q[k], run.qd[k], run.tau[k])
    yield "/object_pose", POSE, ros_messages.pose(time, "world", run.object_pose[k])
    transforms = [ros_messages.transform(time, "world", "object", Pose.from_wxyz_xyz(run.object_pose[k]))]
    for name, grasp in chain.grasps.items():
        transforms.append(ros_messages.transform(time, "object", f"object/{name}", grasp.frame))
    for i, (name, arm) in enumerate(chain.arms.items()):
        q = run.q[k, chain.joints[name]]
        at = posture(arm, q)
        for what, wrenches in (("grasp_wrench", run.grasp_wrench), ("internal_wrench", run.internal_wrench)):
            topic = f"/{re.sub(r'[^A-Za-z0-9_]', '_', name)}/{what}"
            yield topic, WRENCH, ros_messages.wrench(time, f"{name}/tip", _in_tip_axes(at, wrenches[k, i]))
        transforms += [ros_messages.transform(time, *frames) for frames in _frames(name, arm, q)]
    yield "/tf", TRANSFORMS, {"transforms": transforms}


def _frames(name: str, arm: Arm, q: Array) -> Iterator[tuple[str, str, Pose]]:
    """Yield parent, child and the child's pose in the parent, from the base to the tip."""
    yield "world", name, arm.base
    parent = name
    for i, (joint, link) in enumerate(zip(arm.joints, arm.links, strict=True)):
        child = f"{name}/{link.name or f'link{i + 1}'}"
        yield parent, child, Pose(*joint_placement(joint, q[i]))
        parent = child
    yield parent, f"{name}/tip", arm.tip


def _in_tip_axes(at: Posture, moment_force: Array) -> Array:
    """Return a world-axes wrench about the tip's origin in tip axes."""
    return unrotate(at.tip.R, moment_force)
