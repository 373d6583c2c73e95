"""A three-finger hand that holds a ball between its fingertips."""

from __future__ import annotations

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.grasp import Friction, Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.robots.mechanism import Mechanism
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

PALM_RADIUS = 0.06  # of the knuckles [m]
PHALANGES = (0.055, 0.05)  # [m]
FINGER_RADIUS = 0.009  # [m]
# name, axis in a finger's axes (z along it, x away from the palm's middle), limits [rad], effort [N m];
# the middle of the limits is a pinch
JOINTS = (
    ("swing", (1.0, 0.0, 0.0), (-0.4, 0.4), 0.7),
    ("twist", (0.0, 0.0, 1.0), (-0.6, 0.6), 0.4),
    ("bend", (0.0, -1.0, 0.0), (-1.2, 0.6), 1.2),
    ("curl", (0.0, -1.0, 0.0), (0.0, 2.5), 0.7),
)
LINKS = (("knuckle", 0.02, 0.02), ("base", 0.02, 0.02), ("proximal", 0.05, 0.055), ("distal", 0.035, 0.05))  # kg, m
FEET = (0.0, 0.0, 0.0, PHALANGES[0])  # of each link along its parent's z [m]
CONTACT = Friction(mu=0.8, torsion_radius=0.006)
UP = np.array([0.0, 0.0, 1.0])


def three_finger_hand(mass: float = 0.15, radius: float = 0.035) -> Mechanism:
    """Return a hand that opens upward, palm at the world's origin, and a ball for its fingertips.

    Every finger is an arm of four joints: two at the knuckle swing and twist it, two bend it
    inward. It touches the ball's equator with a soft fingertip, which presses, holds friction
    and a little moment about the normal. Six mobilities: the ball can be moved at will.

    Args:
        mass: of the ball, solid and uniform [kg].
        radius: of the ball [m].

    Raises:
        ModelError: a mass or radius that is not positive.

    Reference:
        Three fingertips around an object: J. K. Salisbury, J. J. Craig, "Articulated hands: force
        control and kinematic issues", International Journal of Robotics Research 1(1), 1982.
        Sizes, masses and friction are our own, those of a large human hand and rubber.
    """
    arms, grasps = {}, {}
    for k in range(3):
        turn = rotation.exp(2 * np.pi / 3 * k * UP)
        outward = turn[:, 0]
        arms[f"finger{k + 1}"] = _finger(Pose(turn, PALM_RADIUS * outward))
        inward = Pose(np.stack([turn[:, 2], turn[:, 1], -turn[:, 0]], axis=1), radius * outward)
        grasps[f"finger{k + 1}"] = Grasp("softfinger", inward, CONTACT)
    return Mechanism(arms, HeldObject(mass, 0.4 * mass * radius**2 * np.eye(3)), grasps)


def _finger(base: Pose) -> Arm:
    """Return a finger along z of its base, x pointing away from the palm's middle."""
    joints = [
        Joint("revolute", np.array(axis), Pose.translation(0.0, 0.0, foot), name, limits, 6.0, effort)
        for (name, axis, limits, effort), foot in zip(JOINTS, FEET, strict=True)
    ]
    links = [_phalanx(name, mass, length) for name, mass, length in LINKS]
    return Arm(joints, links, Pose.translation(0.0, 0.0, PHALANGES[1]), base, name="finger")


def _phalanx(name: str, mass: float, length: float) -> Link:
    """Return a solid cylinder along z."""
    across = mass * (3 * FINGER_RADIUS**2 + length**2) / 12
    inertia: Array = np.diag([across, across, mass * FINGER_RADIUS**2 / 2])
    return Link(mass, length / 2 * UP, inertia, name)
