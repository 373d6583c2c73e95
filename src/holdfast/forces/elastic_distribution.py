"""The distribution of forces in one elastic programme, in the vocabulary of `spatial.scalar`, as machine code asks it.

    min   1/2 sum w_j tau_j^2 + 1/2 wrench_weight^2 sum |(lambda - wish) / F0|^2
          + 1/2 acceleration_weight^2 sum ((qdd_j - wished_qdd_j) / 10)^2 + price v / F0 + 1/2 (v / F0)^2

over all accelerations and wrenches that give the object the asked acceleration a, or rows of it, S alpha = S a. With a
task_weight W, what is asked gives way at the cost 1/2 W^2 |S (alpha - a)|^2, and the price is multiplied by
1 + (W |S (a - [0; g])|)^2 / 1000, so that the limits give way last. They do so by v [N]: torques
of turning joints by v L, conditions of grasps and forces of sliding joints by v. L is the rms distance of the contact
points from their centroid; F0 is the size of the wrench that the object needs, with moments divided by L.
Limits of joint accelerations give way by 1 rad/s^2 or m/s^2 for each newton.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, needed_wrench, pseudo_gravity
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.constraint import length_scale
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.forces.acceleration_map import asked_rows
from holdfast.forces.affine_map import SMALLEST_FORCE_SCALE
from holdfast.forces.arm_block import FARTHEST, NO_LIMIT, OfArm, Weights, arm_answer, arm_block, of_arm, per_torque
from holdfast.forces.block_columns import BlockColumn, block_column
from holdfast.forces.elastic_derivatives import central_point, require_barrier
from holdfast.forces.elastic_programme import ITERATIONS, Distributed
from holdfast.forces.limit_prices import GRASP_LIMITS, JOINT_LIMITS, grasp_prices, joint_prices
from holdfast.forces.limit_rows import acceleration_ranges
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.forces.programme_block import Block
from holdfast.forces.programme_border import (
    Demand,
    JoinedRows,
    Shared,
    border_block,
    joined_rows,
    scaled,
    shared_accelerations,
)
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.model.trunk import TRUNK
from holdfast.questions.arrays import (
    ACCELERATION_LIMITS,
    ARGUMENTS,
    ARRAYS,
    CONTACTS,
    DISTRIBUTED,
    FLOATING,
    FLOATING_RESULT,
    LIMITS,
    OBJECT,
    RATE_2,
    STATE,
    TASK,
    TASK_WEIGHT,
    TORQUE,
    TRUNK_BASE_MOTION,
    TRUNK_LINKS,
    Row,
    value_of,
)
from holdfast.questions.case import Numbers, VariedCase
from holdfast.questions.derivatives import declare
from holdfast.questions.question import Question
from holdfast.spatial.linalg import ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, clip, concatenate, each, maximum, reciprocal, sqrt, where
from holdfast.spatial.vector import largest
from holdfast.state import State

TASK_IN_PRICE = 1e-3  # part of the cost of a falling object by which the price is raised
LEAST_PRICE = 1e-7  # smaller ones, and smaller parts of the largest, are rounding


class ElasticDistribution(NamedTuple):
    """Torques, accelerations and wrenches that fit together.

    Attributes:
        tau: (n,) torques of the drives [N m or N].
        qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
        grasp_wrench: (arms, 6) as in `ForwardResult`.
        object_acceleration: (6,) as there; what is asked, unless some of it is free or gives way.
        violation: v, by how much limits give way [N]; all but 0 where they can be kept.
        missed: largest acceleration of a contact that its arm cannot follow, with turns multiplied by L [m/s^2], or
            largest entry by which an asked acceleration is missed, since it may give way or since no wrenches of the
            grasps can give it [rad/s^2 or m/s^2].
        residual: of the optimality conditions, relative.
        joint_price: (n, 2) decrease of the cost when the limit of a joint's effort, or of its acceleration, is raised
            by one unit.
        grasp_price: (arms, 7) the same for the limits of a grasp and 1 N; friction, pressing, edge, force and moment
            rating, least and most normal force.
        floating_acceleration: (6,) acceleration of a floating base, world axes; None without one.
    """

    tau: Array
    qdd: Array
    grasp_wrench: Array
    object_acceleration: Array
    violation: Array
    missed: Array
    residual: Array
    joint_price: Array
    grasp_price: Array
    floating_acceleration: Array | None = None

    def prices(self, chain: ClosedChain) -> dict[str, Array]:
        """Return the prices by name of a limit, as `Distribution.prices`, without those that are 0 up to rounding.

        Args:
            chain: the chain.
        """
        kinds = (chain.joint_names(), JOINT_LIMITS, self.joint_price), (chain.names, GRASP_LIMITS, self.grasp_price)
        found = {
            f"{name} {what}": x[..., row, k]
            for names, limits, x in kinds
            for row, name in enumerate(names)
            for k, what in enumerate(limits)
        }
        least = LEAST_PRICE * max(1.0, *(float(np.max(x)) for x in found.values()))
        return {name: x for name, x in found.items() if np.max(x) > least}


class Programme(NamedTuple):
    """The programme of one case.

    Attributes:
        arms: the motions of the arms, in order.
        held: their grasps; None for an arm that holds nothing.
        columns: their columns.
        blocks: their blocks, in units of F0, and then that of what they share, if they share anything.
        e: (rows,) right-hand side of the coupling rows: the wrench that the object needs, and what is shared.
        common: weights and units.
        of: the limits and wishes of the arms.
        shared: the accelerations that arms share.
        asked: what is asked of trunk and object.
    """

    arms: list[ArmMotion]
    held: list[Contact | None]
    columns: list[BlockColumn]
    blocks: list[Block]
    e: Array
    common: Weights
    of: list[OfArm]
    shared: Shared
    asked: Demand


def programme(motion: ChainMotion, own: Numbers) -> Programme:
    """Return the elastic programme of a chain's motion. O(n) + O(l), N^3 for an arm of N joints, and for a trunk of N.

    Args:
        motion: the chain's motion, without torques; external wrenches in it count as known.
        own: the wanted acceleration of the object, and the parameters of `distribute` by name.
    """
    chain = motion.chain
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
    arms, of = list(motion.arms.values()), [of_arm(chain, own, k, name) for k, name in enumerate(chain.names)]
    free = TASK in own or TASK_WEIGHT in own
    shared, asked = shared_accelerations(motion, free), _asked(chain, own, common, alpha)
    per_force, needed = to_force * reciprocal(force), needed * reciprocal(force)

    def joined_columns(shared: Shared) -> tuple[list[BlockColumn], JoinedRows]:
        by_shared = shared.object[:, :-1]
        moving = alpha + shared.object[:, -1] if free else alpha
        columns = each(
            lambda arm, c, under: block_column(arm, c, under, moving, by_shared, length, force, free),
            arms,
            held,
            shared.under,
        )
        return columns, joined_rows(motion, shared, columns, asked, per_force, needed)

    columns, joined = joined_columns(shared)
    of_shared: list[Block] = []
    if shared.size:
        weights, wishes = [one.weight for one in of], [one.wished for one in of]
        shared = scaled(shared, columns, weights, wishes, asked, joined)
        columns, joined = joined_columns(shared)
        of_shared = [border_block(shared, asked, joined)]
    blocks = each(lambda *of_arm: arm_block(common, *of_arm), arms, held, columns, of, joined.of_arms)
    return Programme(arms, held, columns, [*blocks, *of_shared], joined.e, common, of, shared, asked)


def _asked(chain: ClosedChain, own: Numbers, common: Weights, alpha: Array) -> Demand:
    """Return what is asked of trunk and object; alpha (6,) is the object's acceleration minus [0; g]."""
    part, joints = chain.joints.get(TRUNK, slice(0, 0)), chain.joints_of.get(TRUNK, ())
    per_unit, ranges = per_torque(common, joints), np.zeros((2, 0))
    units, per_force = reciprocal(per_unit), reciprocal(common.force)
    effort = clip(per_unit * (common.effort_share * clip(own[LIMITS][3][part], -NO_LIMIT, NO_LIMIT)), 0.0, FARTHEST)
    if ACCELERATION_LIMITS in own:
        ranges = clip(per_force * clip(own[ACCELERATION_LIMITS][:, part], -NO_LIMIT, NO_LIMIT), -FARTHEST, FARTHEST)
    weight = own["effort_weight"][part] * (units * units)
    task = own.get(TASK, np.eye(6)) if TASK in own or TASK_WEIGHT in own else np.zeros((0, 6))
    task_weight = own[TASK_WEIGHT][()] if TASK_WEIGHT in own else None
    wished, slow = own["wished_qdd"][part], common.slow
    return Demand(units, effort, weight, wished, ranges, per_force, slow, task, task_weight, dearer(own, alpha))


