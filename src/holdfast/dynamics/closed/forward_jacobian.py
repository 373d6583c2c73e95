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
from holdfast.dynamics.tree.of_chain import solved_again
from holdfast.model.closed_chain import ClosedChain
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
        qdd: (N, 6) joint accelerations.
        base: (6, 6) wrench of the base on the arm.
    """

    qdd: Array
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
    whole = {name for name in by if name in OF_CHAIN or chain.trunk is not None or name in others}
    own = [name for name in by if name not in whole]
    rows = 6 * len(chain.grasps) + (6 if any(reaches_object(chain, name) for name in own) else 0)
    unit_responses = each(lambda e: unit_response(at, e), units[:rows, : 6 * len(chain.grasps) + 6]) if own else []
    tips = [at.tips[name] for name in chain.grasps]
    by_wrench = each(unit_wrenches, tips, at.motion.holding) if own else []
    grasps = {name: k for k, name in enumerate(chain.grasps)}
    arms = tuple([(grasps.get(name), arm.joint_count) for name, arm in chain.arms.items()])
    everyone = Everyone(at.motion.contacts, [tip.mobility for tip in tips], by_wrench, arms)
    responses = responses_by_joints(at, tuple([name for name in own if name in JOINT_ARGUMENTS]))
    found: dict[tuple[str, str], list[list[Array]]] = {(result, name): [] for name in by for result in of}
    for name in by:
        if name in whole:
            columns = [chain_columns(at, name, of, units, others.get(name, rates))]
        else:
            columns = arm_columns(at, name, tuple(of), units, unit_responses, everyone, responses)
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
    if chain.trunk is not None or chain.springs:
        shapes = gradient_shapes(chain)
        most = max(math.prod(shapes[name]) for name in by)
        return most if chain.trunk is not None else max(most, 6 * len(chain.grasps) + 6, len(chain.arms))
    counts = [arm.joint_count for arm in chain.arms.values()]
    sizes = [int(np.prod(arm_shape(name, N))) for name in by if name not in OF_CHAIN for N in counts]
    return max([6 * len(chain.grasps) + 6, 9, len(counts), *sizes])


def arm_shape(name: str, N: int) -> Shape:
    """Return the shape of one arm's part of an argument."""
    axes = ARRAYS[name].axes
    return (N, *axes[1:]) if name in (*OF_JOINTS, *OF_LINKS) else (6,)  # type: ignore[index]


def direction(unit: Array, name: str, shape: Shape) -> Array:
    """Return the direction in which one number of an argument changes; for inertias it is symmetric."""
    x = unit.reshape(shape)
    return symmetric_part(x) if name.endswith("inertia") else x


def unit_response(at: Point, unit: Array) -> tuple[list[Array], Array]:
    """Return the response of the chain at rest to one unit gap, or one unit component of a wrench on the object."""
    count = len(at.motion.contacts)
    assert at.found.factors is not None
    return solved_again(at.found.factors, [unit[6 * i : 6 * i + 6] for i in range(count)], unit[6 * count :])


def unit_wrenches(tip: TipResponse, arm: ArmMotion) -> ByWrench:
    """Return the response of an arm at rest to the six unit wrenches at its tip."""
    assert tip.for_load is not None
    still = tip.for_load(driven(arm, np.zeros(arm.arm.joint_count), np.zeros(6)))
    columns = [still.back_substitute(unit) for unit in np.eye(6)]
    return ByWrench(array([qdd for qdd, _ in columns]).T, array([base for _, base in columns]).T)


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


class Everyone(NamedTuple):
    """The data of the arms with a grasp that all columns use.

    Attributes:
        contacts: the grasps.
        mobilities: Lambda of their arms.
        by_wrench: responses of their arms to unit wrenches.
        rows: for each arm of the chain, in order, the index of its grasp (or None) and its number of joints.
    """

    contacts: list[Contact]
    mobilities: list[Symmetric6]
    by_wrench: list[ByWrench]
    rows: tuple[tuple[int | None, int], ...]


class Own(NamedTuple):
    """The data of one arm that its columns use.

    Attributes:
        unit_responses: response of the chain at rest to unit gaps at this arm's grasp and to unit wrenches on the
            object; None
            without a grasp.
        mask: per arm of the chain, 1 for this arm and 0 for the others; numbers, so that all columns run the same code.
    """

    unit_responses: UnitResponses | None
    mask: Array


