"""Springs as somebody writes them who has none: two opposite forces on a line, as inputs of time and state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.dynamics import link_poses
from holdfast.model.force_element import SpringEnd
from holdfast.spatial.scalar import sqrt


def by_hand(chain: hf.ClosedChain) -> Callable[[Any, hf.State], hf.Inputs]:
    """Return the wrenches of a chain's springs, in words that can be traced; bases stand still."""

    def acting(t: Any, state: hf.State) -> hf.Inputs:
        on_object, on_links = np.zeros(6), [np.zeros(6) for _ in range(chain.joint_count)]
        for spring in chain.springs:
            (a, v, from_a), (b, w, from_b) = (_end(chain, end, state) for end in spring.ends)
            length = sqrt((b - a) @ (b - a))
            way = (b - a) / length
            force = (spring.stiffness * (length - spring.length) + spring.damping * (way @ (w - v))) * way
            for end, lever, f in zip(spring.ends, (from_a, from_b), (force, -force), strict=True):
                wrench = np.concatenate([_cross(lever, f), f])
                if end.link is not None:
                    row = chain.joints[end.body].start + end.link_number()
                    on_links[row] = on_links[row] + wrench
                elif end.body == "object":
                    on_object = on_object + wrench
        return hf.Inputs(object_wrench=on_object, link_wrenches=np.array(on_links))

    return acting


def _end(chain: hf.ClosedChain, end: SpringEnd, state: hf.State) -> tuple[Any, Any, Any]:
    """Return where an end is, how fast it moves, and its place from its body's origin, world axes."""
    if end.body == "world":
        return end.point, np.zeros(3), end.point
    if end.link is None:
        lever, twist = state.object_frame.R @ end.point, state.object_twist
        return state.object_frame.p + lever, twist[3:] + _cross(twist[:3], lever), lever
    k, own = end.link_number(), chain.joints[end.body]
    arm = chain.arms[end.body]
    frames = link_poses(arm, state.q[own])[: k + 1]
    lever = frames[k].R @ end.point
    at, velocity = frames[k].p + lever, np.zeros(3)
    for joint, frame, rate in zip(arm.joints, frames, state.qd[own], strict=False):
        axis = frame.R @ joint.axis
        velocity = velocity + rate * (_cross(axis, at - frame.p) if joint.turns else axis)
    return at, velocity, lever


def _cross(a: Any, b: Any) -> Any:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
