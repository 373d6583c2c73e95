"""Derivatives of the iterations of a projection onto the grasps, by one more solve with the existing factors.

A projection is forward dynamics at rest, without torques, gravity or springs, with a gap in place of the bias
acceleration at the grasps. Its derivatives follow from its virtual power in the same way (`closed.virtual_power`):
    L = y_q.(M dq + J^T p) + y_a.(M_C dx - sum A^T p) + y_f.(gap + J dq + H^T s - A dx) + y_s.H p
The gap, a function of the state, is a small displacement, or V+ - A V(C). L contains the free part s of the relative
motion although nothing is transmitted there, because the free directions rotate with the object.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, link_twists, tip_twist
from holdfast.dynamics.arm.motion import at_rest
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.second_solve import Point, point
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.tip_response import Route
from holdfast.dynamics.closed.virtual_power import ArmCase, ArmUnknowns
from holdfast.dynamics.projection import Change, position_contact, small_displacement
from holdfast.dynamics.trunk.trunk_power import MountedBase, TrunkCase, TrunkUnknowns
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import LINKS, TRUNK_LINKS
from holdfast.questions.case import Numbers
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, concatenate, each
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State

OF_POSITIONS = ("q", "object_pose", "floating_pose")
OF_VELOCITIES = ("qd", "object_twist", "floating_twist", "base_twist", "trunk_base_twist")
OF_MODEL = ("grasp_pose", "base_pose", "object_mass", "object_com", "object_inertia", "armature")
OF_ROUND = (*OF_POSITIONS, *OF_MODEL, *LINKS, *TRUNK_LINKS)
OF_PROJECTION = (*OF_ROUND, *OF_VELOCITIES)
RATES = ("qd", "base_twist", "object_twist")  # only the gap depends on these


def round_point(chain: ClosedChain, state: State, inputs: Inputs, held: Array | None, route: Route) -> Point:
    """Return one Newton iteration on the position rows (`projection.closer`), with the data for its derivatives.

    Its "qdd" and accelerations are displacements. It can be differentiated with respect to `OF_ROUND`.

    Args:
        chain: the chain.
        state: the state; its velocities are ignored.
        inputs: shaped inputs, which are ignored.
        held: mask of the imposed constraint rows, see `held_rows`; None for all.
        route: method for the tip responses, see `tip_response`.
    """
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    motion = replace(motion, contacts=[position_contact(c) for c in motion.contacts])
    return _closed(holding(motion, held, positions=True), PositionCase, route)


def impulse_point(chain: ClosedChain, state: State, inputs: Inputs, held: Array | None, route: Route) -> Point:
    """Return the projection of velocities (`projection.project_velocities`), with the data for its derivatives.

    It can be differentiated with respect to `OF_PROJECTION`. The arguments are those of `round_point`; of the inputs,
    the base motion matters.
    """
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    return _closed(holding(motion, held), VelocityCase, route)


def _closed(motion: ChainMotion, kind: type[VelocityCase], route: Route) -> Point:
    """Return the projection that closes the gaps of the given kind, by forward dynamics at rest."""
    none, object_case, trunk_case = np.zeros(6), motion.object_case, motion.trunk_case
    assert object_case is not None and trunk_case is not None
    cases = {name: closing(kind, case) for name, case in motion.cases.items()}
    gaps = each(lambda case: case.gap({}), [cases[name] for name in motion.chain.grasps])
    still = replace(
        motion.at_rest_with([replace(c, a=none, g=gap) for c, gap in zip(motion.contacts, gaps, strict=True)]),
        arms={name: at_rest(arm) for name, arm in motion.arms.items()},
        cases=cases,
        object_case=object_case._replace(twist=none, wrench=none),
        trunk_case=resting_trunk(trunk_case),
    )
    return point(still, sequential(still, route), route)


def closing(kind: type[VelocityCase], case: ArmCase) -> VelocityCase:
    """Return an arm's case for a projection."""
    given = replace(case.given, base_acceleration=np.zeros(6), link_wrenches=None)
    return kind(given, case.grasp, case.frame, case.twist)


