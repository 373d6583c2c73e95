"""Completing a recording with rates, accelerations and the object's motion, which follow from its positions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from holdfast.errors import StateError
from holdfast.identification.recording import FEWEST_SAMPLES, Recording
from holdfast.identification.smoothing import Spline, smoothing_spline
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import twist_shift
from holdfast.state import Inputs, State

OBJECT_MOTION = ("object_pose", "object_twist", "object_acceleration")
FLOATING_MOTION = ("base_pose", "base_twist", "base_acceleration")


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Arrays of a recording that were computed with smoothing splines through one that was recorded.

    Attributes:
        names: the arrays that are the splines' values and their derivatives, in order.
        splines: one for each joint.
    """

    names: tuple[str, ...]
    splines: list[Spline]


def differentiated(given: Recording) -> tuple[Recording, list[Smoothed]]:
    """Return a recording with joint rates and accelerations, and what was smoothed to find them.

    Raises:
        StateError: there are too few samples for a spline.
    """
    if given.qd is not None and given.qdd is not None:
        return given, []
    if len(given) < FEWEST_SAMPLES:
        raise StateError(f"recording: expected qd and qdd, or {FEWEST_SAMPLES} samples to find them, got {len(given)}")
    if given.qd is not None:
        sources = [("q",), ("qd", "qdd")]
    else:
        sources = [("q", "qd", "qdd") if given.qdd is None else ("q", "qd")]
    found, made = [], {}
    for names in sources:
        splines = [smoothing_spline(given.t, column) for column in getattr(given, names[0]).T]
        made |= {name: np.column_stack([one.values[k] for one in splines]) for k, name in enumerate(names)}
        found.append(Smoothed(names, splines))
    return replace(given, **made), found


def completed(chain: ClosedChain, given: Recording) -> Recording:
    """Return a recording, which has joint rates and accelerations, with the object's motion.

    Args:
        chain: the recorded chain.
        given: the recording.

    Raises:
        StateError: the motion of a floating base was not recorded, or the object's motion was neither recorded nor
            follows from a rigid grasp.
    """
    if chain.floats and (unknown := [name for name in FLOATING_MOTION if getattr(given, name) is None]):
        raise StateError(f"recording: expected {', '.join(unknown)}, as the trunk's base floats; got none")
    lacking = [name for name in OBJECT_MOTION if getattr(given, name) is None]
    if not lacking:
        return given
    rigid = [name for name, grasp in chain.grasps.items() if not grasp.free]
    if not rigid:
        raise StateError(f"recording: expected {', '.join(lacking)}, as no grasp is rigid and would give it; got none")
    rows = [_object_motion(chain, rigid, given, k) for k in range(len(given))]
    found = {name: np.array(parts) for name, parts in zip(OBJECT_MOTION, zip(*rows, strict=True), strict=True)}
    return replace(given, **{name: found[name] for name in lacking})


def _object_motion(chain: ClosedChain, rigid: list[str], given: Recording, k: int) -> tuple[Array, Array, Array]:
    """Return pose, twist and acceleration of the object in a sample, from the tips that hold it rigidly.

    The pose follows from the first of these tips; twist and acceleration are least-squares fits to all of them.
    """
    assert given.qd is not None and given.qdd is not None
    inputs = (given.inputs or Inputs()).shaped(chain)
    q, qd, qdd = given.q[k], given.qd[k], given.qdd[k]

    def moving(pose: Array, twist: Array) -> ChainMotion:
        state = given.on_base(k, State(q, qd, pose, twist))
        return chain_motion(chain, state, np.zeros(chain.joint_count), inputs)

    pose = np.r_[1.0, np.zeros(6)]
    arms = moving(pose, np.zeros(6)).arms
    if given.object_pose is None:
        pose = (arms[rigid[0]].at.tip @ chain.grasps[rigid[0]].frame.inverse()).wxyz_xyz
    else:
        pose = given.object_pose[k]
    R = Pose.from_wxyz_xyz(pose).R
    A = np.concatenate([twist_shift(R @ chain.grasps[name].frame.p) for name in rigid])
    twists = np.concatenate([arms[name].tip_twist for name in rigid])
    twist = np.linalg.lstsq(A, twists, rcond=None)[0] if given.object_twist is None else given.object_twist[k]
    found = moving(pose, twist)
    carried = found.trunk.carried(qdd, None if given.base_acceleration is None else given.base_acceleration[k])
    centripetal = {c: held.a for c, held in zip(chain.grasps, found.contacts, strict=True)}
    tips = []
    for name in rigid:
        tips.append(tip_acceleration(arms[name], qdd[chain.joints[name]], carried.get(name)) - centripetal[name])
    return pose, twist, np.linalg.lstsq(A, np.concatenate(tips), rcond=None)[0] + pseudo_gravity(chain)