def dearer(own: Numbers, alpha: Array) -> Scalar:
    """Return 1 + (W |S alpha|)^2, of an object's acceleration minus [0; g] that gives way; 1 if none does."""
    if TASK_WEIGHT not in own:
        return 1.0
    weight, falling = own[TASK_WEIGHT][()], own.get(TASK, np.eye(6)) @ alpha
    return 1.0 + weight * weight * (falling @ falling)


def raised_price(own: Numbers, dearer: Scalar) -> Scalar:
    """Return the price of passing limits; see the module's docstring."""
    price = own["price"][()]
    return price * (1.0 + TASK_IN_PRICE * (dearer - 1.0)) if TASK_WEIGHT in own else price


def distributed(case: VariedCase, iterations: int = ITERATIONS) -> tuple[Array, ...]:
    """Return the results in the order of `ElasticDistribution`."""
    none = np.zeros(case.chain.joint_count)
    found = distribution(chain_motion(case.chain, case.state, none, case.inputs), case.own, iterations)
    return tuple(part for part in found if part is not None)


def distribution(motion: ChainMotion, own: Numbers, iterations: int = ITERATIONS) -> ElasticDistribution:
    """Return the torques, accelerations and wrenches; see `programme`."""
    made = programme(motion, own)
    price, barrier = raised_price(own, made.asked.dearer), own["barrier"][()]
    found = central_point(made.blocks, made.e, price, iterations, barrier)
    arms, shared = len(made.arms), made.shared
    answers = each(arm_answer, made.arms, made.held, made.columns, found.x[:arms])
    tau, qdd, y = [tau for tau, *_ in answers], [qdd for _, qdd, _ in answers], np.zeros(0)
    floating = None
    acceleration, missed = own["acceleration"], []
    if shared.size:
        drives, y = found.x[arms][: shared.joints], found.x[arms][shared.joints :]
        moving, beyond = (A[:, :-1] @ y + A[:, -1] for A in (shared.own, shared.object))
        tau, qdd = [made.asked.units * drives, *tau], [moving[shared.floating :], *qdd]
        acceleration, missed = acceleration + beyond, [made.asked.task @ beyond]
        floating = moving[: shared.floating] if shared.floating else None
    if not len(made.asked.task):
        missed = [_not_given(motion, made, found.x)]
    missed += [column.missed + column.missed_by @ y if len(y) else column.missed for column in made.columns]
    return ElasticDistribution(
        concatenate(tau),
        concatenate(qdd),
        array([f for *_, f in answers]),
        acceleration,
        array(made.common.force * found.v),
        array(largest(concatenate(missed))),
        array(found.residual),
        *_prices(made, found),
        floating,
    )


