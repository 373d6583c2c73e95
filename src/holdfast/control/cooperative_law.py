"""Control laws of cooperating arms, put together from the object's motion, the grasp forces and the null motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from holdfast.control.commanded_torques import Command, WithinLimits, chosen_torques, within_limits
from holdfast.control.controller import ControlLaw, known_breakpoints
from holdfast.control.internal_force import InternalForce
from holdfast.control.law_parts import CommandedMotion, GraspForces, LawInput, NullMotion
from holdfast.control.posture_control import PostureControl
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.errors import MethodNotApplicable
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.serial_chain import serial_chain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.state import Inputs, State

EXAMPLES = {
    "motion": "ObjectImpedance(path, stiffness, damping), or ObjectTracking for a path that is followed stiffly",
    "forces": "InternalForce(20.0)",
    "posture": "PostureControl()",
}


def cooperative_law(
    chain: ClosedChain,
    motion: CommandedMotion,
    forces: GraspForces | None = None,
    posture: NullMotion | None = None,
    *,
    limits: ForceLimits | None = None,
    cost: ForceCost | None = None,
) -> ControlLaw:
    """Return the law tau = M qdd + C + J^T f of an object motion, grasp forces and a null motion.

    The object's acceleration is that of `motion`; f are the wrenches nearest to those of `forces` that give it; qdd are
    the joint accelerations nearest to those of `posture` that follow it. Bases are assumed to stand still. A known
    wrench on the object is the parameter `external_wrench` (6,) if `motion` takes it.

    With `limits`, torques and wrenches are those of `forces.distribute` instead: they give the object the same
    acceleration and keep friction cones and limits, with the least cost, in which f and qdd have the weights
    `cost.wrench` and `cost.acceleration`. The last number of the law's memory is then by how much limits gave way [N],
    all but 0 unless the acceleration needs more. With a weight `cost.task`, the acceleration gives way to the limits
    instead, near singular postures too, where an arm would need any torque to follow; another number then comes last,
    the largest entry of the object's acceleration that is missed [rad/s^2 or m/s^2].

    Args:
        chain: the controller's model of the chain.
        motion: the object's motion, such as `ObjectImpedance`.
        forces: the grasp forces, such as `InternalForce` (by default none beyond the smallest), `LoadShare` or
            `HybridForce`.
        posture: the motion that moves no grasp, such as `PostureControl`; by default it is damped.
        limits: the limits; None for none. With `sample_time`, limits of joint positions and rates are among them.
        cost: the cost within limits; by default that of least effort, with weight 1 of the joints' accelerations.

    Raises:
        ModelError: a part is of another kind, or does not fit the chain, or there is a cost without limits.
        MethodNotApplicable: no arm has a grasp; or limits of changes are given.

    Reference:
        Caccavale and Uchiyama, Cooperative Manipulation, Springer Handbook of Robotics, 2016.
    """
    forces, posture = InternalForce() if forces is None else forces, PostureControl() if posture is None else posture
    serial_chain(chain, "cooperative law: chain")
    parts = {"motion": (motion, CommandedMotion), "forces": (forces, GraspForces), "posture": (posture, NullMotion)}
    for name, (part, kind) in parts.items():
        checks.instance(part, kind, f"cooperative law: {name}", advice=f"try {EXAMPLES[name]}")
    if not chain.grasps:
        raise MethodNotApplicable("cooperative_law: expected arms that hold the object, got a chain without grasps")
    parameters = {}
    for part, _ in parts.values():
        part.require(chain)
        parameters |= part.parameters(chain)
    within = within_limits(chain, limits, cost, "cooperative law")
    torque = CooperativeTorques(chain, motion, forces, posture, within)
    memory = concatenate([forces.memory(chain), np.zeros(0) if within is None else within.memory])
    return ControlLaw(torque, memory, parameters, exact_fingerprint(torque) or "")


@dataclass(frozen=True, eq=False)
class CooperativeTorques(Frozen):
    """The torques of `cooperative_law`; the attributes are its arguments, limits and cost together."""

    chain: ClosedChain
    motion: CommandedMotion
    forces: GraspForces
    posture: NullMotion
    within: WithinLimits | None = None

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its torques jump [s], as far as they are known in advance."""
        return known_breakpoints(self.motion, self.posture)

    def for_chain(self, chain: ClosedChain) -> CooperativeTorques:
        """Return the torques for a chain whose grasps have changed."""
        within = None if self.within is None else self.within.for_chain(chain)
        return replace(self, chain=chain, forces=self.forces.for_chain(chain), within=within)

    @np.errstate(all="ignore")  # what overflows is refused
    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and the memory."""
        chain = self.chain
        known = Inputs(object_wrench=given.get("external_wrench", np.zeros(6)))
        motion = chain_motion(chain, state, np.zeros(chain.joint_count), known.shaped(chain))
        x = LawInput(t, state, motion, memory if self.within is None else memory[: -len(self.within.memory)], given)
        acceleration = self.motion.acceleration(x)
        wished, joints = self.forces.wished(x, acceleration), self.posture.joint_acceleration(x)
        command = Command(acceleration, wished, joints)
        tau, wrenches, gave_way = chosen_torques(motion, state, command, self.within)
        kept = concatenate([self.forces.kept(x, acceleration, wrenches, tau), gave_way])
        return checks.finite(tau, "cooperative law"), checks.finite(kept, "cooperative law: memory")
