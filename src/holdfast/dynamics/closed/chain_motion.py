"""The whole chain in motion: what every closed-chain algorithm starts from and returns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from holdfast.dynamics.arm.motion import ArmInputs, ArmMotion, arm_motion, resting
from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.closed.object_motion import ObjectMotion, object_motion
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, each
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class ChainMotion:
    """A closed chain at one instant under given torques.

    Attributes:
        chain: the chain.
        arms: every arm in motion, by name.
        contacts: the grasps in motion, in the order of the arms that have one.
        body: the object in motion.
        generic_rank: of the constraint away from singular configurations, where as many rows are to be held
            (`held_rows`); None: each row's pivot decides.
    """

    chain: ClosedChain
    arms: dict[str, ArmMotion]
    contacts: list[Contact]
    body: ObjectMotion
    generic_rank: Scalar = None

    @property
    def holding(self) -> list[ArmMotion]:
        """The arms that have a grasp, in order."""
        return [self.arms[name] for name in self.chain.grasps]


@dataclass(frozen=True, eq=False)
class Solution:
    """What a closed-chain algorithm finds, for the arms that hold, world axes.

    Attributes:
        qdd: per arm, (N,) joint accelerations.
        wrenches: per arm, (6,) f of the arm on the object, about the contact point.
        object_acceleration: (6,) alpha(C), less [0; g].
        contact_acceleration: W_dot, flat, where the algorithm solves for it.
        base_wrenches: per arm, (6,) of the base on the arm, where it falls out.
        pivots: per arm, articulated inertias (or squared Cholesky diagonals), where they are found.
        rank: independent rows of the grasp constraint, where it is found.
        weakest_pivot: the smallest relative pivot met.
        held: which components of the grasps are held, where they are chosen; see `held_rows`.
    """

    qdd: list[Array]
    wrenches: list[Array]
    object_acceleration: Array
    contact_acceleration: Array | None = None
    base_wrenches: list[Array] | None = None
    pivots: list[Array] = field(default_factory=list)
    rank: Scalar = None
    weakest_pivot: Scalar = 1.0
    held: Array | None = None


def pseudo_gravity(chain: ClosedChain) -> Array:
    """Return [0; g], (6,): what true accelerations have more than those used inside."""
    return concatenate([np.zeros(3), chain.gravity])


def chain_motion(chain: ClosedChain, state: State, tau: Array, inputs: Inputs) -> ChainMotion:
    """Return every arm, grasp and the object in motion. O(n) + O(l).

    Args:
        chain: the chain.
        state: positions and velocities, taken as they are (no consistency check).
        tau: (n,) joint torques.
        inputs: shaped inputs (`Inputs.shaped`).
    """
    assert inputs.base_twists is not None and inputs.base_accelerations is not None
    assert inputs.object_wrench is not None
    gravity, frame = pseudo_gravity(chain), state.object_frame
    given = [
        ArmInputs(
            arm,
            state.q[chain.joints[name]],
            state.qd[chain.joints[name]],
            tau[chain.joints[name]],
            inputs.base_twists[i],
            inputs.base_accelerations[i] - gravity,
            None if inputs.link_wrenches is None else inputs.link_wrenches[chain.joints[name]],
        )
        for i, (name, arm) in enumerate(chain.arms.items())
    ]
    found = each(
        lambda of_arm, grasp: arm_and_grasp(of_arm, grasp, frame, state.object_twist),
        given,
        [chain.grasps.get(name) for name in chain.arms],
    )
    body = object_motion(chain.held_object, frame, state.object_twist, inputs.object_wrench)
    return _together(chain, found, body)


def arm_and_grasp(given: ArmInputs, grasp: Grasp | None, frame: Pose, twist: Array) -> tuple[ArmMotion, Contact | None]:
    """Return an arm in motion, and its grasp if it has one.

    Args:
        given: what the arm is given.
        grasp: its grasp.
        frame: pose of the object in the world.
        twist: (6,) of C, world axes.
    """
    motion = arm_motion(given)
    return motion, None if grasp is None else contact(grasp, frame, twist, motion.at.tip.R, motion.tip_twist)


def chain_at_rest(chain: ClosedChain, state: State) -> ChainMotion:
    """Return the chain in a configuration without torques, motion, gravity or external wrenches. O(n) + O(l).

    Args:
        chain: the chain.
        state: positions, taken as they are; velocities do not enter.
    """
    none, frame = np.zeros(6), state.object_frame
    found = each(
        lambda arm, q, grasp: arm_at_rest(arm, q, grasp, frame),
        chain.arms.values(),
        [state.q[part] for part in chain.joints.values()],
        [chain.grasps.get(name) for name in chain.arms],
    )
    return _together(chain, found, object_motion(chain.held_object, frame, none, none))


def arm_at_rest(arm: Arm, q: Array, grasp: Grasp | None, frame: Pose) -> tuple[ArmMotion, Contact | None]:
    """Return an arm at rest, and its grasp if it has one; see `arm_and_grasp`."""
    none = np.zeros(6)
    at = posture(arm, q)
    return resting(arm, at), None if grasp is None else contact(grasp, frame, none, at.tip.R, none)


def _together(chain: ClosedChain, found: list[tuple[ArmMotion, Contact | None]], body: ObjectMotion) -> ChainMotion:
    arms = {name: motion for name, (motion, _) in zip(chain.arms, found, strict=True)}
    return ChainMotion(chain, arms, [held for _, held in found if held is not None], body)
