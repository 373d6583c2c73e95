"""The input and the output of every closed-chain algorithm: `ChainMotion` and `Solution`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics
from holdfast.dynamics.arm.motion import ArmInputs, ArmMotion, arm_motion, resting
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.closed.force_elements import deflection, with_force_elements
from holdfast.dynamics.closed.object_motion import ObjectMotion, object_motion
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.closed.virtual_power import ArmCase, ObjectCase
from holdfast.dynamics.trunk.trunk_motion import (
    NO_ACCELERATION,
    NO_TRUNK,
    TrunkAcceleration,
    TrunkMotion,
    base_motion,
    trunk_at_rest,
    trunk_motion,
)
from holdfast.dynamics.trunk.trunk_power import TrunkCase
from holdfast.model.arm import Anchor, Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.model.trunk import TRUNK
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, each, scan
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class ChainMotion:
    """The kinematics, bias terms and loads of a closed chain at one instant, with given torques.

    Attributes:
        chain: the chain.
        arms: motion of every arm, by name.
        contacts: the grasps, in the order of the arms that have one.
        body: motion of the object; its wrench includes those of bushings.
        generic_rank: number of independent constraint rows away from singular configurations, as many of which are then
            imposed (`held_rows`); None if the pivot of each row decides.
        trunk: motion of the trunk.
        cases: arguments of every arm's equations, by name; empty for a chain at rest.
        object_case: arguments of the object's equations; None at rest.
        trunk_case: arguments of the trunk's equations; None at rest.
    """

    chain: ClosedChain
    arms: dict[str, ArmMotion]
    contacts: list[Contact]
    body: ObjectMotion
    generic_rank: Scalar = None
    trunk: TrunkMotion = NO_TRUNK
    cases: Mapping[str, ArmCase] = field(default_factory=dict)
    object_case: ObjectCase | None = None
    trunk_case: TrunkCase | None = None

    @property
    def lone_on_trunk(self) -> list[str]:
        """The arms without a grasp that are mounted on the trunk, in order; they load the trunk, too."""
        return [name for name in self.chain.mounted_on if name not in self.chain.grasps]

    @property
    def holding(self) -> list[ArmMotion]:
        """The arms that have a grasp, in order."""
        return [self.arms[name] for name in self.chain.grasps]

    def at_rest_with(self, contacts: list[Contact]) -> ChainMotion:
        """Return the motion with other contacts, and with object and trunk at rest, for the filter of a projection."""
        body = replace(self.body, free=self.body.free.at_rest())
        return replace(self, contacts=contacts, body=body, trunk=self.trunk.at_rest())


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a closed-chain algorithm for the arms with a grasp, in world axes.

    Some algorithms leave optional fields at their defaults.

    Attributes:
        qdd: per arm, (N,) joint accelerations.
        wrenches: per arm, (6,) wrench f of the arm on the object, about the contact point.
        object_acceleration: (6,) alpha(C) minus [0; g].
        contact_acceleration: W_dot of all grasps, flat, if the algorithm solves for it.
        base_wrenches: per arm, (6,) wrench of the base on the arm, if the algorithm computes it.
        pivots: per arm, articulated inertias (or squared Cholesky diagonals), if they are computed.
        rank: number of independent rows of the grasp constraint, if it is computed.
        weakest_pivot: the smallest relative pivot.
        held: mask of the constraint rows that are imposed, if they were chosen; see `held_rows`.
        trunk: acceleration of the trunk.
        trunk_pivots: (n_t,) articulated inertias about the joints of the trunk.
        tips: per arm, its tip response, if the algorithm uses it.
        factors, second: as returned by `chain_elimination`.
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
    trunk: TrunkAcceleration = NO_ACCELERATION
    trunk_pivots: Array = field(default_factory=lambda: np.zeros(0))
    tips: list[TipResponse] = field(default_factory=list)
    factors: Any = None
    second: Any = None


def pseudo_gravity(chain: ClosedChain) -> Array:
    """Return [0; g], (6,), the difference between true accelerations and those used inside the algorithms."""
    return concatenate([np.zeros(3), chain.gravity])


def needed_wrench(motion: ChainMotion, alpha: Array) -> Array:
    """Return the wrench of all grasps on the object about C that moves it, M(C) (alpha - [0; g]) + b(C) - w, (6,)."""
    body = motion.body
    return body.inertia.apply(alpha - pseudo_gravity(motion.chain)) + body.bias - body.wrench


def chain_motion(
    chain: ClosedChain, state: State, tau: Array, inputs: Inputs, there: ChainMotion | None = None
) -> ChainMotion:
    """Return the motion of every arm, of the grasps and of the object. O(n) + O(l).

    Args:
        chain: the chain.
        state: positions and velocities, which are not checked for consistency.
        tau: (n,) joint torques.
        inputs: shaped inputs (`Inputs.shaped`).
        there: a motion at the same positions, whose configurations of the arms are taken; None for none.
    """
    inputs = with_force_elements(chain, state, inputs)
    assert inputs.base_twists is not None and inputs.base_accelerations is not None
    assert inputs.object_wrench is not None
    gravity, frame, twist_of_object = pseudo_gravity(chain), state.object_frame, state.object_twist
    trunk = trunk_motion(chain, state, tau, inputs)
    mounts = trunk.mounts
    bases = list(zip(inputs.base_twists, inputs.base_accelerations - gravity, strict=True))
    first = chain.joint_count - sum(arm.joint_count for arm in chain.arms.values())  # first row in link wrenches
    given = []
    for i, (name, arm) in enumerate(chain.arms.items()):
        part, mount = chain.joints[name], mounts.get(name)
        links = None
        if inputs.link_wrenches is not None:
            links = inputs.link_wrenches[part.start - first : part.stop - first]
        twist, acceleration = bases[i] if mount is None else (mount.twist, mount.acceleration)
        on = arm if mount is None else arm.standing_at(mount.frame)
        of_joints = state.q[part], state.qd[part], tau[part]
        columns = None if mount is None else mount.columns
        given.append(ArmInputs(on, *of_joints, twist, acceleration, links, columns))
    found = each(
        lambda at, of_arm, grasp: arm_and_grasp(ArmCase(of_arm, grasp, frame, twist_of_object), at),
        [None if there is None else there.arms[name].at for name in chain.arms],
        given,
        [chain.grasps.get(name) for name in chain.arms],
    )
    known = [(c.offset, motion.known) for motion, c, _ in found if c is not None and motion.known is not None]
    pushed, _ = scan(lambda w, at: (w + shift_wrench(*at), None), inputs.object_wrench, known)
    body = object_motion(chain.held_object, frame, twist_of_object, pushed)
    motion = _together(chain, [(arm, held) for arm, held, _ in found], body, trunk)
    cases = {name: case for name, (_, _, case) in zip(chain.arms, found, strict=True)}
    held = ObjectCase(chain.held_object, frame, twist_of_object, pushed)
    return replace(motion, cases=cases, object_case=held, trunk_case=trunk_case(chain, state, tau, inputs))


def trunk_case(chain: ClosedChain, state: State, tau: Array, inputs: Inputs) -> TrunkCase:
    """Return the arguments of the trunk's equations."""
    trunk, none = chain.trunk, np.zeros(6)
    if trunk is None:
        nothing = ArmInputs(Anchor(), none[:0], none[:0], none[:0], none, none)
        return TrunkCase(None, ArmCase(nothing, None, NO_TRUNK.base, none), np.zeros((0, 6)), {})
    part, (twist, zeta) = chain.joints[TRUNK], base_motion(chain, state, inputs)
    wrenches = inputs.trunk_link_wrenches
    mounts = {name: (k, chain.arms[name].base) for name, k in chain.mounted_on.items()}
    base = trunk.base if state.base_frame is None else state.base_frame
    pushed = np.zeros((len(trunk.bodies), 6)) if wrenches is None else wrenches
    serial = (Anchor() if trunk.serial is None else trunk.serial).standing_at(base)
    given = ArmInputs(serial, state.q[part], state.qd[part], tau[part], twist, zeta)
    return TrunkCase(trunk.floating, ArmCase(given, None, base, none), pushed, mounts)


