"""Energy, momentum and power of a closed chain: the books every simulation must balance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.posture import Posture, posture
from holdfast.dynamics.arm.velocity import link_twists
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, each
from holdfast.spatial.spatial_vector import rotate, shift_wrench, unrotate
from holdfast.state import Inputs, State


class Body(NamedTuple):
    """A moving rigid body: its inertia and twist in its own axes about its own origin."""

    inertia: RigidInertia
    twist: Array
    R: Array
    origin: Array

    @property
    def mass_moment(self) -> Array:
        """(4,) the mass [kg] and `com`."""
        return concatenate([[self.inertia.m], self.com])

    @property
    def com(self) -> Array:
        """(3,) mass times mass centre, world axes from the world's origin [kg m]."""
        return self.inertia.m * self.origin + self.R @ self.inertia.h

    def momentum(self, about: Array) -> Array:
        """Return [angular; linear] momentum about a world point, (6,) world axes [N m s, N s]."""
        return shift_wrench(self.origin - about, rotate(self.R, self.inertia.apply(self.twist)))

    @property
    def kinetic_energy(self) -> Scalar:
        """1/2 V^T M V [J]."""
        return 0.5 * (self.twist @ self.inertia.apply(self.twist))

    def potential_energy(self, gravity: Array) -> Scalar:
        """Return -m g . r, zero at the world's origin [J]."""
        return -(gravity @ self.com)


