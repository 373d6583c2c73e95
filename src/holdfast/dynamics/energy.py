"""Energy, momentum and power of a closed chain, whose balances check every simulation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics, link_twists
from holdfast.dynamics.closed.force_elements import losses, stored_energies
from holdfast.dynamics.power_terms import Power
from holdfast.dynamics.result import ForwardResult, require_result_of
from holdfast.dynamics.tree.mechanism_balance import mechanism_balance, mechanism_power
from holdfast.dynamics.trunk.trunk_motion import BaseKinematics, base_kinematics
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.serial_chain import answered_as_forest
from holdfast.model.trunk import TRUNK, bodies_of
from holdfast.questions.arrays import LINKS, OBJECT, STATE, TRUNK_LINKS, Row
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import Question
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, each_of
from holdfast.spatial.spatial_vector import rotate, shift_wrench, unrotate
from holdfast.state import Inputs, State, require_fit, shaped_inputs


class MovingBody(NamedTuple):
    """A moving rigid body: inertia and twist about its own origin in its own axes, and its pose (R, origin)."""

    inertia: RigidInertia
    twist: Array
    R: Array
    origin: Array

    @property
    def mass_moment(self) -> Array:
        """Mass [kg] and first moment of mass about the world's origin, world axes [kg m], (4,)."""
        return concatenate([[self.inertia.m], self.com])

    @property
    def com(self) -> Array:
        """Mass times the position of the centre of mass from the world's origin, (3,) world axes [kg m]."""
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


