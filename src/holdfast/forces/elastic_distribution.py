"""The distribution of forces in one elastic programme, in the vocabulary of `spatial.scalar`, as machine code asks it.

    min   1/2 sum w_j tau_j^2 + 1/2 wrench_weight^2 sum |(lambda - wish) / F0|^2
          + 1/2 acceleration_weight^2 sum ((qdd_j - wished_qdd_j) / 10)^2 + price v / F0 + 1/2 (v / F0)^2

over all accelerations and wrenches that give the object its acceleration, where every limit gives way by v [N]: torques
of turning joints by v L, conditions of grasps and forces of sliding joints by v. L is the rms distance of the contact
points from their centroid; F0 is the size of the wrench that the object needs, with moments divided by L.
Limits of joint accelerations give way by 1 rad/s^2 or m/s^2 for each newton.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, needed_wrench, pseudo_gravity
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.constraint import length_scale
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.forces.acceleration_map import SMALLEST_FORCE_SCALE
from holdfast.forces.block_columns import NULL_UNIT, BlockColumn, block_column
from holdfast.forces.elastic_derivatives import central_point, require_barrier
from holdfast.forces.elastic_programme import ITERATIONS
from holdfast.forces.limit_rows import acceleration_ranges
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.forces.programme_block import Block, Cone
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import WrenchLimits
from holdfast.model.grasp_kinds import contact_axes
from holdfast.model.wrench_condition import NORMAL, Condition, largest_force_and_moment
from holdfast.questions.arrays import (
    ACCELERATION_LIMITS,
    ARGUMENTS,
    ARRAYS,
    CONTACTS,
    DISTRIBUTED,
    LIMITS,
    OBJECT,
    RATE_2,
    STATE,
    TORQUE,
    Row,
    value_of,
)
from holdfast.questions.case import Numbers, VariedCase
from holdfast.questions.derivatives import declare
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array, Scalar, array, clip, concatenate, each, maximum, reciprocal, sqrt, where
from holdfast.spatial.spatial_vector import rotate, unrotate
from holdfast.spatial.vector import largest
from holdfast.state import State

FARTHEST = 1e6  # a limit that is farther away, in units of F0, does not matter
NO_LIMIT = 1e9  # a finite limit that does not matter


class ElasticDistribution(NamedTuple):
    """Torques, accelerations and wrenches that fit together.

    Attributes:
        tau: (n,) torques of the drives [N m or N].
        qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
        grasp_wrench: (arms, 6) as in `ForwardResult`.
        violation: v, by how much limits give way [N]; all but 0 where they can be kept.
        missed: largest acceleration of a contact that its arm cannot follow, with turns multiplied by L [m/s^2]; all
            but 0 where the asked acceleration is possible.
        residual: of the optimality conditions, relative.
    """

    tau: Array
    qdd: Array
    grasp_wrench: Array
    violation: Array
    missed: Array
    residual: Array


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


class OfArm(NamedTuple):
    """The limits and wishes of one arm.

    Attributes:
        effort: (N,) effort limits.
        weight: (N,) of squared torques.
        wished: (N,) accelerations.
        wish: (6,) wrench, contact axes.
        contact: (6,) numbers of `questions.arrays.contact_of`, or none.
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


class Programme(NamedTuple):
    """The programme of one case.

    Attributes:
        arms: the motions of the arms, in order.
        held: their grasps; None for an arm that holds nothing.
        columns: their columns.
        blocks: their blocks, in units of F0.
        e: (6,) wrench that the object needs, in units of F0.
        force: F0 [N].
    """

    arms: list[ArmMotion]
    held: list[Contact | None]
    columns: list[BlockColumn]
    blocks: list[Block]
    e: Array
    force: Scalar


def programme(motion: ChainMotion, own: Numbers) -> Programme:
    """Return the elastic programme of a chain's motion. O(n) + O(l), and N^3 for an arm of N joints.

    Args:
        motion: the chain's motion, without torques; external wrenches in it count as known.
        own: the wanted acceleration of the object, and the parameters of `distribute` by name.

    Raises:
        MethodNotApplicable: the chain has a trunk.
    """
    chain = motion.chain
    if chain.trunk is not None:
        raise MethodNotApplicable(
            "distribute: machine code is for arms whose bases are in the world, got a chain with a trunk;"
            " holdfast.forces.distribute answers it"
        )
    contacts = dict(zip(chain.grasps, motion.contacts, strict=True))
    alpha = own["acceleration"] - pseudo_gravity(chain)
    length = length_scale([c.offset for c in motion.contacts])
    to_force = concatenate([np.full(3, 1.0) * reciprocal(length), np.ones(3)])
    needed = to_force * needed_wrench(motion, own["acceleration"])
    given = own["force_scale"][()]
    force = where(given > 0.0, given, maximum(SMALLEST_FORCE_SCALE, sqrt(needed @ needed)))
    weights = (own[name][()] for name in ("effort_share", "wrench_weight", "acceleration_weight"))
    common = Weights(length, force, *weights)
    held = [contacts.get(name) for name in chain.names]
    arms = list(motion.arms.values())
    columns = each(lambda arm, c: block_column(arm, c, alpha, length, force), arms, held)
    of = [_of_arm(chain, own, k, name) for k, name in enumerate(chain.names)]
    blocks = each(lambda *given: _block(common, to_force, *given), arms, held, columns, of)
    return Programme(arms, held, columns, blocks, needed * reciprocal(force), force)


