"""One arm in the programme of force distribution: its costs and limits as a block, and its answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.forces.block_columns import NULL_UNIT, BlockColumn
from holdfast.forces.programme_block import Block, Cone
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import WrenchLimits
from holdfast.model.grasp_kinds import contact_axes
from holdfast.model.joint import Joint
from holdfast.model.wrench_condition import NORMAL, Condition, largest_force_and_moment
from holdfast.questions.arrays import ACCELERATION_LIMITS, CONTACTS, LIMITS
from holdfast.questions.case import Numbers
from holdfast.spatial.scalar import Array, Scalar, array, clip, concatenate, maximum, reciprocal
from holdfast.spatial.spatial_vector import rotate, unrotate

FARTHEST = 1e6  # a limit that is farther away, in units of F0, does not matter
NO_LIMIT = 1e9  # a finite limit that does not matter


class Weights(NamedTuple):
    """What all arms have in common.

    Attributes:
        length: L [m].
        force: F0 [N].
        effort_share: of the effort limits.
        wrench: weight of the wrenches.
        acceleration: weight of the accelerations.
    """

    length: Scalar
    force: Scalar
    effort_share: Scalar
    wrench: Scalar
    acceleration: Scalar

    @property
    def slow(self) -> Scalar:
        """Weight of squared accelerations [s^4/rad^2 or s^4/m^2]."""
        return self.acceleration * self.acceleration * (1.0 / NULL_UNIT / NULL_UNIT)


class OfArm(NamedTuple):
    """The limits and wishes of one arm.

    Attributes:
        effort: (N,) effort limits.
        weight: (N,) of squared torques.
        wished: (N,) accelerations.
        wish: (6,) wrench, contact axes.
        contact: (7,) numbers of `questions.arrays.contact_of`, or none.
        bounds: demanded margin, least and largest normal force, or none.
        acceleration: (2, N) lowest and highest accelerations, or none.
    """

    effort: Array
    weight: Array
    wished: Array
    wish: Array
    contact: Array
    bounds: Array
    acceleration: Array


def of_arm(chain: ClosedChain, own: Numbers, row: int, name: str) -> OfArm:
    """Return the limits and wishes of an arm, the row-th of the chain; `own` as in `programme`."""
    part, contact, bounds = chain.joints[name], np.zeros(0), np.zeros(0)
    if name in chain.grasps:
        k = list(chain.grasps).index(name)
        contact = own[CONTACTS][k]
        bounds = array([own[what][k] for what in ("demanded_margin", "least_normal", "most_normal")])
    accelerations = own[ACCELERATION_LIMITS][:, part] if ACCELERATION_LIMITS in own else np.zeros((2, 0))
    of_joints = own["effort_weight"][part], own["wished_qdd"][part]
    # a derivative has no products of 0 with infinity
    effort, bounds, accelerations = (
        clip(x, -NO_LIMIT, NO_LIMIT) for x in (own[LIMITS][3][part], bounds, accelerations)
    )
    return OfArm(effort, *of_joints, own["wish"][row], contact, bounds, accelerations)


def arm_block(common: Weights, arm: ArmMotion, held: Contact | None, column: BlockColumn, of: OfArm, E: Array) -> Block:
    """Return one arm's block of the programme, in units of F0.

    Args:
        common: weights and units.
        arm: the arm's motion.
        held: its grasp; None if it holds nothing.
        column: its columns.
        of: its limits and wishes.
        E: (rows, n) its coupling rows.
    """
    k, rows, s = column.null.shape[1], len(column.units), column.by_shared.shape[1]
    per_unit = per_torque(common, arm.arm.joints)
    R = [per_unit[:, None] * column.T]
    offset = [per_unit * column.t]
    reach = per_unit * (common.effort_share * of.effort)
    low, high = [-reach], [reach]
    weighted = (column.T.T * of.weight) @ column.T
    square = common.wrench * common.wrench
    faster = common.acceleration * common.acceleration * (1.0 / NULL_UNIT)
    ones = concatenate([np.full(k, 1.0) * (common.acceleration * common.acceleration), np.full(rows, 1.0) * square])
    follow = common.slow * (column.by_shared.T @ column.by_shared)
    P = weighted + block_diagonal([np.diag(ones), follow])
    c = column.T.T @ (of.weight * column.t)
    less = -faster * ((of.wished - column.q0) @ column.null) * (1.0 / NULL_UNIT)
    if of.acceleration.shape[1]:
        motions = [column.null, np.zeros((len(column.null), rows)), column.by_shared]
        R.append(reciprocal(common.force) * np.concatenate(motions, 1))
        offset.append(reciprocal(common.force) * column.q0)
        low.append(reciprocal(common.force) * of.acceleration[0])
        high.append(reciprocal(common.force) * of.acceleration[1])
    cones = []
    if held is not None:
        wish = _wish(held, of.wish) / column.units if rows else np.zeros(0)
        less = concatenate([less, -square * wish])
        to_contact, fixed = _in_contact_axes(held, arm)
        units = column.units * reciprocal(common.force)
        margin, least, most = of.bounds * reciprocal(common.force)
        own = (NORMAL @ to_contact) * units
        R.append(concatenate([np.zeros(k), own, np.zeros(s)])[None])
        known = (NORMAL @ fixed) * reciprocal(common.force)
        offset.append(array([known]))
        pressing = held.grasp.contact is not None
        low.append(array([maximum(least + margin, margin) if pressing else least + margin]))
        high.append(array([most - margin]))
        for one in cone_conditions(held, of.contact):
            rows_of = np.concatenate([one.pressing[None], one.loading])
            none = np.zeros((len(rows_of), k)), np.zeros((len(rows_of), s))
            G = -np.concatenate([none[0], (rows_of @ to_contact) * units, none[1]], 1)
            h = (rows_of @ fixed) * reciprocal(common.force)
            h = concatenate([[h[0] + one.constant * reciprocal(common.force) - margin], h[1:]])
            cones.append(Cone(G, h))
    offsets = concatenate(offset)
    low, high = (clip(concatenate(x), -FARTHEST, FARTHEST) - offsets for x in (low, high))
    less = concatenate([less, common.slow * (column.by_shared.T @ (column.q0 - of.wished))])
    E = np.concatenate([E, np.zeros((len(E), s))], 1)
    return Block(P, c + less, np.concatenate(R), low, high, tuple(cones), E, s)


def per_torque(common: Weights, joints: Sequence[Joint]) -> Array:
    """Return one over the unit of each joint's torque: F0 L if it turns, or F0."""
    return array(
        [reciprocal(common.force * common.length) if joint.turns else reciprocal(common.force) for joint in joints]
    )


