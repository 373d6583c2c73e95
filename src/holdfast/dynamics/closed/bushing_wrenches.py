"""Wrenches of bushings, which follow from the state as gradients of the stored energy (docs/theory/contacts.md).

Let n and e be the scalar and the vector of the unit quaternion of the contact frame relative to the tip frame, p the
origin of the contact frame in tip axes, and V = [w; v] the twist of the object relative to the tip at that origin. Then
    x = [2 e; p],   U = 1/2 x . K x,   dx/dt = [(n 1 - e~) w; v]
For a rotation by the angle t, 2 e is the axis times 2 sin(t / 2). It is smooth below half a turn, and its relative
difference from t is at most t^2 / 24. With [a; b] = K x, the tip therefore exerts the following wrench on the object,
about that origin and in tip axes:
    -[n a + e x a; b] - C V
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.arm.velocity import link_twists, tip_twist
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each_of, maximum, select, sqrt, where
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from holdfast.spatial.vector import cross
from holdfast.state import Inputs, State


class Deflection(NamedTuple):
    """The deformation of a bushing at one instant, in tip axes.

    Attributes:
        stiffness, damping: (6, 6) matrices K and C.
        n, e: scalar and vector (3,) of the unit quaternion of the contact frame relative to the tip frame.
        x: (6,) [2 e; p].
        V: (6,) twist of the object relative to the tip at the contact's origin.
        R: (3, 3) rotation from tip axes to world axes.
    """

    stiffness: Array
    damping: Array
    n: Scalar
    e: Array
    x: Array
    V: Array
    R: Array

    def energy(self) -> Scalar:
        """Return 1/2 x . K x [J]."""
        return 0.5 * (self.x @ (self.stiffness @ self.x))

    def loss(self) -> Scalar:
        """Return V . C V [W]."""
        return self.V @ (self.damping @ self.V)

    def wrench(self) -> Array:
        """Return the wrench of the tip on the object, (6,) about the tip's point, world axes."""
        a, b = np.split(self.stiffness @ self.x, 2)
        at_contact = -concatenate([self.n * a + cross(self.e, a), b]) - self.damping @ self.V
        return rotate(self.R, shift_wrench(self.x[3:], at_contact))


def deflection(c: Contact) -> Deflection:
    """Return the deformation of a contact that is a bushing."""
    made = c.grasp.of_kind.bushing
    assert made is not None
    Q, p = c.R.T @ c.frame, (c.origin - c.offset) @ c.R
    n, e = unit_quaternion(Q)
    w, v = c.W[:3], c.W[3:]  # relative twist at the tip's point
    return Deflection(
        np.array(made.stiffness),
        np.array(made.damping),
        n,
        e,
        concatenate([2.0 * e, p]),
        concatenate([w, v + cross(w, p)]),
        c.R,
    )


def unit_quaternion(Q: Array) -> tuple[Scalar, Array]:
    """Return the scalar >= 0 and the vector (3,) of a rotation matrix's unit quaternion.

    They follow from the row of 4 q q^T with the largest component, as in `rotation.to_quaternion`, so they are accurate
    for half a turn, too. The function also accepts traced numbers.
    """
    x, y, z = np.diag(Q)
    a, b, c = Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]
    d, f, g = Q[1, 0] + Q[0, 1], Q[0, 2] + Q[2, 0], Q[2, 1] + Q[1, 2]
    largest, q = x + y + z, array([1.0 + x + y + z, a, b, c])
    for size, row in (
        (x, [a, 1.0 + x - y - z, d, f]),
        (y, [b, d, 1.0 - x + y - z, g]),
        (z, [c, f, g, 1.0 - x - y + z]),
    ):
        q = select(size > largest, array(row), q)
        largest = maximum(largest, size)
    q = q * (where(q[0] < 0.0, -1.0, 1.0) / sqrt(q @ q))
    return q[0], q[1:]


def bushings(chain: ClosedChain, state: State, inputs: Inputs) -> list[Deflection]:
    """Return the deformations of all bushings at one instant, in the order of the chain's grasps. O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: shaped inputs, of which only the base motion matters.
    """
    if not chain.bushings:
        return []
    at, frame, twist = base_kinematics(chain, state, inputs), state.object_frame, state.object_twist

    def of_arm(arm: Arm, q: Array, qd: Array, base_twist: Array, grasp: Grasp) -> Deflection:
        at = forward_kinematics(arm, q)
        of_tip = tip_twist(arm, at, link_twists(arm, at, qd, base_twist), base_twist)
        return deflection(contact(grasp, frame, twist, at.tip, of_tip))

    return list(each_of(chain.bushings, of_arm, at.arms, at.q, at.qd, at.base_twists, chain.grasps).values())


def bushing_energy(chain: ClosedChain, state: State) -> Scalar:
    """Return the energy stored in the bushings [J]."""
    return sum(one.energy() for one in bushings(chain, state, Inputs().shaped(chain)))
