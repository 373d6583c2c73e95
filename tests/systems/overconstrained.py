"""Mechanisms that move although their constraint has dependent rows, so that their grasp forces are not unique."""

from __future__ import annotations

import numpy as np
from examples.benchmarks.n_four_bar import n_four_bar

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State, Trunk, simulate
from tests.oracles.planar_mechanism import random_mechanism
from tests.systems.bricard import bricard
from tests.systems.sprung import with_springs

PITCH, PLACES = 0.2, (-0.3, 0.4)  # m/rad, m
BELOW = Pose.translation(0.3, -0.4, 0.1)


def on_threads(kind: str = "screw") -> tuple[ClosedChain, State]:
    """Return a rod on two threads along x that slides and turns while both its nuts slide, in motion.

    Args:
        kind: of the grasps, a screw, or the same motion given by hand.
    """
    turning = {"motion": np.array([[1.0, 0, 0, PITCH, 0, 0]]).T} if kind == "subspace" else {"pitch": PITCH}
    arms, grasps = {}, {}
    for name, x in zip(("left", "right"), PLACES, strict=True):
        arms[name] = Arm(
            [Joint("prismatic", (1, 0, 0))], [Link(0.5, inertia=0.01 * np.eye(3))], tip=Pose.translation(x, 0, 0)
        )
        grasps[name] = Grasp(kind, Pose.translation(x, 0, 0), **turning)
    body = HeldObject(1.0, np.diag([0.01, 0.02, 0.03]), com=(0.0, 0.05, 0.02))
    chain = ClosedChain(arms, body, grasps)
    return chain, State([0.0, 0.0], [-0.3, -0.3], Pose.identity(), [1.0, 0, 0, PITCH - 0.3, 0, 0])


def on_a_trunk(*, floating: bool) -> tuple[ClosedChain, State]:
    """Return the N-four-bar on a slide, two of its cranks on the slide itself and one in the world or on its base."""
    chain, state = n_four_bar()
    base = Link(5.0, (0.1, 0.2, 0.0), np.diag([0.3, 0.4, 0.5])) if floating else None
    trunk = Trunk([Joint("prismatic", (1, 0, 0))], [Link(3.0, (0, -0.1, 0), 0.2 * np.eye(3))], BELOW, base)
    arms = {name: arm.at(BELOW.inverse() @ arm.base) for name, arm in chain.arms.items()}
    mounts = {"A0": 0, "A2": 0, **({"A1": "base"} if floating else {})}
    below = {"base_pose": BELOW, "base_twist": np.zeros(6)} if floating else {}
    if not floating:
        arms["A1"] = chain.arms["A1"]
    moving = State([0.0, *state.q], [0.0, *state.qd], state.object_pose, state.object_twist, **below)
    return ClosedChain(arms, chain.held_object, chain.grasps, chain.gravity, trunk, mounts), moving


def falling_bricard() -> tuple[ClosedChain, State]:
    """Return Bricard's mechanism in motion, its contact frames turned about the hinges."""
    chain, state = bricard((0.3, 1.1))
    return chain, simulate(chain, state, lambda t, now, memory: (0.0 * now.qd, memory), 0.5, 1e-2).state(-1)


def sprung_bricard() -> tuple[ClosedChain, State]:
    """Return the same between springs and dampers."""
    chain, state = falling_bricard()
    return with_springs(chain), state


MECHANISMS = {
    "N-four-bar": n_four_bar,
    "Bricard": falling_bricard,
    "springs": sprung_bricard,
    "planar": lambda: random_mechanism(3).chain(),
    "soft fingers": lambda: random_mechanism(0, ["softfinger"]).chain(),
    "threads": on_threads,
    "threads by hand": lambda: on_threads("subspace"),
    "on a trunk": lambda: on_a_trunk(floating=False),
    "floating": lambda: on_a_trunk(floating=True),
}
