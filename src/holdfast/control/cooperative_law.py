"""Control laws of cooperating arms, put together from the object's motion, the grasp forces and the null motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from holdfast.control.commanded_torques import Command, commanded_torques
from holdfast.control.controller import ControlLaw
from holdfast.control.internal_force import InternalForce
from holdfast.control.law_parts import CommandedMotion, GraspForces, LawInput, NullMotion
from holdfast.control.posture_control import PostureControl
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.errors import MethodNotApplicable
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import Inputs, State


def cooperative_law(
    chain: ClosedChain, motion: CommandedMotion, forces: GraspForces | None = None, posture: NullMotion | None = None
) -> ControlLaw:
    """Return the law tau = M qdd + C + J^T f of an object motion, grasp forces and a null motion.

    The object's acceleration is that of `motion`; f are the wrenches nearest to those of `forces` that give it; qdd are
    the joint accelerations nearest to those of `posture` that follow it. Bases are assumed to stand still. A known
    wrench on the object is the parameter `external_wrench` (6,) if `motion` takes it.

    Args:
        chain: the controller's model of the chain.
        motion: the object's motion, such as `ObjectImpedance`.
        forces: the grasp forces, such as `InternalForce` (by default none beyond the smallest), `LoadShare` or
            `HybridForce`.
        posture: the motion that moves no grasp, such as `PostureControl`; by default it is damped.

    Raises:
        ModelError: a part is of another kind, or does not fit the chain.
        MethodNotApplicable: no arm has a grasp.

    Reference:
        Caccavale and Uchiyama, Cooperative Manipulation, Springer Handbook of Robotics, 2016.
    """
    forces, posture = InternalForce() if forces is None else forces, PostureControl() if posture is None else posture
    checks.instance(chain, ClosedChain, "cooperative law: chain")
    parts = {"motion": (motion, CommandedMotion), "forces": (forces, GraspForces), "posture": (posture, NullMotion)}
    for name, (part, kind) in parts.items():
        checks.instance(part, kind, f"cooperative law: {name}")
    if not chain.grasps:
        raise MethodNotApplicable("cooperative_law: expected arms that hold the object, got a chain without grasps")
    parameters = {}
    for part, _ in parts.values():
        part.require(chain)
        parameters |= part.parameters(chain)
    torque = CooperativeTorques(chain, motion, forces, posture)
    return ControlLaw(torque, forces.memory(chain), parameters, exact_fingerprint(torque) or "")


@dataclass(frozen=True, eq=False)
class CooperativeTorques(Frozen):
    """The torques of `cooperative_law`; the attributes are its arguments."""

    chain: ClosedChain
    motion: CommandedMotion
    forces: GraspForces
    posture: NullMotion

    def for_chain(self, chain: ClosedChain) -> CooperativeTorques:
        """Return the torques for a chain whose grasps have changed."""
        return replace(self, chain=chain, forces=self.forces.for_chain(chain))

    @np.errstate(all="ignore")  # what overflows is refused
    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and the memory."""
        chain = self.chain
        known = Inputs(object_wrench=given.get("external_wrench", np.zeros(6)))
        motion = chain_motion(chain, state, np.zeros(chain.joint_count), known.shaped(chain))
        x = LawInput(t, state, motion, memory, given)
        acceleration = self.motion.acceleration(x)
        wished, joints = self.forces.wished(x, acceleration), self.posture.joint_acceleration(x)
        tau, wrenches = commanded_torques(motion, Command(acceleration, wished, joints))
        kept = self.forces.kept(x, acceleration, wrenches, tau)
        return checks.finite(tau, "cooperative law"), checks.finite(kept, "cooperative law: memory")