def bodies(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> Iterator[Body]:
    """Yield every link, arms in order, base to tip, and then the object."""
    for arm, part, base_twist in _moving_arms(chain, inputs):
        yield from links(arm, state.q[part], state.qd[part], base_twist)
    yield held_body(chain.held_object, state.object_frame, state.object_twist)


def links(arm: Arm, q: Array, qd: Array, base_twist: Array) -> Iterator[Body]:
    """Yield the links of one arm, base to tip."""
    at = posture(arm, q)
    twists = link_twists(arm, at, qd, base_twist)
    for link, V, R, origin in zip(arm.links, twists, at.R, _origins(at), strict=True):
        yield Body(link.spatial_inertia, V, R, origin)


def held_body(held: HeldObject, frame: Pose, twist: Array) -> Body:
    """Return the object as a body; its twist given about C, world axes."""
    return Body(held.spatial_inertia, unrotate(frame.R, twist), frame.R, frame.p)


def kinetic_energy(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> float:
    """Return T = sum 1/2 V^T M V over links and object, and 1/2 armature qd^2 of the drives [J]. O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: base motion, if the bases move.

    Raises:
        StateError: a state or inputs of the wrong shape for the chain.
    """
    state.fits(chain)
    twists = (inputs or Inputs()).shaped(chain).base_twists
    assert twists is not None
    return float(total_kinetic_energy(chain, state, twists))


def total_kinetic_energy(chain: ClosedChain, state: State, base_twists: Array) -> Scalar:
    """Return T of arms and object [J]; see `kinetic_energy`."""
    parts = list(chain.joints.values())
    q, qd = ([x[part] for part in parts] for x in (state.q, state.qd))
    arms = each(arm_kinetic_energy, chain.arms.values(), q, qd, base_twists)
    return sum(arms) + held_body(chain.held_object, state.object_frame, state.object_twist).kinetic_energy


def arm_kinetic_energy(arm: Arm, q: Array, qd: Array, base_twist: Array) -> Scalar:
    """Return T of one arm's links and drives [J]."""
    return sum(body.kinetic_energy for body in links(arm, q, qd, base_twist)) + 0.5 * (arm.armature @ qd**2)


def potential_energy(chain: ClosedChain, state: State) -> float:
    """Return U = -sum m g . r over links and object, zero at the world's origin [J]. O(n).

    Args:
        chain: the chain.
        state: positions; velocities do not enter.

    Raises:
        StateError: a state of the wrong shape for the chain.
    """
    state.fits(chain)
    return float(total_potential_energy(chain, state))


def total_potential_energy(chain: ClosedChain, state: State) -> Scalar:
    """Return U of arms and object [J]; see `potential_energy`."""
    q = [state.q[part] for part in chain.joints.values()]
    arms = each(lambda arm, q: arm_potential_energy(arm, q, chain.gravity), chain.arms.values(), q)
    return sum(arms) + held_body(chain.held_object, state.object_frame, np.zeros(6)).potential_energy(chain.gravity)


def arm_potential_energy(arm: Arm, q: Array, gravity: Array) -> Scalar:
    """Return U of one arm's links [J]."""
    resting = links(arm, q, np.zeros(arm.joint_count), np.zeros(6))
    return sum(body.potential_energy(gravity) for body in resting)


def centre_of_mass(chain: ClosedChain, state: State) -> Array:
    """Return the mass centre of arms and object, (3,) world axes [m]. O(n).

    Args:
        chain: the chain.
        state: positions; velocities do not enter.

    Raises:
        StateError: a state of the wrong shape for the chain.
    """
    state.fits(chain)
    parts = [state.q[part] for part in chain.joints.values()]
    held = held_body(chain.held_object, state.object_frame, np.zeros(6))
    sums = sum(each(arm_mass_moment, chain.arms.values(), parts)) + held.mass_moment
    return sums[1:] / sums[0]


def arm_mass_moment(arm: Arm, q: Array) -> Array:
    """Return the links' mass [kg] and first moment from the world's origin [kg m], (4,)."""
    resting = links(arm, q, np.zeros(arm.joint_count), np.zeros(6))
    return sum((body.mass_moment for body in resting), start=np.zeros(4))


def momentum(chain: ClosedChain, state: State, about: ArrayLike | None = None, inputs: Inputs | None = None) -> Array:
    """Return [angular; linear] momentum of links and object about a world point, (6,) [N m s, N s]. O(n).

    The drives' rotors (armature) turn inside the arms and are not counted.

    Args:
        chain: the chain.
        state: positions and velocities.
        about: (3,) world point; default the world's origin.
        inputs: base motion.

    Raises:
        StateError: wrong shape of `about` or the inputs.
    """
    state.fits(chain)
    twists = (inputs or Inputs()).shaped(chain).base_twists
    assert twists is not None
    point = np.zeros(3) if about is None else checks.numbers(about, (3,), "about", StateError)
    return total_momentum(chain, state, twists, point)


def total_momentum(chain: ClosedChain, state: State, base_twists: Array, about: Array) -> Array:
    """Return the momentum of links and object, (6,); see `momentum`."""
    parts = list(chain.joints.values())
    q, qd = ([x[part] for part in parts] for x in (state.q, state.qd))
    arms = each(
        lambda arm, q, qd, twist: arm_momentum(arm, q, qd, twist, about), chain.arms.values(), q, qd, base_twists
    )
    return sum(arms) + held_body(chain.held_object, state.object_frame, state.object_twist).momentum(about)


def arm_momentum(arm: Arm, q: Array, qd: Array, base_twist: Array, about: Array) -> Array:
    """Return the momentum of one arm's links, (6,)."""
    return sum((body.momentum(about) for body in links(arm, q, qd, base_twist)), start=np.zeros(6))


class Power(NamedTuple):
    """Power into the chain, without gravity's, whose work is potential energy [W].

    Attributes:
        drives: tau . qd.
        damping: -sum d qd^2 of the joints' viscous damping, <= 0.
        base: sum F_b . V_b of the base wrenches.
        external: of the external wrenches on object and links.
    """

    drives: Scalar
    damping: Scalar
    base: Scalar
    external: Scalar

    @property
    def total(self) -> Scalar:
        """d(T + U)/dt [W]."""
        return self.drives + self.damping + self.base + self.external


def power(
    chain: ClosedChain, state: State, tau: ArrayLike, result: ForwardResult, inputs: Inputs | None = None
) -> Power:
    """Return the power that drives, damping, bases and external wrenches put in [W]. O(n).

    Its total is d(T + U)/dt of `kinetic_energy` and `potential_energy`.

    Args:
        chain: the chain.
        state: positions and velocities.
        tau: (n,) joint torques.
        result: forward dynamics at that state, for the base wrenches.
        inputs: external wrenches and base motion, as given to forward dynamics.

    Raises:
        StateError: a state, torques or inputs of the wrong shape for the chain.
    """
    state.fits(chain)
    torques = checks.numbers(tau, (chain.joint_count,), "tau", StateError)
    base = checks.numbers(result.base_wrench, (len(chain.arms), 6), "result: base_wrench", StateError)
    found = power_of(chain, state, torques, base, (inputs or Inputs()).shaped(chain))
    return Power(*map(float, found))


def power_of(chain: ClosedChain, state: State, tau: Array, base_wrench: Array, inputs: Inputs) -> Power:
    """Return the same for base wrenches (arms, 6) and shaped inputs, on any kind of numbers."""
    assert inputs.base_twists is not None and inputs.object_wrench is not None
    damping = concatenate(arm.damping for arm in chain.arms.values())
    external = inputs.object_wrench @ state.object_twist
    if inputs.link_wrenches is not None:
        links = list(bodies(chain, state, inputs))[:-1]
        external += sum(f @ rotate(body.R, body.twist) for f, body in zip(inputs.link_wrenches, links, strict=True))
    return Power(
        tau @ state.qd,
        -(damping @ (state.qd * state.qd)),
        base_wrench.ravel() @ inputs.base_twists.ravel(),
        external,
    )


def _moving_arms(chain: ClosedChain, inputs: Inputs | None) -> Iterator[tuple[Arm, slice, Array]]:
    """Yield each arm, where its joints lie, and its base's twist."""
    twists = (inputs or Inputs()).shaped(chain).base_twists
    assert twists is not None
    yield from zip(chain.arms.values(), chain.joints.values(), twists, strict=True)


def _origins(at: Posture) -> list[Array]:
    """Return the link origins O_k, world axes from the world's origin."""
    return [at.tip.p - reach for reach in at.reach]