def arm_columns(
    at: Point,
    name: str,
    of: tuple[str, ...],
    units: Array,
    unit_responses: Sequence[tuple[list[Array], Array]],
    everyone: Everyone,
    responses: Mapping[str, Mapping[str, list[SelfResponse]]],
) -> list[list[list[Array]]]:
    """Return the columns of an argument that belongs to single arms, arm by arm.

    Args:
        at: the point.
        name: name of the argument.
        of: names of the results.
        units: as in `jacobian`.
        unit_responses: responses of the chain at rest to all unit gaps and, if needed, to unit wrenches on the object.
        everyone: the data that all columns use.
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
        size, row, whole, c = int(np.prod(shape)), order.index(arm), None, None
        if arm in chain.grasps:
            g = grasps.index(arm)
            shared = [*unit_responses[6 * g : 6 * g + 6], *unit_responses[6 * len(grasps) :]]
            wrenches = [array([f[i] for f, _ in shared]).T for i in range(len(grasps))]
            whole, c = UnitResponses(wrenches, array([alpha for _, alpha in shared]).T), motion.contacts[g]
        own = Own(whole, units[row, : len(order)])
        if arm in residuals:
            one = ArmColumn(motion.cases[arm], residuals[arm], at.tips[arm], motion.arms[arm], c)
            found.append(each(column_of(one, own, everyone, name, shape, of), units[:size, :size]))
        else:
            found.append(each(lambda mine, own=own: results(own, everyone, mine, of), responses[arm][name]))
    return found


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
    one: ArmColumn, own: Own, everyone: Everyone, name: str, shape: Shape, of: tuple[str, ...]
) -> Callable[[Array], list[Array]]:
    """Return the function that computes the column for a direction of an arm's argument."""

    def column(unit: Array) -> list[Array]:
        given = arm_rates(one.case, {name: direction(unit, name, shape)})
        r = ArmUnknowns(*one.residual.rates(*given.values()))
        return results(own, everyone, self_response(one.tip, one.motion, one.contact, r), of)

    return column


def results(own: Own, everyone: Everyone, moved: SelfResponse, of: Sequence[str]) -> list[Array]:
    """Return the rates of the results when dL/dy of one arm changes.

    Every arm responds to the change at this arm's tip; the arm itself also responds directly, see `self_response`.

    Args:
        own: data of the arm.
        everyone: data of all arms.
        moved: the response of the arm itself.
        of: names of the results.
    """
    alpha = none = np.zeros(6)
    shares: list[Array] = [none] * len(everyone.contacts)
    if own.unit_responses is not None:
        given = concatenate([moved.closing, moved.on_object])[: own.unit_responses.object_acceleration.shape[1]]
        alpha = own.unit_responses.object_acceleration @ given
        shares = [f @ given for f in own.unit_responses.wrenches]
    wrench_besides = moved.known + moved.bushing if len(moved.bushing) else moved.known
    qdd, wrench, base = [], [], []
    rates: dict[int, Array] = {}
    for mine, (g, N) in zip(own.mask, everyone.rows, strict=True):
        own_qdd = mine * moved.qdd if len(moved.qdd) == N else np.zeros(N)
        if g is None:
            qdd.append(own_qdd)
            wrench.append(none)
            base.append(mine * moved.base)
            continue
        c, f, response = everyone.contacts[g], shares[g], everyone.by_wrench[g]
        qdd.append(response.qdd @ f + own_qdd)
        wrench.append(f + mine * wrench_besides)
        base.append(response.base @ f + mine * moved.base)
        gap = shift_twist(c.offset, alpha) + everyone.mobilities[g].apply(f) - mine * moved.closing
        rates[g] = rates_of(c, gap)
    found = {
        "qdd": qdd,
        "grasp_wrench": wrench,
        "object_acceleration": [alpha],
        "contact_acceleration": [rates[g] for g in sorted(rates)],
        "base_wrench": base,
    }
    return [concatenate(found[result]) for result in of]


def rates_of(c: Contact, apart: Array) -> Array:
    """Return W_dot, (n_g,), for the relative acceleration of the two sides of a grasp."""
    return c.rates(apart) if c.grasp.free else np.zeros(0)
