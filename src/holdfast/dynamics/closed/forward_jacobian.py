"""The Jacobian of forward dynamics, computed column by column with shared parts computed once.

An argument of one arm affects the others only through its tip, by six numbers at its grasp and six at the object. The
responses to these twelve numbers are computed once for all columns. A column therefore costs the part of its own arm,
and about twelve products per entry elsewhere. The columns are the items of a loop, each with its direction given as
numbers, so that they run in parallel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion, driven
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.forward_derivatives import arm_rates, forward, forward_along, numbers_of
from holdfast.dynamics.closed.second_solve import Point
from holdfast.dynamics.closed.self_response import JOINT_ARGUMENTS, SelfResponse, joint_responses, self_response
from holdfast.dynamics.closed.tip_response import RECURSION_PAYS_FROM, TipResponse
from holdfast.dynamics.closed.virtual_power import ArmCase, ArmUnknowns
from holdfast.dynamics.tree.of_chain import ChainLoads, solved_again
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import bodies_of
from holdfast.questions.arrays import ARRAYS, OF_JOINTS, OF_LINKS, OF_OBJECT, Shape, gradient_shapes
from holdfast.spatial.linear import Linear
from holdfast.spatial.scalar import Array, array, concatenate, each, each_of
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.spatial.symmetric import Symmetric6, symmetric_part

# The rates of the results as a function of those of the arguments with the given shapes.
Rates = Callable[[Point, Mapping[str, Shape]], Callable[[Mapping[str, Array]], dict[str, Array]]]

# The arguments that concern the whole chain.
OF_CHAIN = ("object_pose", "object_twist", *OF_OBJECT, "gravity")


class ByWrench(NamedTuple):
    """The response of an arm to unit wrenches f of the arm on the object.

    Attributes:
        slowing: (N, 6) M^-1 J^T, the negative joint accelerations.
        base: (6, 6) wrench of the base on the arm.
    """

    slowing: Array
    base: Array


class UnitResponses(NamedTuple):
    """The response of the chain at rest to six unit gaps at one grasp and six unit wrenches on the object.

    Attributes:
        wrenches: per grasp, (6, 12) wrenches of the arm on the object.
        object_acceleration: (6, 12) accelerations of the object.
    """

    wrenches: list[Array]
    object_acceleration: Array


def jacobian(
    at: Point,
    of: Sequence[str],
    by: Sequence[str],
    units: Array,
    together: Mapping[str, Rates] | None = None,
    rates: Rates = forward_along,
) -> dict[tuple[str, str], Array]:
    """Return the derivatives of results with respect to arguments, transposed: (size of argument, size of result).

    Args:
        at: the point.
        of: some of `RESULTS`.
        by: some of `ARGUMENTS`.
        units: (m, m) identity with m from `units_needed`; passed as numbers so that all columns run the same code.
        together: the rates of the results along an argument, if they are not those of `rates`.
        rates: the rates of the results along an argument of the whole chain.
    """
    chain, others = at.motion.chain, together or {}
    # Arms on a trunk move each other.
    whole = {name for name in by if name in OF_CHAIN or bodies_of(chain.trunk) or name in others}
    own = [name for name in by if name not in whole]
    rows = 6 * len(chain.grasps) + (6 if any(reaches_object(chain, name) for name in own) else 0)
    unit_responses = each(lambda e: unit_response(at, e), units[:rows, :rows]) if own else []
    responses = responses_by_joints(at, tuple([name for name in own if name in JOINT_ARGUMENTS]))
    arms = affected_arms(at, responses) if own else {}
    found: dict[tuple[str, str], list[list[Array]]] = {(result, name): [] for name in by for result in of}
    for name in by:
        if name in whole:
            columns = [chain_columns(at, name, of, units, others.get(name, rates))]
        else:
            columns = arm_columns(at, name, tuple(of), units, unit_responses, arms, responses)
        for of_one in columns:
            for k, result in enumerate(of):
                found[result, name].append([column[k] for column in of_one])
    return {key: array([column for of_one in parts for column in of_one]) for key, parts in found.items()}


def reaches_object(chain: ClosedChain, name: str) -> bool:
    """Return whether an arm's argument changes the object's equations, and not only the gap at the grasp."""
    return name == "grasp_pose" or any(len(grasp.transmitted) < 6 for grasp in chain.grasps.values())


def responses_by_joints(at: Point, names: tuple[str, ...]) -> dict[str, dict[str, list[SelfResponse]]]:
    """Return, by arm and argument, the responses of short arms themselves to changes of their joints."""
    chain, motion = at.motion.chain, at.motion
    short = [name for name, arm in chain.arms.items() if arm.joint_count < RECURSION_PAYS_FROM]
    arms = [name for name in short if names and motion.cases[name].in_motion]
    contacts = dict.fromkeys(chain.arms) | dict(zip(chain.grasps, motion.contacts, strict=True))
    own = motion.cases, at.unknowns, at.tips, motion.arms, contacts
    return each_of(arms, lambda *one: joint_responses(names, *one), *own)


def units_needed(chain: ClosedChain, by: Sequence[str]) -> int:
    """Return the size of the identity that `jacobian` needs for some arguments."""
    if bodies_of(chain.trunk) or chain.springs:
        shapes = gradient_shapes(chain)
        most = max(math.prod(shapes[name]) for name in by)
        return most if bodies_of(chain.trunk) else max(most, 6 * len(chain.grasps) + 6)
    counts = [arm.joint_count for arm in chain.arms.values()]
    sizes = [int(np.prod(arm_shape(name, N))) for name in by if name not in OF_CHAIN for N in counts]
    return max([6 * len(chain.grasps) + 6, 9, *sizes])


def arm_shape(name: str, N: int) -> Shape:
    """Return the shape of one arm's part of an argument."""
    axes = ARRAYS[name].axes
    return (N, *axes[1:]) if name in (*OF_JOINTS, *OF_LINKS) else (6,)  # type: ignore[index]


