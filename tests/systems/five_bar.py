"""A planar five-bar linkage as a closed chain: two arms of two joints, one object, two freedoms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Joint, Link, Pose, State

ACROSS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # its x axis is the world's z


@dataclass(frozen=True)
class Bar:
    """A link: length [m], mass [kg], mass centre from its joint [m], inertia about it [kg m^2]."""

    length: float
    mass: float
    com: complex
    inertia: float


@dataclass(frozen=True)
class FiveBar:
    """The linkage, in the complex plane; gravity along -y, angles from x.

    The left arm holds the object rigidly, in its outer link's attitude, the right one by a hinge.
    The right arm is long enough never to be outstretched, whatever the left one does.

    Attributes:
        bars: left inner and outer, right inner and outer.
        span: from the left base pivot to the right one, along x [m].
        object_mass, object_inertia: about its mass centre, which is C [kg, kg m^2].
        left, right: contacts from C in object axes [m].
    """

    bars: tuple[Bar, Bar, Bar, Bar] = (
        Bar(0.5, 2.0, 0.23 + 0.01j, 0.05),
        Bar(0.4, 1.2, 0.19 - 0.02j, 0.02),
        Bar(1.1, 2.1, 0.45 + 0.03j, 0.21),
        Bar(1.05, 1.3, 0.4 + 0.01j, 0.12),
    )
    span: float = 0.9
    object_mass: float = 3.0
    object_inertia: float = 0.06
    left: complex = -0.12 + 0.05j
    right: complex = 0.1 - 0.04j


def five_bar_chain(bar: FiveBar) -> ClosedChain:
    """Return the linkage as a chain: joints about z, the pivots at y = 0."""
    tips = Pose(np.eye(3), _point(bar.bars[1].length)), Pose(ACROSS, _point(bar.bars[3].length))
    arms = {
        name: Arm([_joint(0.0), _joint(pair[0].length)], [_link(b) for b in pair], tip, Pose.translation(x, 0.0, 0.0))
        for name, pair, tip, x in (("left", bar.bars[:2], tips[0], 0.0), ("right", bar.bars[2:], tips[1], bar.span))
    }
    held = HeldObject(bar.object_mass, np.diag([0.04, 0.04, bar.object_inertia]))
    grasps = {
        "left": Grasp("rigid", Pose(np.eye(3), _point(bar.left))),
        "right": Grasp("hinge", Pose(ACROSS, _point(bar.right))),
    }
    return ClosedChain(arms, held, grasps, np.array([0.0, -9.81, 0.0]))


def five_bar_state(bar: FiveBar, angles, rates) -> State:
    """Return the state where the links have these attitudes [rad] and rates [rad/s], (4,) each."""
    first, second, third, fourth = (float(x) for x in angles)
    u, v, w, x = (float(x) for x in rates)
    inner, to_c = bar.bars[0].length * np.exp(1j * first), (bar.bars[1].length - bar.left) * np.exp(1j * second)
    velocity = 1j * (u * inner + v * to_c)
    pose = np.concatenate([[np.cos(second / 2), 0.0, 0.0, np.sin(second / 2)], _point(inner + to_c)])
    return State(
        np.array([first, second - first, third, fourth - third]),
        np.array([u, v - u, w, x - w]),
        pose,
        np.concatenate([[0.0, 0.0, v], _point(velocity)]),
    )


def _point(z: complex) -> np.ndarray:
    return np.array([np.real(z), np.imag(z), 0.0])


def _joint(x: float) -> Joint:
    return Joint("revolute", np.array([0.0, 0.0, 1.0]), Pose.translation(x, 0.0, 0.0))


def _link(bar: Bar) -> Link:
    return Link(bar.mass, _point(bar.com), np.diag([0.8 * bar.inertia, 0.8 * bar.inertia, bar.inertia]))
