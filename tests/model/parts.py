"""Small parts to build models from."""

import numpy as np

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose

BOX = HeldObject.box(3.0, 0.4, 0.3, 0.2)


def bar(length: float = 0.5) -> Link:
    """Return a link of 2 kg along its x axis."""
    return Link(2.0, [length / 2, 0.0, 0.0], np.diag([0.01, 0.05, 0.05]))


def arm(count: int = 2, name: str = "") -> Arm:
    """Return a planar arm of half-metre links."""
    half = Pose.translation(0.5, 0.0, 0.0)
    joints = [Joint("revolute", [0.0, 0.0, 1.0], half if k else Pose.identity()) for k in range(count)]
    return Arm(joints, [bar()] * count, tip=half, name=name)


def chain(**counts: int) -> ClosedChain:
    """Return arms of the given joint counts, all holding the box by ball grasps."""
    return ClosedChain({n: arm(c) for n, c in counts.items()}, BOX, {n: Grasp("ball") for n in counts})