def _not_given(motion: ChainMotion, made: Programme, x: list[Array]) -> Array:
    """Return the acceleration of the object, (6,), of the part of the needed wrench that the grasps do not give."""
    given = sum((block.E[:6] @ own for block, own in zip(made.blocks, x, strict=True)), np.zeros(6))
    newtons, length = made.common.force * (made.e[:6] - given), made.common.length
    inertia = motion.body.inertia.dense()
    return ldl_solve(ldl(inertia, abs(np.diag(inertia))), concatenate([length * newtons[:3], newtons[3:]]))


def _prices(made: Programme, found: Distributed) -> tuple[Array, Array]:
    """Return the prices of joints, (n, 2), and of grasps, (arms, 7)."""
    common, asked, arms = made.common, made.asked, len(made.arms)
    per_force = reciprocal(common.force)

    def of_arm(arm: ArmMotion, held: Contact | None, of: OfArm, block: Block, z: Array) -> tuple[Array, Array]:
        per_unit, limited = per_torque(common, arm.arm.joints), of.acceleration.shape[1] > 0
        return joint_prices(block, z, per_unit, per_force, limited), grasp_prices(block, z, held, of, per_force)

    prices = each(of_arm, made.arms, made.held, made.of, made.blocks[:arms], found.multipliers[:arms])
    of_joints = [x for x, _ in prices]
    if made.shared.size:
        per_unit, limited = reciprocal(asked.units), asked.ranges.shape[1] > 0
        of_joints.insert(0, joint_prices(made.blocks[-1], found.multipliers[-1], per_unit, per_force, limited))
    return np.concatenate(of_joints), array([x for _, x in prices])


