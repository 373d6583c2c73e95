"""Starting points of searches: preferred configurations of arms, others around them, and object poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from holdfast import outer
from holdfast.assembly.limits import longest_reach, shoulder
from holdfast.compiler.elementary import LARGEST_ARGUMENT
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

WIDEST = np.pi  # rad or m: range of the search on either side of 0 for a joint without limits


def preferred_configurations(chain: ClosedChain, given: Mapping[str, Any] | None) -> dict[str, Array]:
    """Return the preferred joint positions of every arm, by name.

    These are the given ones, or the home configuration of a built-in robot, or the middle of the joint limits (0
    without limits).

    Raises:
        ModelError: a configuration is given for an unknown arm.
        StateError: a configuration has a wrong length.
    """
    given = {} if given is None else given
    if not isinstance(given, Mapping):
        raise ModelError(f"q: expected joint positions by arm name, e.g. {{'left': [...]}}, got {type(given).__name__}")
    for name in given:
        if name not in chain.arms:
            raise ModelError(f"q: no arm '{name}'.{checks.did_you_mean(str(name), chain.arms)}")
    return {
        name: preferred_positions(given[name], arm.joint_count, name) if name in given else preferred_configuration(arm)
        for name, arm in chain.arms.items()
    }


def starting_configurations(arm: Arm, preferred: Array, count: int) -> Iterator[Array]:
    """Yield joint positions to search from: the preferred ones, then seeded random ones at increasing distances."""
    low, high = _range(arm)
    yield np.clip(preferred, *arm.position_limits.T)
    random = np.random.default_rng(arm.joint_count)
    for spread in np.linspace(0.2, 1.0, count - 1):
        yield np.clip(preferred + spread * random.uniform(low - high, high - low) / 2, low, high)


def preferred_configuration(arm: Arm) -> Array:
    """Return the home configuration of a built-in robot, or the middle of the joint limits (0 without limits), (N,).

    A spherical joint is not turned, (1, 0, 0, 0).
    """
    home = outer.home_of(arm)
    if home is not None:
        return home
    middle = np.mean(_range(arm), axis=0)
    pairs = zip(arm.joints, middle, strict=True)
    return np.concatenate([[1.0, 0.0, 0.0, 0.0] if joint.type.quaternion else [x] for joint, x in pairs] or [middle])


def _range(arm: Arm) -> tuple[Array, Array]:
    """Return lowest and highest positions; an unlimited end lies `WIDEST` beyond the other end, or beyond 0."""
    low, high = arm.position_limits.T
    bounded_low = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - 2 * WIDEST, -WIDEST))
    return bounded_low, np.where(np.isfinite(high), high, bounded_low + 2 * WIDEST)


FREE_ATTITUDE = 1e-3  # weight of attitudes that a grasp leaves free, small enough not to affect others
QUARTER_TURNS = 4


def object_guesses(chain: ClosedChain, preferred: Mapping[str, Array]) -> list[Pose]:
    """Return guesses of the object's pose, the most promising first.

    * The best fit of the contact frames to the hands, for positions and attitudes together.
    * Upright poses, rotated about the vertical by quarter turns, with the centroid of the contacts at the centroid of
      the hands, and in the middle of the arms' reach.
    * The pose at which each hand whose grasp fixes an attitude would hold the object.
    """
    hands = {name: forward_kinematics(chain.arms[name], preferred[name]).tip for name in chain.grasps}
    contacts = {name: grasp.frame for name, grasp in chain.grasps.items()}
    middle = np.mean([frame.p for frame in contacts.values()], axis=0)
    centroids = [np.mean([hand.p for hand in hands.values()], axis=0), _middle_of_reach(chain)]
    guesses = [_best_fit(chain, hands)]
    for quarter in range(QUARTER_TURNS):
        R = rotation.exp(np.array([0.0, 0.0, np.pi / 2 * quarter]))
        guesses += [Pose(R, centroid - R @ middle) for centroid in centroids]
    fixing = [name for name, grasp in chain.grasps.items() if grasp.of_kind.closed_angles]
    return guesses + [hands[name] @ contacts[name].inverse() for name in fixing]


def _best_fit(chain: ClosedChain, hands: Mapping[str, Pose]) -> Pose:
    """Return the pose that fits the contacts to the hands: max tr(R^T B), with B summed over points and attitudes."""
    points = np.array([grasp.frame.p for grasp in chain.grasps.values()])
    targets = np.array([hands[name].p for name in chain.grasps])
    middle, centroid = points.mean(axis=0), targets.mean(axis=0)
    size = max(float(np.abs(points - middle).max()), 1e-3)
    B = (targets - centroid).T @ (points - middle) / size**2
    for name, grasp in chain.grasps.items():
        closed = grasp.of_kind.closed_angles  # an axis must agree if the angles about the other two are fixed
        weights = [1.0 if {0, 1, 2} - {axis} <= set(closed) else FREE_ATTITUDE for axis in range(3)]
        B += hands[name].R @ np.diag(weights) @ grasp.frame.R.T
    U, _, Vt = np.linalg.svd(B)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return Pose(R, centroid - R @ middle)


def _middle_of_reach(chain: ClosedChain) -> Array:
    """Return the centre of the arms' first joints, lifted by a third of the shortest reach along their mean z axis.

    Anchors, which have no reach, are used only if no arm with joints has a grasp.
    """
    every = [chain.arms[name] for name in chain.grasps]
    held = [arm for arm in every if arm.joints] or every
    up = np.mean([arm.base.R[:, 2] for arm in held], axis=0)
    reach = min(longest_reach(arm) for arm in held)
    lift = reach / 3 if np.isfinite(reach) else 0.0
    return np.mean([shoulder(arm) for arm in held], axis=0) + lift * up


def preferred_positions(given: Any, count: int, name: str) -> Array:
    """Return the given preferred joint positions of an arm or a trunk as an array, (count,).

    Raises:
        StateError: their number is wrong, or one is not finite or beyond `LARGEST_ARGUMENT`.
    """
    q = checks.numbers(given, (count,), f"q of '{name}'", StateError)
    if q.dtype != object and np.abs(q).max(initial=0.0) > LARGEST_ARGUMENT:
        got = checks.short(q.tolist())
        raise StateError(f"q of '{name}': expected at most {LARGEST_ARGUMENT:g} rad or m, got {got}")
    return q
