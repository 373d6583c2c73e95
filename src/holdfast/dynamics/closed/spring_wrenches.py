"""Wrenches of springs between bodies, which follow from the state and act as external wrenches.

d = x_b - x_a,  s = |d|,  ds/dt = d . (v_b - v_a) / s,  f_a = (k (s - L) + c ds/dt) d / s = -f_b
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.arm.velocity import link_twists
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.spring import HELD_OBJECT, Spring, SpringEnd
from holdfast.spatial.frozen import changed
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each_of, sqrt, where
from holdfast.spatial.vector import cross
from holdfast.state import Inputs, State


class End(NamedTuple):
    """The position and velocity of an end of a spring, in world axes.

    Attributes:
        lever: (3,) from the origin of its body to the end [m].
        position: (3,) position in the world [m].
        velocity: (3,) velocity [m/s].
    """

    lever: Array
    position: Array
    velocity: Array


class Elongation(NamedTuple):
    """The elongation of a spring at one instant.

    Attributes:
        a, b: its ends.
        length: s [m].
        rate: ds/dt [m/s]; 0 if the ends coincide.
        direction: (3,) unit vector from a to b; 0 if the ends coincide.
    """

    a: End
    b: End
    length: Scalar
    rate: Scalar
    direction: Array

    def energy(self, spring: Spring) -> Scalar:
        """Return 1/2 k (s - L)^2 [J]."""
        return 0.5 * spring.stiffness * (self.length - spring.length) ** 2

    def loss(self, spring: Spring) -> Scalar:
        """Return c (ds/dt)^2 [W]."""
        return spring.damping * (self.rate * self.rate)

    def pull(self, spring: Spring) -> Array:
        """Return the force on the first end, (3,) [N]."""
        return (spring.stiffness * (self.length - spring.length) + spring.damping * self.rate) * self.direction


def with_springs(chain: ClosedChain, state: State, inputs: Inputs) -> Inputs:
    """Return the inputs with the wrenches of the chain's springs added. O(springs) + O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: shaped inputs (`Inputs.shaped`).

    Raises:
        StateError: the wrench of a spring overflows.
    """
    if not chain.springs:
        return inputs
    assert inputs.object_wrench is not None
    of_object, of_links, of_trunk = inputs.object_wrench, inputs.link_wrenches, inputs.trunk_link_wrenches
    first = 0 if chain.trunk is None else chain.trunk.joint_count
    rows = [np.zeros(6)] * (chain.joint_count - first) if of_links is None else list(of_links)
    bodies = [np.zeros(6)] * (0 if chain.trunk is None else len(chain.trunk.bodies))
    bodies = bodies if of_trunk is None else list(of_trunk)
    for k, (spring, found) in enumerate(zip(chain.springs, elongations(chain, state, inputs), strict=True)):
        pull, name = found.pull(spring), f"wrench of spring {k}, from '{spring.a.body}' to '{spring.b.body}'"
        for at, end, force in ((spring.a, found.a, pull), (spring.b, found.b, -pull)):
            wrench = checks.finite(concatenate([cross(end.lever, force), force]), name)
            if at.on_arm:
                row = chain.joints[at.body].start - first + at.link_number()
                rows[row] = rows[row] + wrench
            elif at.on_trunk:
                k = _place(chain, at)
                bodies[k] = bodies[k] + wrench
            elif at.body == HELD_OBJECT:
                of_object = of_object + wrench
    on_trunk = {"trunk_link_wrenches": array(bodies)} if bodies else {}
    return replace(inputs, object_wrench=of_object, link_wrenches=array(rows), **on_trunk)


def without_springs(chain: ClosedChain) -> ClosedChain:
    """Return the same chain without springs between bodies, of any kind of numbers; nothing is checked."""
    return changed(chain, springs=())


def elongations(chain: ClosedChain, state: State, inputs: Inputs) -> list[Elongation]:
    """Return the elongation of every spring at one instant. O(springs) + O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: shaped inputs, of which only the base motion matters.
    """
    if not chain.springs:
        return []
    at, ends = base_kinematics(chain, state, inputs), [end for spring in chain.springs for end in spring.ends]
    on_arm = {name: tuple([end for end in ends if end.on_arm and end.body == name]) for name in chain.arms}
    names = [name for name, attached in on_arm.items() if attached]
    found = each_of(names, ends_on_arm, at.arms, at.q, at.qd, at.base_twists, on_arm)
    placed = {name: iter(of_arm) for name, of_arm in found.items()}

    def of(end: SpringEnd) -> End:
        if end.on_arm:
            return next(placed[end.body])
        if end.on_trunk:
            body = at.trunk[_place(chain, end)]
            return _on_body(end.point, body.frame, body.twist)
        if end.body == HELD_OBJECT:
            return _on_body(end.point, state.object_frame, state.object_twist)
        return End(end.point, end.point, np.zeros(3))

    every = iter([of(end) for end in ends])
    return [elongation(a, b) for a, b in zip(every, every, strict=True)]


def ends_on_arm(arm: Arm, q: Array, qd: Array, base_twist: Array, attached: Sequence[SpringEnd]) -> list[End]:
    """Return the ends of springs on the links of an arm."""
    at = forward_kinematics(arm, q)
    twists = link_twists(arm, at, qd, base_twist)
    found = []
    for end in attached:
        R, V = at.R[end.link_number()], twists[end.link_number()]
        lever = R @ end.point
        position = at.tip.p - at.reach[end.link_number()] + lever
        found.append(End(lever, position, R @ (V[3:] + cross(V[:3], end.point))))
    return found


def _place(chain: ClosedChain, end: SpringEnd) -> int:
    """Return the index of a trunk's body in `Trunk.bodies`."""
    assert chain.trunk is not None
    return chain.trunk.body(end.link, "spring")


def _on_body(point: Array, frame: Pose, twist: Array) -> End:
    """Return an end on a body whose origin has the given twist (6,), in world axes."""
    lever = frame.R @ point
    return End(lever, frame.p + lever, twist[3:] + cross(twist[:3], lever))


def elongation(a: End, b: End) -> Elongation:
    """Return the elongation of a spring between two ends."""
    d = b.position - a.position
    square = d @ d
    length = sqrt(square)
    direction = d / where(square > 0.0, length, 1.0)
    return Elongation(a, b, length, direction @ (b.velocity - a.velocity), direction)
