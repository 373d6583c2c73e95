"""The frames of rigid grasps, from the poses of tips and object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.dynamics.contact_places import tip_frames
from holdfast.errors import StateError
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State


def measured_grasps(chain: ClosedChain, recordings: list[Recording]) -> tuple[ClosedChain, dict[str, Array]]:
    """Return the chain with the mean frames of its rigid grasps, from the poses of the tips, and their deviations.

    No force measurement is needed. If the object's pose was not recorded, it is computed from the first of these arms,
    which keeps its frame.

    Args:
        chain: the chain with the model's frames.
        recordings: recordings of which all or none have the object's pose.

    Returns:
        The chain, and by arm the standard deviations (6,) of the mean, [turn; shift], object axes [rad, m].

    Raises:
        StateError: only some recordings have the object's pose, or no frame can be identified.
    """
    rigid = [name for name, grasp in chain.grasps.items() if not grasp.free]
    posed = [recording.object_pose is not None for recording in recordings]
    if any(posed) != all(posed):
        raise StateError("identify: grasp_frames: expected object_pose in all recordings or in none, got it in some")
    sought = rigid if all(posed) else rigid[1:]
    if not sought:
        raise StateError(
            "identify: grasp_frames: expected two rigid grasps, or object_pose and one, as a tip's pose against the"
            " object says where it holds; got neither"
        )
    found = {name: [] for name in sought}
    for recording in recordings:
        for k, q in enumerate(fitting(chain, recording).q):
            state = recording.on_base(k, State(q, 0.0 * q, np.r_[1.0, np.zeros(6)]))
            tips = tip_frames(chain, state, rigid)
            if recording.object_pose is None:
                seen = tips[rigid[0]] @ chain.grasps[rigid[0]].frame.inverse()
            else:
                seen = Pose.from_wxyz_xyz(recording.object_pose[k])
            for name in sought:
                found[name].append(seen.inverse() @ tips[name])
    grasps, deviations = dict(chain.grasps), {}
    for name, poses in found.items():
        mean = Pose(
            rotation.nearest(np.mean([pose.R for pose in poses], axis=0)), np.mean([pose.p for pose in poses], axis=0)
        )
        off = np.array([np.r_[rotation.log(pose.R @ mean.R.T), pose.p - mean.p] for pose in poses])
        deviations[name] = np.sqrt((off**2).sum(axis=0) / max(len(poses) - 1, 1) / len(poses))
        grasps[name] = replace(chain.grasps[name], frame=mean)
    return replace(chain, grasps=grasps), deviations


def fitting(chain: ClosedChain, one: Recording) -> Recording:
    """Return a recording with as many joints as the chain; refuse others."""
    if one.q.shape[1] != chain.joint_count:
        raise StateError(f"recording: q: expected {chain.joint_count} joints, got {one.q.shape[1]}")
    return one
