"""IFToMM's four-bar linkage as two cranks that hold its third rod as an object, with its spring as one of the chain."""

from __future__ import annotations

import numpy as np
from examples.benchmarks.four_bar import FLAT, HINGE

import holdfast as hf


def held_four_bar(damping: float = 0.0) -> hf.ClosedChain:
    """Return the linkage with the damper beside the spring."""
    crank = hf.Arm(
        [hf.Joint("revolute", (0, 0, 1))], [hf.Link(1.0, (0.5, 0, 0), FLAT)], tip=hf.Pose(HINGE, (1.0, 0, 0))
    )
    rod = hf.HeldObject(1.0, FLAT)
    grasps = {name: hf.Grasp("hinge", hf.Pose(HINGE, (x, 0, 0))) for name, x in (("A-B", -0.5), ("D-C", 0.5))}
    arms = {"A-B": crank, "D-C": crank.at(hf.Pose.translation(1.0, 0, 0))}
    spring = hf.Spring(("world", (0, 0, 0)), ("object", (0.5, 0, 0)), 25.0, np.sqrt(2.0), damping)
    return hf.ClosedChain(arms, rod, grasps, gravity=(0, -9.81, 0), springs=[spring])


def held_state(angle: float, rate: float = 0.0) -> hf.State:
    """Return the state with both cranks at an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return hf.State([angle] * 2, [rate] * 2, [1, 0, 0, 0, 0.5 + c, s, 0], [0, 0, 0, -s * rate, c * rate, 0])
