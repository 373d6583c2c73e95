"""Where the object may be, judged by where the arms' hands are when they are in a preferred posture."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.assembly.reach import longest_reach
from holdfast.dynamics.arm.posture import posture
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

FREE_ATTITUDE = 1e-3  # weight of attitudes that a grasp leaves free: decides only what nothing else does
QUARTER_TURNS = 4


def object_guesses(chain: ClosedChain, preferred: Mapping[str, Array]) -> list[Pose]:
    """Return poses of the object to close the chains from, the likeliest first.

    * The best fit: contact frames on the hands, points and attitudes together.
    * Upright, turned about the vertical by quarters of a turn, its contacts' centroid at the
      hands' centroid, and in the middle of what the arms reach.
    * Where each hand whose grasp fixes an attitude would hold it.
    """
    hands = {name: posture(chain.arms[name], preferred[name]).tip for name in chain.grasps}
    contacts = {name: grasp.frame for name, grasp in chain.grasps.items()}
    middle = np.mean([frame.p for frame in contacts.values()], axis=0)
    centroids = [np.mean([hand.p for hand in hands.values()], axis=0), _middle_of_reach(chain)]
    guesses = [_best_fit(chain, hands)]
    for quarter in range(QUARTER_TURNS):
        R = rotation.exp(np.array([0.0, 0.0, np.pi / 2 * quarter]))
        guesses += [Pose(R, centroid - R @ middle) for centroid in centroids]
    fixing = [name for name, grasp in chain.grasps.items() if grasp.kind in ("rigid", "hinge")]
    return guesses + [hands[name] @ contacts[name].inverse() for name in fixing]


def _best_fit(chain: ClosedChain, hands: Mapping[str, Pose]) -> Pose:
    """Return the pose that brings contacts to hands: max tr(R^T B), B summed over points and attitudes."""
    points = np.array([grasp.frame.p for grasp in chain.grasps.values()])
    targets = np.array([hands[name].p for name in chain.grasps])
    middle, centroid = points.mean(axis=0), targets.mean(axis=0)
    size = max(float(np.abs(points - middle).max()), 1e-3)
    B = (targets - centroid).T @ (points - middle) / size**2
    for name, grasp in chain.grasps.items():
        weights = np.array([FREE_ATTITUDE if grasp.kind in ("softfinger", "ball") else 1.0] * 3)
        if grasp.kind == "hinge":
            weights[1:] = FREE_ATTITUDE
        B += hands[name].R @ np.diag(weights) @ grasp.frame.R.T
    U, _, Vt = np.linalg.svd(B)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return Pose(R, centroid - R @ middle)


def _middle_of_reach(chain: ClosedChain) -> Array:
    """Return the point between the arms' shoulders, lifted by a third of the shortest reach along their mean z."""
    held = [chain.arms[name] for name in chain.grasps]
    shoulders = [arm.base @ arm.joints[0].placement for arm in held]
    up = np.mean([arm.base.R[:, 2] for arm in held], axis=0)
    reach = min(longest_reach(arm) for arm in held)
    lift = reach / 3 if np.isfinite(reach) else 0.0
    return np.mean([shoulder.p for shoulder in shoulders], axis=0) + lift * up