def direction(unit: Array, name: str, shape: Shape) -> Array:
    """Return the direction in which one number of an argument changes; for inertias it is symmetric."""
    x = unit.reshape(shape)
    return symmetric_part(x) if name.endswith("inertia") else x


def unit_response(at: Point, unit: Array) -> tuple[list[Array], Array]:
    """Return the response of the chain at rest to one unit gap, or one unit component of a wrench on the object.

    Args:
        at: the point.
        unit: (6l,) for a gap only, or (6l + 6,).
    """
    count = len(at.motion.contacts)
    assert at.found.factors is not None
    wrench = unit[6 * count :] if len(unit) > 6 * count else np.zeros(6)
    gaps = [unit[6 * i : 6 * i + 6] for i in range(count)]
    return solved_again(at.found.factors, ChainLoads(gaps, wrench))[:2]


def unit_wrenches(tip: TipResponse, arm: ArmMotion) -> ByWrench:
    """Return the response of an arm at rest to the six unit wrenches at its tip."""
    assert tip.for_load is not None
    still = tip.for_load(driven(arm, np.zeros(arm.arm.joint_count), np.zeros(6)))
    columns = [still.back_substitute(unit) for unit in np.eye(6)]
    return ByWrench(-array([qdd for qdd, _ in columns]).T, array([base for _, base in columns]).T)


def chain_columns(at: Point, name: str, of: Sequence[str], units: Array, rates: Rates) -> list[list[Array]]:
    """Return the columns of an argument that concerns the whole chain; `rates` of the results along tangents."""
    shape = gradient_shapes(at.motion.chain)[name]
    size, along = math.prod(shape), rates(at, {name: shape})

    def column(unit: Array) -> list[Array]:
        found = along({name: direction(unit, name, shape)})
        return [found[result].ravel() for result in of]

    return each(column, units[:size, :size])