def arm_and_grasp(case: ArmCase, at: Kinematics | None = None) -> tuple[ArmMotion, Contact | None, ArmCase]:
    """Return the motion of an arm, its contact (None without a grasp), and the arguments of its equations.

    Args:
        case: the arguments.
        at: the arm's configuration, if it is known.
    """
    motion = arm_motion(case.given, at)
    if case.grasp is None:
        return motion, None, case
    held = contact(case.grasp, case.frame, case.twist, motion.at.tip, motion.tip_twist)
    bushing = case.grasp.of_kind.bushing is not None
    return motion.exerting(deflection(held).wrench()) if bushing else motion, held, case


def chain_at_rest(chain: ClosedChain, state: State) -> ChainMotion:
    """Return the chain at a configuration, without velocities, torques, gravity or external wrenches. O(n) + O(l).

    Args:
        chain: the chain.
        state: positions, which are not checked for consistency; velocities are ignored.
    """
    none, frame = np.zeros(6), state.object_frame
    trunk = trunk_at_rest(chain, state)
    mounts = trunk.mounts
    found = each(
        lambda arm, q, grasp, columns: arm_at_rest(arm, q, grasp, frame, columns),
        [arm.standing_at(mounts[name].frame) if name in mounts else arm for name, arm in chain.arms.items()],
        [state.q[part] for part in chain.arm_joints],
        [chain.grasps.get(name) for name in chain.arms],
        [mounts[name].columns if name in mounts else None for name in chain.arms],
    )
    return _together(chain, found, object_motion(chain.held_object, frame, none, none), trunk)


def arm_at_rest(
    arm: Arm, q: Array, grasp: Grasp | None, frame: Pose, base_columns: Array | None = None
) -> tuple[ArmMotion, Contact | None]:
    """Return an arm at rest, and its contact (None without a grasp); see `arm_and_grasp`."""
    none = np.zeros(6)
    at = forward_kinematics(arm, q)
    still = resting(arm, at, base_columns)
    return still, None if grasp is None else contact(grasp, frame, none, at.tip, none)


def _together(
    chain: ClosedChain,
    found: list[tuple[ArmMotion, Contact | None]],
    body: ObjectMotion,
    trunk: TrunkMotion,
) -> ChainMotion:
    arms = {name: motion for name, (motion, _) in zip(chain.arms, found, strict=True)}
    return ChainMotion(chain, arms, [held for _, held in found if held is not None], body, trunk=trunk)