def distributed(case: VariedCase, iterations: int = ITERATIONS) -> tuple[Array, ...]:
    """Return the results in the order of `ElasticDistribution`."""
    none = np.zeros(case.chain.joint_count)
    return distribution(chain_motion(case.chain, case.state, none, case.inputs), case.own, iterations)


def distribution(motion: ChainMotion, own: Numbers, iterations: int = ITERATIONS) -> ElasticDistribution:
    """Return the torques, accelerations and wrenches; see `programme`."""
    made = programme(motion, own)
    price, barrier = (own[name][()] for name in ("price", "barrier"))
    found = central_point(made.blocks, made.e, price, iterations, barrier)
    answers = each(_answer, made.arms, made.held, made.columns, found.x)
    return ElasticDistribution(
        concatenate([tau for tau, *_ in answers]),
        concatenate([qdd for _, qdd, _ in answers]),
        array([f for *_, f in answers]),
        array(made.force * found.v),
        array(largest(column.missed for column in made.columns)),
        array(found.residual),
    )


def distribution_parameters(
    chain: ClosedChain, state: State, limits: ForceLimits | None = None, cost: ForceCost | None = None
) -> dict[str, Array]:
    """Return the run-time parameters with which compiled `distribute` has these limits and this cost.

    Limits of accelerations are among them only if there are any; the chain is then compiled with
    `parameters=["acceleration_limits"]`. Those of a sampled controller are of the given state. O(n).

    Args:
        chain: the chain.
        state: positions and rates, for the limits of a sampled controller.
        limits: the limits.
        cost: the cost.

    Raises:
        MethodNotApplicable: a change from the last wrenches is limited, or the asked acceleration may give way.
        ModelError, StateError: a name is unknown, or a shape is wrong.
    """
    limits, cost = limits or ForceLimits(), cost or ForceCost()
    if limits.last_wrench is not None:
        raise MethodNotApplicable(
            "distribute: machine code has no limit on the change of wrenches; try least_normal and most_normal, or"
            " holdfast.forces.distribute"
        )
    if cost.task is not None:
        raise MethodNotApplicable(
            "distribute: machine code keeps the asked acceleration exactly; try cost: task=None, or"
            " holdfast.forces.distribute"
        )
    found = {"effort_share": np.array(NO_LIMIT if limits.effort is None else limits.effort)}
    of_grasps = {"demanded_margin": "least_margin", "least_normal": "least_normal", "most_normal": "most_normal"}
    for name, what in of_grasps.items():
        given = limits.of_grasps(what, chain)
        own = value_of(name, chain)
        every = [given.get(arm, x) for arm, x in zip(chain.grasps, own, strict=True)]
        found[name] = clip(np.array(every), -NO_LIMIT, NO_LIMIT)
    if limits.acceleration or limits.sample_time is not None:
        found[ACCELERATION_LIMITS] = clip(acceleration_ranges(chain, state, limits), -NO_LIMIT, NO_LIMIT)
    found |= {"effort_weight": cost.effort_weights(chain), "price": np.array(cost.price)}
    found["barrier"] = np.array(cost.barrier)
    found |= {"wrench_weight": np.array(cost.wrench), "acceleration_weight": np.array(cost.acceleration)}
    for name, x in (("wish", cost.wish), ("wished_qdd", cost.joint_acceleration)):
        if x is not None:
            found[name] = checks.numbers(x, ARRAYS[name].shape(chain), f"cost: {name}", StateError)
    return found


def _of_arm(chain: ClosedChain, own: Numbers, row: int, name: str) -> OfArm:
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