def distribution_parameters(
    chain: ClosedChain,
    state: State,
    limits: ForceLimits | None = None,
    cost: ForceCost | None = None,
    task: ArrayLike | None = None,
) -> dict[str, Array]:
    """Return the run-time parameters with which compiled `distribute` has these limits and this cost.

    Some are among them only if they are needed, and the chain is then compiled with them:
    `parameters=["acceleration_limits", "task", "task_weight"]` if accelerations are limited, if only some rows of the
    object's acceleration are asked, and if that gives way. Limits of a sampled controller are of the given state. O(n).

    Args:
        chain: the chain.
        state: positions and rates, for the limits of a sampled controller.
        limits: the limits.
        cost: the cost.
        task: (r, 6) rows on the object's acceleration; what they leave out is free. None asks for all six.

    Raises:
        MethodNotApplicable: a change from the last wrenches is limited, or a task has more than six rows.
        ModelError, StateError: a name is unknown, or a shape is wrong.
    """
    serial_chain(chain, "distribution_parameters: chain")
    limits, cost = limits or ForceLimits(), cost or ForceCost()
    if limits.last_wrench is not None:
        raise MethodNotApplicable(
            "distribute: machine code has no limit on the change of wrenches; try least_normal and most_normal, or"
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
    if (weight := cost.task_weight()) is not None:
        found[TASK_WEIGHT] = np.array(weight)
    if task is not None:
        rows = asked_rows(task)
        if len(rows) > 6:
            raise MethodNotApplicable(f"distribute: task: machine code takes up to six rows, got {len(rows)}")
        found[TASK] = np.concatenate([rows, np.zeros((6 - len(rows), 6))])
    found |= {"effort_weight": cost.effort_weights(chain), "price": np.array(cost.price)}
    found["barrier"] = np.array(cost.barrier)
    found |= {"wrench_weight": np.array(cost.wrench), "acceleration_weight": np.array(cost.acceleration)}
    for name, x in (("wish", cost.wish), ("wished_qdd", cost.joint_acceleration)):
        if x is not None:
            found[name] = checks.numbers(x, ARRAYS[name].shape(chain), f"cost: {name}", StateError)
    return found


DISTRIBUTE = declare(
    Question(
        "distribute",
        distributed,
        (
            Row("tau", ("n",), TORQUE, "torques of the drives"),
            Row("qdd", ("n",), RATE_2, "joint accelerations"),
            Row("grasp_wrench", ("arms", 6), "N m, N", "wrench [moment; force] of each arm on the object about the"
                " contact point, world axes"),
            "object_acceleration",
            Row("violation", (), "N", "by how much limits give way; all but 0 where they can be kept"),
            Row("missed", (), "m/s^2", "largest acceleration of a contact that its arm cannot follow, or of the object"
                " that gives way or that no wrenches of the grasps can give"),
            Row("residual", (), "", "of the optimality conditions, relative"),
            Row("joint_price", ("n", 2), "", "decrease of the cost per unit by which the limit of a joint's"
                " effort [N m, N] or acceleration [rad/s^2, m/s^2] is raised", labels=JOINT_LIMITS),
            Row("grasp_price", ("arms", 7), "1/N", "the same for friction, pressing, edge, force and moment rating,"
                " least and most normal force of each grasp", labels=GRASP_LIMITS),
            FLOATING_RESULT,
        ),
        "the torques and grasp wrenches for an acceleration of the object under limits, with the least effort",
        inputs=(*STATE, "acceleration"),
        parameters=(
            *("gravity", *OBJECT, "object_wrench", "base_R", "base_p", "base_twist", "base_acceleration"),
            *("grasp_R", "grasp_p", LIMITS, CONTACTS, *DISTRIBUTED),
        ),
        optional=(ACCELERATION_LIMITS, TASK, TASK_WEIGHT),
        iterative=True,
        arguments=(
            *(*STATE, "acceleration", *(name for name in ARGUMENTS if name not in (*STATE, "tau")), *DISTRIBUTED),
            *(*TRUNK_LINKS, "trunk_link_wrench", *FLOATING, *TRUNK_BASE_MOTION),
        ),
        by=(*STATE, "acceleration"),
        of=("tau", "qdd", "grasp_wrench", "object_acceleration", "violation"),
        depends_on=("grasps", "links", "forces", "bushings", "limits", "world"),
        differentiable=require_barrier,
        returns="ElasticDistribution",
        shown=lambda chain: lambda found: ElasticDistribution(**found),
    ),
)  # fmt: skip