def resting_trunk(case: TrunkCase) -> RestTrunk:
    """Return a trunk's case for a projection."""
    given = case.serial.given
    still = replace(given, tau=0.0 * given.tau, base_acceleration=np.zeros(6))
    return RestTrunk(case.floating, RestCase(still, *case.serial[1:]), 0.0 * case.wrenches, case.mounts)


def change_of(at: Point) -> Change:
    """Return the change made by a projection."""
    chain, found = at.motion.chain, at.found
    dqd = concatenate([found.trunk.qdd, *(at.unknowns[name].qdd for name in chain.arms)])
    return Change(dqd, found.object_acceleration, found.trunk.base)


class RestCase(ArmCase):
    """An arm without dampers and springs, and its grasp."""

    __slots__ = ()

    def passive_torque(self, q: Array, qd: Array, varied: Numbers) -> Array:
        """Return the torques of dampers and springs, which are zero, (N,)."""
        return np.zeros(len(q))


class VelocityCase(ArmCase):
    """The arguments of the equations of one arm whose grasp is closed in velocity."""

    __slots__ = ()

    @property
    def in_motion(self) -> bool:
        """False, because the arm is at rest and the gap of its grasp replaces the motion of the tip."""
        return False

    def power(self, z: ArmUnknowns, y: ArmUnknowns, varied: Numbers) -> Scalar:
        """Return the arm's and its grasp's part of L; see `ArmCase.power`."""
        given, none = self.given, np.zeros(6)
        holds = self.grasp is not None and self.grasp.of_kind.bushing is None
        resting = replace(given, qd=np.zeros(len(given.q)), tau=np.zeros(len(given.q)), base_twist=none)
        still = RestCase(resting, self.grasp if holds else None, self.frame, none)
        arm, at = self.configuration(varied)
        power = still.power_at(arm, at, z, y, {name: x for name, x in varied.items() if name not in RATES})
        return power + y.wrench @ self.gap_at(arm, at, varied) if holds else power

    def gap(self, varied: Numbers) -> Array:
        """Return the gap of the grasp, tip side minus object side about the contact point, (6,) world axes."""
        return self.gap_at(*self.configuration(varied), varied)

    def gap_at(self, arm: Arm, at: Kinematics, varied: Numbers) -> Array:
        """Return `gap` for a given `configuration`."""
        grasp, none = self.grasp, np.zeros(6)
        assert grasp is not None
        frame = grasp.frame
        held = grasp.standing_at(Pose.unchecked(varied.get("grasp_R", frame.R), varied.get("grasp_p", frame.p)))
        of_object = Pose.unchecked(varied.get("object_R", self.frame.R), varied.get("object_p", self.frame.p))
        c = contact(held, of_object, none, at.tip, none)
        return self.gap_of(c, of_object, arm, at, varied)

    def gap_of(self, c: Contact, of_object: Pose, arm: Arm, at: Kinematics, varied: Numbers) -> Array:
        """Return the gap V+ - A V(C) of a contact."""
        qd, base = (varied.get(name, getattr(self.given, name)) for name in ("qd", "base_twist"))
        moving = tip_twist(arm, at, link_twists(arm, at, qd, base), base)
        return moving - shift_twist(c.offset, varied.get("object_twist", self.twist))


class PositionCase(VelocityCase):
    """The arguments of the equations of one arm whose grasp is closed in position."""

    __slots__ = ()

    def gap_of(self, c: Contact, of_object: Pose, arm: Arm, at: Kinematics, varied: Numbers) -> Array:
        """Return the gap of a contact, the small displacement of the tip relative to the object."""
        return small_displacement(c, of_object.p + c.origin, at.tip)


class RestTrunk(TrunkCase):
    """A trunk at rest, without dampers and springs, on which arms are mounted.

    Its twists matter only through those of the arms' bases.
    """

    __slots__ = ()

    def outward(self, z: TrunkUnknowns, y: TrunkUnknowns, varied: Numbers) -> tuple[Scalar, list[MountedBase]]:
        """Return the trunk's part of L, and the bases mounted on it; see `TrunkCase.outward`."""
        still = {"qd": np.zeros(len(self.serial.given.q)), "base_twist": np.zeros(6)}
        power, carried = super().outward(z, y, {**varied, **still})
        _, moving = super().outward(z, y, varied)
        return power, [a._replace(base_twist=b.base_twist) for a, b in zip(carried, moving, strict=True)]
