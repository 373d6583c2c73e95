"""Chains with springs between world, links and object, and these springs as somebody writes them who has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import ClosedChain, Spring
from holdfast.dynamics import link_poses
from holdfast.model.force_element import SpringEnd
from holdfast.spatial.scalar import sqrt


def with_springs(chain: ClosedChain, seed: int = 0, *, damped: bool = True) -> ClosedChain:
    """Return the chain with springs between all kinds of bodies, of random ends and sizes.

    Args:
        chain: a chain of two arms or more, each of two links or more.
        seed: of the numbers.
        damped: with dampers.
    """
    rng, (first, second) = np.random.default_rng(seed), list(chain.arms)[:2]
    last = chain.arms[first].joint_count - 1
    pairs = [
        (("world",), ("object",)),
        (("world",), (first, last)),
        (("object",), (second, 0)),
        ((first, 1), (second, 1)),
        ((first, 0), (first, last)),
        (("object",), ("world",)),
    ]
    springs = [
        Spring((*a, rng.normal(size=3)), (*b, 0.3 * rng.normal(size=3)), k, length, c if damped else 0.0)
        for (a, b), k, length, c in zip(
            pairs, rng.uniform(20, 80, 6), [*rng.uniform(0.1, 0.9, 5), 0.0], rng.uniform(0.2, 2.0, 6), strict=True
        )
    ]
    return replace(chain, springs=springs)


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