def _wish(held: Contact, wish: Array) -> Array:
    """Return the transmitted components of a wrench in axes of the contact frame, (rows,)."""
    if held.grasp.of_kind.axes is contact_axes:
        return held.grasp.of_kind.along(wish)[list(held.rows)]
    return held.transmitted(rotate(held.frame, wish))


def _in_contact_axes(held: Contact, arm: ArmMotion) -> tuple[Array, Array]:
    """Return the matrix from lambda to the wrench in axes of the contact frame (6, rows), and the known wrench (6,)."""
    if arm.known is not None:
        return np.zeros((6, 0)), unrotate(held.frame, arm.known)
    if held.grasp.of_kind.axes is contact_axes:
        return held.grasp.transmission.T, np.zeros(6)
    return array([unrotate(held.frame, row) for row in held.K]).T, np.zeros(6)


def cone_conditions(held: Contact, contact: Array) -> list[Condition]:
    """Return the conditions of a grasp that are cones, with the numbers of `contact`; pressing is a bound."""
    grasp, mu, (moment, force, lever) = held.grasp, contact[1], contact[4:]
    kind, limits = grasp.of_kind, grasp.wrench_limits or WrenchLimits()
    found: list[Condition] = []
    if grasp.contact is not None and kind.friction is not None:
        found += [one for one in kind.friction(mu, contact[2:4]) if one.loading.dtype == object or np.any(one.loading)]
    rated = largest_force_and_moment(moment, force, lever)
    return found + [one for one, x in zip(rated, (limits.force, limits.moment), strict=True) if math.isfinite(x)]


def arm_answer(arm: ArmMotion, held: Contact | None, column: BlockColumn, x: Array) -> tuple[Array, Array, Array]:
    """Return an arm's torques, its accelerations and its wrench on the object."""
    f = np.zeros(6) if arm.known is None else arm.known
    k = column.null.shape[1]
    rows = len(column.units)
    if held is not None and len(held.rows):
        f = held.K.T @ (column.units * x[k : k + rows])
    return column.T @ x + column.t, column.q0 + column.null @ x[:k] + column.by_shared @ x[k + rows :], f