def _block(
    common: Weights, to_force: Array, arm: ArmMotion, held: Contact | None, column: BlockColumn, of: OfArm
) -> Block:
    """Return one arm's block of the programme, in units of F0.

    Args:
        common: weights and units.
        to_force: (6,) what makes a wrench newtons.
        arm: the arm's motion.
        held: its grasp; None if it holds nothing.
        column: its columns.
        of: its limits and wishes.
    """
    k, rows = column.null.shape[1], len(column.units)
    turns = [joint.turns for joint in arm.arm.joints]
    per_unit = array([reciprocal(common.force * common.length) if turn else reciprocal(common.force) for turn in turns])
    R = [per_unit[:, None] * column.T]
    offset = [per_unit * column.t]
    reach = per_unit * (common.effort_share * of.effort)
    low, high = [-reach], [reach]
    weighted = (column.T.T * of.weight) @ column.T
    square = common.wrench * common.wrench
    faster = common.acceleration * common.acceleration * (1.0 / NULL_UNIT)
    ones = concatenate([np.full(k, 1.0) * (common.acceleration * common.acceleration), np.full(rows, 1.0) * square])
    P = weighted + np.diag(ones)
    c = column.T.T @ (of.weight * column.t)
    less = -faster * ((of.wished - column.q0) @ column.null) * (1.0 / NULL_UNIT)
    if of.acceleration.shape[1]:
        R.append(reciprocal(common.force) * np.concatenate([column.null, np.zeros((len(turns), rows))], 1))
        offset.append(reciprocal(common.force) * column.q0)
        low.append(reciprocal(common.force) * of.acceleration[0])
        high.append(reciprocal(common.force) * of.acceleration[1])
    E, cones = column.E, []
    if held is not None:
        wish = _wish(held, of.wish) / column.units if rows else np.zeros(0)
        less = concatenate([less, -square * wish])
        to_contact, fixed = _in_contact_axes(held, arm)
        units = column.units * reciprocal(common.force)
        margin, least, most = of.bounds * reciprocal(common.force)
        own = (NORMAL @ to_contact) * units
        R.append(concatenate([np.zeros(k), own])[None])
        known = (NORMAL @ fixed) * reciprocal(common.force)
        offset.append(array([known]))
        pressing = held.grasp.contact is not None
        low.append(array([maximum(least + margin, margin) if pressing else least + margin]))
        high.append(array([most - margin]))
        for one in _conditions(held, of.contact):
            rows_of = np.concatenate([one.pressing[None], one.loading])
            G = -np.concatenate([np.zeros((len(rows_of), k)), (rows_of @ to_contact) * units], 1)
            h = (rows_of @ fixed) * reciprocal(common.force)
            h = concatenate([[h[0] + one.constant * reciprocal(common.force) - margin], h[1:]])
            cones.append(Cone(G, h))
    offsets = concatenate(offset)
    low, high = (clip(concatenate(x), -FARTHEST, FARTHEST) - offsets for x in (low, high))
    E = (E.T * (to_force * reciprocal(common.force))).T
    return Block(P, c + less, np.concatenate(R), low, high, tuple(cones), E)


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


def _conditions(held: Contact, contact: Array) -> list[Condition]:
    """Return the conditions of a grasp that are cones, with the numbers of `contact`; pressing is a bound."""
    grasp, (_, mu, size, moment, force, lever) = held.grasp, contact
    kind, limits = grasp.of_kind, grasp.wrench_limits or WrenchLimits()
    found: list[Condition] = []
    if grasp.contact is not None and kind.friction is not None:
        found += [one for one in kind.friction(mu, size) if one.loading.dtype == object or np.any(one.loading)]
    rated = largest_force_and_moment(moment, force, lever)
    return found + [one for one, x in zip(rated, (limits.force, limits.moment), strict=True) if math.isfinite(x)]


def _answer(arm: ArmMotion, held: Contact | None, column: BlockColumn, x: Array) -> tuple[Array, Array, Array]:
    """Return an arm's torques, its accelerations and its wrench on the object."""
    f = np.zeros(6) if arm.known is None else arm.known
    k = column.null.shape[1]
    if held is not None and len(held.rows):
        f = held.K.T @ (column.units * x[k:])
    return column.T @ x + column.t, column.q0 + column.null @ x[:k], f


DISTRIBUTE = declare(
    Question(
        "distribute",
        distributed,
        (
            Row("tau", ("n",), TORQUE, "torques of the drives"),
            Row("qdd", ("n",), RATE_2, "joint accelerations"),
            Row("grasp_wrench", ("arms", 6), "N m, N", "wrench [moment; force] of each arm on the object about the"
                " contact point, world axes"),
            Row("violation", (), "N", "by how much limits give way; all but 0 where they can be kept"),
            Row("missed", (), "m/s^2", "largest acceleration of a contact that its arm cannot follow"),
            Row("residual", (), "", "of the optimality conditions, relative"),
        ),
        "the torques and grasp wrenches for an acceleration of the object under limits, with the least effort",
        inputs=(*STATE, "acceleration"),
        parameters=(
            *("gravity", *OBJECT, "object_wrench", "base_R", "base_p", "base_twist", "base_acceleration"),
            *("grasp_R", "grasp_p", LIMITS, CONTACTS, *DISTRIBUTED),
        ),
        optional=(ACCELERATION_LIMITS,),
        iterative=True,
        arguments=(*STATE, "acceleration", *(name for name in ARGUMENTS if name not in (*STATE, "tau")), *DISTRIBUTED),
        by=(*STATE, "acceleration"),
        depends_on=("grasps", "links", "forces", "bushings", "limits"),
        differentiable=require_barrier,
        returns="ElasticDistribution",
        shown=lambda chain: lambda found: ElasticDistribution(**found),
    ),
)  # fmt: skip
