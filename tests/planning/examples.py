"""Chains and paths for tests of joint paths, and the resolution that looks at nothing but the sample before."""

from __future__ import annotations

import functools

import numpy as np

import holdfast as hf
from holdfast.control import RestToRest
from holdfast.dynamics import Posture
from holdfast.dynamics.near_singular import weakest_strength

TRAY = hf.HeldObject.box(4.0, 0.3, 0.5, 0.1)
GRASPS = {
    "left": hf.Grasp("rigid", hf.contact_frame([0, 0.2, 0.05], into=[0, 0, -1])),
    "right": hf.Grasp("rigid", hf.contact_frame([0, -0.2, 0.05], into=[0, 0, -1])),
}


def arms_of(robot: str, height: float = 0.0) -> dict[str, hf.Arm]:
    """Return two arms beside each other."""
    make = hf.robots.ROBOTS[robot]
    return {name: make(hf.Pose.translation(0, y, height)) for name, y in (("left", 0.3), ("right", -0.3))}


@functools.cache
def two_arms(robot: str) -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms that hold a tray from above."""
    chain, state = hf.assemble(arms_of(robot), TRAY, GRASPS, object_pose=hf.Pose.translation(0.5, 0, 0.35))
    return chain, state


@functools.cache
def mobile() -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms on a platform that drives along x and y and turns, in their cheapest posture."""
    axes = [
        hf.Joint("prismatic", axis=[1, 0, 0], name="x"),
        hf.Joint("prismatic", axis=[0, 1, 0], name="y"),
        hf.Joint("revolute", name="yaw"),
    ]
    frame, body = hf.Link(1.0, inertia=0.01 * np.eye(3)), hf.Link(60.0, inertia=np.diag([2.0, 2.0, 3.0]), name="deck")
    chain, state = hf.assemble(
        arms_of("panda", 0.4),
        TRAY,
        GRASPS,
        object_pose=hf.Pose.translation(0.5, 0, 0.8),
        trunk=hf.Trunk(axes, [frame, frame, body]),
        mounts={"left": "deck", "right": "deck"},
        posture=Posture(),
    )
    return chain, state


def carried(state: hf.State, displacement, turn=(0, 0, 0), duration: float = 2.0) -> RestToRest:
    """Return a path of the object from a state."""
    return RestToRest(state.object_frame, displacement, turn=turn, duration=duration)


def plainly_followed(chain: hf.ClosedChain, state: hf.State, path: RestToRest, count: int) -> tuple[float, float]:
    """Return the least distance from a limit, relative to the range, and the least strength without redundancy.

    Each sample is the closed configuration nearest to the one before, whatever the limits.
    """
    low, high = chain.position_limits.T
    states = nearest_states(chain, state, path, np.linspace(0.0, path.duration, count))[1:]
    rooms = [float(np.min(np.minimum(one.q - low, high - one.q) / (high - low))) for one in states]
    return min(rooms), min(weakest_strength(chain, one) for one in states)


def nearest_states(chain: hf.ClosedChain, state: hf.State, path: RestToRest, times: np.ndarray) -> list[hf.State]:
    """Return closed states at some times, the first as given, each the nearest to the one before."""
    found = [state]
    for t in times[1:]:
        guess = hf.State(found[-1].q, 0 * state.q, path.at(float(t)).pose)
        found.append(hf.close(chain, guess, hold_object=True, hold_trunk=False, limits=False))
    return found
