"""Completing a recording with rates, accelerations and the object's motion, which follow from its positions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast.errors import StateError
from holdfast.identification.instants import tips
from holdfast.identification.recording import FEWEST_SAMPLES, Recording
from holdfast.identification.smoothing import Spline, smoothing_spline
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array

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
    found = _object_motion(chain, rigid, given)
    return replace(given, **{name: found[name] for name in lacking})


def _object_motion(chain: ClosedChain, rigid: list[str], given: Recording) -> dict[str, Array]:
    """Return the motion of the object that is not recorded, from the tips that hold it rigidly.

    The pose follows from the first of these tips; twist and acceleration are least-squares fits to all of them.
    """
    places = [list(chain.grasps).index(name) for name in rigid]
    R, p, twists, accelerations = (x[:, places] for x in tips(chain, given).values())
    if given.object_pose is None:
        inverse = chain.grasps[rigid[0]].frame.inverse()
        turns, points = R[:, 0] @ inverse.R, p[:, 0] + R[:, 0] @ inverse.p
        poses = np.column_stack([[rotation.to_quaternion(turn) for turn in turns], points])
    else:
        poses = given.object_pose
        unit = poses[:, :4] / np.linalg.norm(poses[:, :4], axis=1, keepdims=True)
        turns = np.array([rotation.from_quaternion(wxyz) for wxyz in unit])
    offsets = np.einsum("sij,gj->sgi", turns, [chain.grasps[name].frame.p for name in rigid])
    A = np.tile(np.eye(6), (*offsets.shape[:2], 1, 1))
    A[:, :, 3:, :3] = np.cross(np.eye(3), offsets[:, :, None]).swapaxes(2, 3)  # w x l
    A = A.reshape(len(given), -1, 6)
    fit = np.linalg.pinv(A)

    def fitted(x: Array) -> Array:
        return np.einsum("sir,sr->si", fit, x.reshape(len(given), -1))

    found = {"object_pose": poses, "object_twist": fitted(twists) if given.object_twist is None else given.object_twist}
    w = found["object_twist"][:, None, :3]
    centripetal = np.cross(w, np.cross(w, offsets))
    return found | {"object_acceleration": fitted(accelerations - np.concatenate([0.0 * centripetal, centripetal], 2))}