def in_each_column(at: Point, _: Mapping[str, Shape]) -> Callable[[Mapping[str, Array]], dict[str, Array]]:
    """Return the rates of the results along an argument, for which every column linearises the equations by itself.

    For machine code: to linearise them once, as the reference does, takes fewer operations, but slopes of whole arms
    would be stored between the loops: measured on a trunk, twice the time of compilation and a third more for a call.
    """
    return lambda tangents: forward(at, tangents)


class AffectedArm(NamedTuple):
    """The data of one arm that the columns of all arms use.

    Attributes:
        joint_count: number of its joints.
        contact: its grasp; None without one, and so are the others.
        mobility: Lambda.
        by_wrench: its response to unit wrenches.
    """

    joint_count: int
    contact: Contact | None = None
    mobility: Symmetric6 | None = None
    by_wrench: ByWrench | None = None


def affected_arms(at: Point, responses: Mapping[str, Mapping[str, list[SelfResponse]]]) -> dict[str, AffectedArm]:
    """Return the data of all arms.

    M^-1 J^T is the transpose of the tips' accelerations by torques, where these have been computed.
    """
    chain, motion = at.motion.chain, at.motion
    tips = [at.tips[name] for name in chain.grasps]
    by_wrench = each(unit_wrenches, tips, motion.holding)
    arms = {name: AffectedArm(arm.joint_count) for name, arm in chain.arms.items()}
    for name, c, tip, found in zip(chain.grasps, motion.contacts, tips, by_wrench, strict=True):
        by_torque = responses.get(name, {}).get("tau")
        if by_torque:
            found = found._replace(slowing=array([one.closing for one in by_torque]))
        arms[name] = AffectedArm(arms[name].joint_count, c, tip.mobility, found)
    return arms


class Affected(NamedTuple):
    """An arm in the columns of one arm's argument.

    Attributes:
        arm: its data.
        wrenches: (6, 6) or (6, 12) its wrenches for unit gaps at the grasp of the argument's arm and, if needed, for
            unit wrenches on the object; None if one of the two has no grasp.
    """

    arm: AffectedArm
    wrenches: Array | None


def arm_columns(
    at: Point,
    name: str,
    of: tuple[str, ...],
    units: Array,
    unit_responses: Sequence[tuple[list[Array], Array]],
    affected: Mapping[str, AffectedArm],
    responses: Mapping[str, Mapping[str, list[SelfResponse]]],
) -> list[list[list[Array]]]:
    """Return the columns of an argument that belongs to single arms, arm by arm.

    Args:
        at: the point.
        name: name of the argument.
        of: names of the results.
        units: as in `jacobian`.
        unit_responses: responses of the chain at rest to all unit gaps and, if needed, to unit wrenches on the object.
        affected: the data of all arms.
        responses: self-responses that were computed for all joints of an arm at once, by arm and argument.
    """
    chain, motion, order = at.motion.chain, at.motion, list(at.motion.chain.arms)
    grasps = list(chain.grasps)
    arms = grasps if name == "grasp_pose" else order
    names = tuple(numbers_of([name]))
    open_ones = [arm for arm in arms if name not in responses.get(arm, ())]
    residuals = each_of(open_ones, lambda case, z: case.residual(z, names), motion.cases, at.unknowns)
    found = []
    for arm in arms:
        shape = arm_shape(name, chain.arms[arm].joint_count)
        size, alpha, c = int(np.prod(shape)), None, None
        wrenches: dict[str, Array] = {}
        if arm in chain.grasps:
            g = grasps.index(arm)
            shared = [*unit_responses[6 * g : 6 * g + 6], *unit_responses[6 * len(grasps) :]]
            wrenches = {one: array([f[i] for f, _ in shared]).T for i, one in enumerate(grasps)}
            alpha, c = array([alpha for _, alpha in shared]).T, motion.contacts[g]
        first = [arm, *(one for one in order if one != arm)]  # so that all columns run the same code
        parts = tuple([Affected(affected[one], wrenches.get(one)) for one in first])
        if arm in residuals:
            one = ArmColumn(motion.cases[arm], residuals[arm], at.tips[arm], motion.arms[arm], c)
            columns = each(column_of(one, parts, alpha, name, shape, of), units[:size, :size])
        else:
            columns = each(lambda mine, parts=parts, alpha=alpha: results(parts, alpha, mine, of), responses[arm][name])
        back = [first.index(one) for one in order]
        found.append([[_in_order(part, back) for part in column] for column in columns])
    return found


