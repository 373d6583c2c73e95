"""Derivatives of the iterations of a projection, by one more solve with the existing factors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.dynamics.arm.motion import at_rest
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.second_solve import Point, point
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.tip_response import Route
from holdfast.dynamics.closed.virtual_power import ArmCase
from holdfast.dynamics.projection import Change, position_contact
from holdfast.dynamics.projection_case import PositionCase, RestTrunk, VelocityCase
from holdfast.dynamics.trunk.trunk_derivatives import TRUNK_LINKS
from holdfast.dynamics.trunk.trunk_power import TrunkCase
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, concatenate, each
from holdfast.state import Inputs, State

OF_POSITIONS = ("q", "object_pose", "floating_pose")
OF_VELOCITIES = ("qd", "object_twist", "floating_twist", "base_twist", "trunk_base_twist")
OF_MODEL = ("grasp_pose", "base_pose", "object_mass", "object_com", "object_inertia", "armature")
OF_LINKS = ("link_mass", "link_com", "link_inertia", *TRUNK_LINKS)
OF_ROUND = (*OF_POSITIONS, *OF_MODEL, *OF_LINKS)
OF_PROJECTION = (*OF_ROUND, *OF_VELOCITIES)


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
    none, object_case = np.zeros(6), motion.object_case
    assert object_case is not None
    cases = {name: closing(kind, case) for name, case in motion.cases.items()}
    gaps = each(lambda case: case.gap({}), [cases[name] for name in motion.chain.grasps])
    still = replace(
        motion.at_rest_with([replace(c, a=none, g=gap) for c, gap in zip(motion.contacts, gaps, strict=True)]),
        arms={name: at_rest(arm) for name, arm in motion.arms.items()},
        cases=cases,
        object_case=object_case._replace(twist=none, wrench=none),
        trunk_case=None if motion.trunk_case is None else resting_trunk(motion.trunk_case),
    )
    return point(still, sequential(still, route), route)


def closing(kind: type[VelocityCase], case: ArmCase) -> VelocityCase:
    """Return an arm's case for a projection."""
    given = replace(case.given, base_acceleration=np.zeros(6), link_wrenches=None)
    return kind(given, case.grasp, case.frame, case.twist)


def resting_trunk(case: TrunkCase) -> RestTrunk:
    """Return a trunk's case for a projection."""
    still = case._replace(tau=0.0 * case.tau, base_acceleration=np.zeros(6), wrenches=0.0 * case.wrenches)
    return RestTrunk(*still)


def change_of(at: Point) -> Change:
    """Return the change made by a projection."""
    chain, found = at.motion.chain, at.found
    of_trunk = [] if found.trunk is None else [found.trunk.qdd]
    dqd = concatenate([*of_trunk, *(at.unknowns[name].qdd for name in chain.arms)])
    return Change(dqd, found.object_acceleration, None if found.trunk is None else found.trunk.base)
