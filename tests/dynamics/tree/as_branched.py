"""Serial chains that an object which nothing holds makes forests, beside what is true of the serial chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import holdfast as hf
from tests.systems.anchored import pinned, pinned_to_trunk
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem
from tests.systems.trunk_problems import random_on_trunk

STRAY = hf.HeldObject.box(3.0, 0.2, 0.3, 0.4)
AWAY = hf.Pose.translation(1.0, 2.0, 3.0)


def gap(found, wanted) -> float:
    """Return max|x - e| / max(1, max|e|)."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    assert found.shape == wanted.shape
    return float(np.abs(found - wanted).max(initial=0.0)) / max(1.0, float(np.abs(wanted).max(initial=0.0)))


def serial_problems() -> dict[str, Problem]:
    """Return serial chains with everything that moves or pushes them but springs between bodies, by name."""
    found = {
        "moving bases": random_problem(11, arms=3, moving_base=True),
        "an arm that holds nothing": random_problem(5, arms=3, grasps=("rigid", None, "hinge")),
        "anchors": pinned(random_problem(7, arms=2), ("ball",)),
        "an anchor on a trunk": pinned_to_trunk(random_on_trunk(2, 3), "ball"),
        "a floating base": random_on_trunk(4, 2, floating=True),
        "a trunk": random_on_trunk(6, 5),
    }
    return {name: replace(p, chain=replace(p.chain, springs=())) for name, p in found.items()}


def with_stray(p: Problem, wrench=(0.0,) * 6) -> tuple[hf.ClosedChain, hf.State, np.ndarray, hf.Inputs]:
    """Return the arguments of a chain beside an object that nothing holds, at rest under an external wrench."""
    pushed = p.inputs.object_wrench if p.inputs.object_wrench is not None else np.zeros(6)
    poses = [p.state.object_pose, AWAY.wxyz_xyz]
    return (
        replace(p.chain, objects={"stray": STRAY}),
        replace(p.state, object_pose=poses, object_twist=[p.state.object_twist, np.zeros(6)]),
        p.tau,
        replace(p.inputs, object_wrench=[pushed, wrench]),
    )