def _in_order(parts: list[Array], order: Sequence[int]) -> Array:
    """Return a result's parts by arm in the given order, or its only part, as one array."""
    return concatenate([parts[k] for k in order] if len(parts) > 1 else parts)


class ArmColumn(NamedTuple):
    """The data of an arm for a column that is computed separately.

    Attributes:
        case: arguments of the arm's equations.
        residual: linearisation of the arm's dL/dy in the argument.
        tip: the arm's tip response.
        motion: the arm's motion.
        contact: its contact, or None.
    """

    case: ArmCase
    residual: Linear
    tip: TipResponse
    motion: ArmMotion
    contact: Contact | None


def column_of(
    one: ArmColumn, parts: tuple[Affected, ...], alpha: Array | None, name: str, shape: Shape, of: tuple[str, ...]
) -> Callable[[Array], list[list[Array]]]:
    """Return the function that computes the column for a direction of an arm's argument."""

    def column(unit: Array) -> list[list[Array]]:
        given = arm_rates(one.case, {name: direction(unit, name, shape)})
        r = ArmUnknowns(*one.residual.rates(*given.values()))
        return results(parts, alpha, self_response(one.tip, one.motion, one.contact, r), of)

    return column


def results(
    parts: Sequence[Affected], alphas: Array | None, moved: SelfResponse, of: Sequence[str]
) -> list[list[Array]]:
    """Return the rates of the results when dL/dy of one arm changes, each by arm, that arm first.

    Every arm responds to the change at this arm's tip; the arm itself also responds directly, see `self_response`.

    Args:
        parts: all arms, the one that changes first.
        alphas: (6, 6) or (6, 12) accelerations of the object for the unit gaps and wrenches; None without a grasp.
        moved: the response of the arm itself.
        of: names of the results.
    """
    none = np.zeros(6)
    given = none if alphas is None else concatenate([moved.closing, moved.on_object])[: alphas.shape[1]]
    alpha = none if alphas is None else alphas @ given
    qdd, wrench, base, rates = [], [], [], []
    for k, (arm, wrenches) in enumerate(parts):
        f = none if wrenches is None else wrenches @ given
        own_qdd, own_wrench, own_base, closing = np.zeros(arm.joint_count), none, none, none
        if k == 0:
            own_qdd, own_base, closing = moved.qdd, moved.base, moved.closing
            own_wrench = moved.known + moved.bushing if len(moved.bushing) else moved.known
        c, by = arm.contact, arm.by_wrench
        if c is None or by is None or arm.mobility is None:
            qdd.append(own_qdd)
            wrench.append(none)
            base.append(own_base)
            rates.append(np.zeros(0))
            continue
        qdd.append(own_qdd - by.slowing @ f)
        wrench.append(f + own_wrench)
        base.append(by.base @ f + own_base)
        rates.append(rates_of(c, shift_twist(c.offset, alpha) + arm.mobility.apply(f) - closing))
    found = {
        "qdd": qdd,
        "grasp_wrench": wrench,
        "object_acceleration": [alpha],
        "contact_acceleration": rates,
        "base_wrench": base,
    }
    return [found[result] for result in of]


def rates_of(c: Contact, apart: Array) -> Array:
    """Return W_dot, (n_g,), for the relative acceleration of the two sides of a grasp."""
    return c.rates(apart) if c.grasp.free else np.zeros(0)