def bodies(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> Iterator[MovingBody]:
    """Yield the trunk's bodies from the base outward, then the links arm by arm, base to tip, then the object."""
    at = base_kinematics(chain, state, shaped_inputs(chain, inputs))
    yield from trunk_bodies(chain, at)
    for name, arm in at.arms.items():
        yield from links(arm, at.q[name], at.qd[name], at.base_twists[name])
    yield held_body(chain.held_object, state.object_frame, state.object_twist)


def trunk_bodies(chain: ClosedChain, at: BaseKinematics) -> list[MovingBody]:
    """Return the bodies of the trunk from its base outward; the list is empty without a trunk."""
    return [
        MovingBody(link.spatial_inertia, unrotate(body.frame.R, body.twist), body.frame.R, body.frame.p)
        for link, body in zip(bodies_of(chain.trunk), at.trunk.bodies, strict=True)
    ]


def links(arm: Arm, q: Array, qd: Array, base_twist: Array) -> Iterator[MovingBody]:
    """Yield the links of one arm, base to tip."""
    at = forward_kinematics(arm, q)
    twists = link_twists(arm, at, qd, base_twist)
    for link, V, R, origin in zip(arm.links, twists, at.R, _origins(at), strict=True):
        yield MovingBody(link.spatial_inertia, V, R, origin)


def held_body(held: HeldObject, frame: Pose, twist: Array) -> MovingBody:
    """Return the object as a body; `twist` is that of C along world axes."""
    return MovingBody(held.spatial_inertia, unrotate(frame.R, twist), frame.R, frame.p)


@asked
@np.errstate(all="ignore")  # what overflows is refused below
def kinetic_energy(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> float:
    """Return T = sum 1/2 V^T M V over links and object, plus 1/2 armature qd^2 of the actuators [J]. O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: base motion, if the bases move.

    Raises:
        StateError: a state or inputs of the wrong shape for the chain.
    """
    if answered_as_forest(chain):
        return mechanism_balance(chain, state, inputs).kinetic_energy
    require_fit(chain, state)
    found = total_kinetic_energy(chain, state, shaped_inputs(chain, inputs))
    return float(checks.finite(found, "kinetic energy"))


def total_kinetic_energy(chain: ClosedChain, state: State, inputs: Inputs) -> Scalar:
    """Return T of trunk, arms and object [J] for inputs that are already shaped; see `kinetic_energy`."""
    at = base_kinematics(chain, state, inputs)
    parts = [*each_of(at.arms, arm_kinetic_energy, at.arms, at.q, at.qd, at.base_twists).values()]
    parts += [body.kinetic_energy for body in trunk_bodies(chain, at)]
    armature = np.array([joint.armature for joint in chain.joints_of.get(TRUNK, ())])
    parts.append(0.5 * (armature @ state.qd[at.trunk.joints] ** 2))
    return sum(parts) + held_body(chain.held_object, state.object_frame, state.object_twist).kinetic_energy


def arm_kinetic_energy(arm: Arm, q: Array, qd: Array, base_twist: Array) -> Scalar:
    """Return T of one arm's links and rotors [J]."""
    return sum(body.kinetic_energy for body in links(arm, q, qd, base_twist)) + 0.5 * (arm.armature @ qd**2)


@asked
@np.errstate(all="ignore")  # what overflows is refused below
def potential_energy(chain: ClosedChain, state: State) -> float:
    """Return the potential energy of gravity and of all springs [J]. O(n).

    Gravity contributes U = -sum m g . r over links and object, zero at the world's origin. A joint spring stores
    1/2 stiffness (q - rest)^2, a spring between bodies 1/2 stiffness (s - length)^2, and a bushing 1/2 x . K x.

    Args:
        chain: the chain.
        state: positions; velocities are ignored.

    Raises:
        StateError: a state of the wrong shape for the chain.
    """
    if answered_as_forest(chain):
        return mechanism_balance(chain, state).potential_energy
    require_fit(chain, state)
    return float(checks.finite(total_potential_energy(chain, state), "potential energy"))


def total_potential_energy(chain: ClosedChain, state: State) -> Scalar:
    """Return U of trunk, arms and object [J]; see `potential_energy`."""
    at, gravity = base_kinematics(chain, state, Inputs().shaped(chain)), chain.gravity
    parts = [*each_of(at.arms, lambda arm, q: arm_potential_energy(arm, q, gravity), at.arms, at.q).values()]
    parts += [body.potential_energy(gravity) for body in trunk_bodies(chain, at)]
    parts.append(_elastic_energy(chain.joints_of.get(TRUNK, ()), state.q[at.trunk.joints]))
    held = held_body(chain.held_object, state.object_frame, np.zeros(6)).potential_energy(gravity)
    of_bodies = sum(parts) + held
    return sum(stored_energies(chain, state), start=of_bodies)


def arm_potential_energy(arm: Arm, q: Array, gravity: Array) -> Scalar:
    """Return U of one arm's links and joint springs [J]."""
    resting = links(arm, q, np.zeros(arm.joint_count), np.zeros(6))
    return sum(body.potential_energy(gravity) for body in resting) + _elastic_energy(arm.joints, q)


def _elastic_energy(joints: Sequence[Joint], q: Array) -> Scalar:
    """Return the elastic energy of joint springs [J]."""
    stiffness, rest = (np.array([getattr(joint, name) for joint in joints]) for name in ("stiffness", "rest"))
    return 0.5 * (stiffness @ (q - rest) ** 2)


@np.errstate(all="ignore")  # what overflows is refused below
def centre_of_mass(chain: ClosedChain, state: State) -> Array:
    """Return the centre of mass of trunk, arms and object together, (3,) world axes [m]. O(n).

    Args:
        chain: the chain.
        state: positions; velocities are ignored.

    Raises:
        StateError: a state of the wrong shape for the chain.
    """
    if answered_as_forest(chain):
        return mechanism_balance(chain, state).centre_of_mass
    require_fit(chain, state)
    sums = total_mass_moment(chain, state)
    return checks.finite(sums[1:] / sums[0], "centre of mass")


def total_mass_moment(chain: ClosedChain, state: State) -> Array:
    """Return mass [kg] and first moment about the world's origin [kg m] of trunk, links and object, (4,)."""
    at = base_kinematics(chain, state, Inputs().shaped(chain))
    held = held_body(chain.held_object, state.object_frame, np.zeros(6))
    sums = sum(each_of(at.arms, arm_mass_moment, at.arms, at.q).values()) + held.mass_moment
    return sum((body.mass_moment for body in trunk_bodies(chain, at)), start=sums)


def arm_mass_moment(arm: Arm, q: Array) -> Array:
    """Return mass [kg] and first moment about the world's origin [kg m] of one arm's links, (4,)."""
    resting = links(arm, q, np.zeros(arm.joint_count), np.zeros(6))
    return sum((body.mass_moment for body in resting), start=np.zeros(4))


@np.errstate(all="ignore")  # what overflows is refused below
def momentum(chain: ClosedChain, state: State, about: ArrayLike | None = None, inputs: Inputs | None = None) -> Array:
    """Return [angular; linear] momentum of links and object about a world point, (6,) [N m s, N s]. O(n).

    The momentum of the actuators' rotors (armature) is not included.

    Args:
        chain: the chain.
        state: positions and velocities.
        about: (3,) world point; default the world's origin.
        inputs: base motion.

    Raises:
        StateError: `about` or the inputs have a wrong shape.
    """
    if answered_as_forest(chain):
        return mechanism_balance(chain, state, inputs, about).momentum
    require_fit(chain, state)
    point = np.zeros(3) if about is None else checks.numbers(about, (3,), "about", StateError)
    return checks.finite(total_momentum(chain, state, shaped_inputs(chain, inputs), point), "momentum")


def total_momentum(chain: ClosedChain, state: State, inputs: Inputs, about: Array) -> Array:
    """Return the momentum of trunk, links and object, (6,), for inputs already shaped; see `momentum`."""
    at = base_kinematics(chain, state, inputs)

    def of_arm(arm: Arm, q: Array, qd: Array, base_twist: Array) -> Array:
        return sum((body.momentum(about) for body in links(arm, q, qd, base_twist)), start=np.zeros(6))

    of_arms = each_of(at.arms, of_arm, at.arms, at.q, at.qd, at.base_twists)
    parts = [*of_arms.values(), *(body.momentum(about) for body in trunk_bodies(chain, at))]
    return sum(parts) + held_body(chain.held_object, state.object_frame, state.object_twist).momentum(about)


@np.errstate(all="ignore")  # what overflows is refused below
def power(
    chain: ClosedChain, state: State, tau: ArrayLike, result: ForwardResult, inputs: Inputs | None = None
) -> Power:
    """Return the power that actuators, dampers, bases and external wrenches put into the chain [W]. O(n).

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
    if answered_as_forest(chain):
        return mechanism_power(chain, state, tau, result, inputs)
    require_fit(chain, state)
    torques = checks.numbers(tau, (chain.joint_count,), "tau", StateError)
    require_result_of(chain, result)
    base = checks.numbers(result.base_wrench, (len(chain.arms), 6), "result: base_wrench", StateError)
    found = power_of(chain, state, torques, base, shaped_inputs(chain, inputs), result.trunk_base_wrench)
    return Power(*map(float, checks.finite(np.array(found), "power")))


def power_of(
    chain: ClosedChain, state: State, tau: Array, base_wrench: Array, inputs: Inputs, under_trunk: Array | None = None
) -> Power:
    """Return `power` for floats or traced numbers, given base wrenches (arms, 6) and inputs already shaped.

    Arms on a trunk have no base motion of their own; `under_trunk` is the wrench on the trunk's base, (6,), which does
    the work instead.
    """
    assert inputs.base_twists is not None and inputs.object_wrench is not None
    damping = np.array([joint.damping for joint in chain.all_joints])
    lost = sum(losses(chain, state, inputs))
    external, base = inputs.object_wrench @ state.object_twist, base_wrench.ravel() @ inputs.base_twists.ravel()
    moving = [] if inputs.link_wrenches is None else [*inputs.link_wrenches]
    if inputs.trunk_link_wrenches is not None:
        moving = [*inputs.trunk_link_wrenches, *moving]
    if moving:
        links = list(bodies(chain, state, inputs))[:-1]
        external += sum(f @ rotate(body.R, body.twist) for f, body in zip(moving, links, strict=False))
    if under_trunk is not None and inputs.trunk_base_twist is not None:
        base = base + under_trunk @ inputs.trunk_base_twist
    return Power(tau @ state.qd, -(damping @ (state.qd * state.qd)) - lost, base, external)


def _origins(at: Kinematics) -> list[Array]:
    """Return the link origins O_k, world axes from the world's origin."""
    return [at.tip.p - reach for reach in at.reach]


_INERTIAS, _BASES = (*OBJECT, *LINKS, *TRUNK_LINKS), ("base_pose", "floating_pose")

KINETIC = declare(
    Question(
        "kinetic_energy",
        lambda case: (total_kinetic_energy(case.chain, case.state, case.inputs),),
        (Row("kinetic_energy", (), "J", "kinetic energy"),),
        "the kinetic energy of links and object, plus 1/2 armature qd^2 of the actuators",
        returns="Any",
        inputs=STATE,
        parameters=(*OBJECT, "base_R", "base_twist"),
        arguments=(
            *("q", "object_pose", "qd", "object_twist"),
            *(*_BASES, "base_twist", "floating_twist", "trunk_base_twist", "armature", *_INERTIAS),
        ),
        by=("q", "object_pose", "qd", "object_twist"),
    ),
    kinetic_energy,
)
declare(
    Question(
        "potential_energy",
        lambda case: (total_potential_energy(case.chain, case.state),),
        (Row("potential_energy", (), "J", "potential energy"),),
        "the potential energy of gravity and of all springs, zero at the world's origin",
        returns="Any",
        inputs=("q", "object_pose"),
        parameters=("gravity", *OBJECT, "base_R", "base_p"),
        arguments=("q", "object_pose", "gravity", *_BASES, "grasp_pose", *_INERTIAS),
        by=("q", "object_pose"),
        depends_on=("links", "bushings"),
    ),
    potential_energy,
)
declare(
    Question(
        "momentum",
        lambda case: (total_momentum(case.chain, case.state, case.inputs, case.own["about"]),),
        (Row("momentum", (6,), "N m s, N s", "[angular; linear] momentum about a world point, world axes"),),
        "the momentum of links and object about a world point",
        inputs=STATE,
        parameters=("about", *OBJECT, "base_R", "base_p", "base_twist"),
    )
)


def _centre(case: VariedCase) -> tuple[Array]:
    sums = total_mass_moment(case.chain, case.state)
    return (sums[1:] / sums[0],)


declare(
    Question(
        "centre_of_mass",
        _centre,
        (Row("centre_of_mass", (3,), "m", "mass centre, world axes"),),
        "the mass centre of links and object",
        inputs=("q", "object_pose"),
        parameters=(*OBJECT, "base_R", "base_p"),
    )
)
