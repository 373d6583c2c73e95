"""Energies, momentum and power of a forest, whose balances check every motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.power_terms import Power
from holdfast.dynamics.tree.forest_dynamics import forest_arguments
from holdfast.dynamics.tree.forest_motion import Carrier, ForestMotion, still_world
from holdfast.dynamics.tree.varied_forest import ForestArguments, damping_torques
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.forest import Forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.spatial_vector import acceleration_gradient, shift_wrench
from holdfast.spatial.vector import cross


@called
@dataclass(frozen=True, eq=False)
class ForestBalance(Frozen):
    """Energies, momentum and power of a forest in one state. SI units, world axes.

    Attributes:
        kinetic_energy: of all bodies, plus 1/2 armature qd^2 of the drives [J].
        potential_energy: -sum m g . r, zero at the world's origin, plus 1/2 stiffness (q - rest)^2 of the joints [J].
        momentum: (6,) [angular; linear] of all bodies about a point; that of rotors (armature) is not included [N m s,
            N s].
        mass: of all bodies [kg].
        centre_of_mass: (3,) of all bodies; the origin if they have no mass [m].
        power: into the forest. Closures and couplings, at rest or moving with bodies, do no work in sum.
    """

    kinetic_energy: float
    potential_energy: float
    momentum: Array
    mass: float
    centre_of_mass: Array
    power: Power


@np.errstate(all="ignore")  # what overflows is refused
def forest_balance(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike | None = None,
    wrenches: ArrayLike | None = None,
    *,
    about: ArrayLike | None = None,
) -> ForestBalance:
    """Return energies, momentum and power of a forest, sums over its bodies. O(n).

    d(kinetic + potential)/dt is the total of the power.

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        tau: (n_v,) torques [N m or N]; zero by default.
        wrenches: (bodies, 6) external wrenches about the origins of the bodies' frames; zero by default.
        about: (3,) point of the momentum [m]; the world's origin by default.

    Raises:
        StateError: a shape is wrong, or the numbers overflow.
    """
    given = forest_arguments(forest, q, qd, ... if tau is None else tau, wrenches)
    return balance_of(given, about)


def balance_of(given: ForestArguments, about: ArrayLike | None) -> ForestBalance:
    """Return energies, momentum and power of a forest; see `forest_balance`."""
    point = np.zeros(3) if about is None else checks.numbers(about, (3,), "about", StateError)
    motion = given.motion({})
    mass, moment = mass_moment(motion)
    numbers = [kinetic_energy(motion, given.qd), potential_energy(motion, given.q), *power_into(given, motion)]
    checks.finite(np.array(numbers), "the balance of the forest")
    return ForestBalance(
        float(numbers[0]),
        float(numbers[1]),
        checks.finite(momentum(motion, point), "momentum"),
        float(mass),
        moment / mass if mass > 0.0 else np.zeros(3),
        Power(*map(float, numbers[2:])),
    )


def kinetic_energy(motion: ForestMotion, qd: Array) -> Scalar:
    """Return the kinetic energy of bodies and drives [J]."""
    total: Scalar = 0.0
    for body, part in zip(motion.bodies, motion.forest.velocities, strict=True):
        V, rates = body.at.twist, qd[part]
        total = total + 0.5 * (V @ body.inertia.apply(V) + body.armature @ (rates * rates))
    return total


def elastic_energy(forest: Forest, q: Array) -> Scalar:
    """Return the energy of the springs in the joints [J]."""
    joints = [(body.joint, at.start) for body, at in zip(forest.bodies, forest.positions, strict=True)]
    return sum(0.5 * joint.stiffness * (q[at] - joint.rest) ** 2 for joint, at in joints if joint.stiffness)


def potential_energy(motion: ForestMotion, q: Array) -> Scalar:
    """Return the potential energy of gravity and of the springs in the joints [J]."""
    return elastic_energy(motion.forest, q) - motion.forest.gravity @ mass_moment(motion)[1]


def momentum(motion: ForestMotion, about: Array) -> Array:
    """Return [angular; linear] momentum about a point, (6,)."""
    parts = [shift_wrench(b.at.point - about, b.inertia.apply(b.at.twist)) for b in motion.bodies]
    return sum(parts, start=np.zeros(6))


def net_wrenches(motion: ForestMotion, acceleration: Array) -> list[Array]:
    """Return what accelerates every body, (6,) about its frame's origin, weight included.

    Args:
        motion: the forest's motion.
        acceleration: (bodies, 6) true accelerations of the frames' origins.
    """
    found = []
    for body, part, a in zip(motion.forest.bodies, motion.bodies, acceleration, strict=True):
        inertia, turning = body.link.spatial_inertia.moved(part.at.frame.R, np.zeros(3)), part.at.twist[:3]
        found.append(inertia.wrench(a, turning, acceleration_gradient(a[:3], turning)))
    return found


def momentum_rate(motion: ForestMotion, acceleration: Array, about: Array) -> Array:
    """Return the rate of the momentum about a fixed point, (6,); see `net_wrenches`."""
    nets = zip(motion.bodies, net_wrenches(motion, acceleration), strict=True)
    return sum((shift_wrench(body.at.frame.p - about, net) for body, net in nets), start=np.zeros(6))


def base_power(given: ForestArguments, acceleration: Array, closure_wrench: Array) -> Scalar:
    """Return the power of the wrenches by which moving bases carry what stands on them [W]. O(n).

    Args:
        given: the forest's arguments.
        acceleration: (bodies, 6) true accelerations of the frames' origins.
        closure_wrench: (closures, 6) wrenches of the closures.
    """
    forest, motion = given.forest, given.motion({})
    still = still_world(forest.gravity)
    under, behind = ({i: base.world(forest.gravity) for i, base in of.items()} for of in (given.under, given.behind))
    on: list[Carrier] = []
    power: Scalar = 0.0
    for k, (body, part, net) in enumerate(
        zip(forest.bodies, motion.bodies, net_wrenches(motion, acceleration), strict=True)
    ):
        on.append(under.get(k, still) if body.parent is None else on[body.parent])
        frame, weight = part.at.frame, body.link.mass * forest.gravity
        others = concatenate([cross(frame.R @ body.link.com, weight), weight]) + given.wrenches[k]
        power = power + on[k].twist_at(frame.p) @ (net - others)
    for i, (closure, c, f) in enumerate(zip(forest.closures, motion.closures, closure_wrench, strict=True)):
        at = motion.bodies[closure.b].at.frame.p + c.contact.offset
        a = behind.get(i, still) if closure.a is None else on[closure.a]
        power = power + (a.twist_at(at) - on[closure.b].twist_at(at)) @ f
    return power


def mass_moment(motion: ForestMotion) -> tuple[Scalar, Array]:
    """Return the mass of all bodies [kg], and their first moment about the world's origin, (3,) [kg m]."""
    mass: Scalar = 0.0
    moment = np.zeros(3)
    for body, part in zip(motion.forest.bodies, motion.bodies, strict=True):
        frame = part.at.frame
        mass, moment = mass + body.link.mass, moment + body.link.mass * (frame.p + frame.R @ body.link.com)
    return mass, moment


def power_into(given: ForestArguments, motion: ForestMotion) -> Power:
    """Return the power of drives, dampers and external wrenches [W]."""
    lost = damping_torques(given.forest, given.qd) @ given.qd
    twists = concatenate([b.at.twist_at(-b.at.centre) for b in motion.bodies])
    return Power(given.tau @ given.qd, -lost, 0.0, given.wrenches.ravel() @ twists)
