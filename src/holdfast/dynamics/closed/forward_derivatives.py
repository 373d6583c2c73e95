"""Derivatives of forward dynamics, by one more solve with the existing factors and derivatives of the virtual power L.

    cotangents z_bar:  K y = z_bar,  theta_bar = -dL/dtheta            (backward)
    tangents:          K z_dot = -d(dL/dy)/dtheta theta_dot            (forward)

The filter itself is not differentiated: it avoids the differences whose derivatives would be needed
(docs/theory/derivatives.md). Derivatives by poses refer to R -> exp(turn) R and p -> p + shift; those of the object and
the bases are along world axes, those of grasps along the object's axes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.second_solve import Load, Point, TrunkLoad, right_hand_side, second_solve
from holdfast.dynamics.closed.sequential import Second
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.closed.virtual_power import ArmCase, ArmUnknowns
from holdfast.dynamics.tree.of_chain import ChainLoads
from holdfast.dynamics.trunk.trunk_derivatives import (
    TRUNK_TO_ARM_NAMES,
    TrunkRates,
    gradient_through_trunk,
    trunk_load,
    trunk_rates,
    trunk_residual_rates_along,
)
from holdfast.dynamics.trunk.trunk_power import MOTION, TrunkUnknowns
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import BASE_RESULT, BODY_POSES, FLOATING_RESULT, OF_JOINTS, OF_LINKS, OF_OBJECT
from holdfast.spatial.linear import Linear
from holdfast.spatial.pose import by_motion, rates_of
from holdfast.spatial.scalar import Array, array, concatenate, each_of, scan
from holdfast.spatial.symmetric import symmetric_part


class VirtualPower(NamedTuple):
    """An additional term of the function whose gradients are taken: sign times the arms' and the trunk's part of L.

    Attributes:
        sign: 1.0 or -1.0.
        z: solution by arm.
        y: multipliers by arm.
        trunk: y of the trunk.
    """

    sign: float
    z: Mapping[str, ArmUnknowns]
    y: Mapping[str, ArmUnknowns]
    trunk: TrunkUnknowns


def backward(
    at: Point,
    cotangents: Mapping[str, Array],
    by: Sequence[str],
    also: Sequence[VirtualPower] = (),
    *,
    together: bool = False,
) -> dict[str, Array]:
    """Return the gradients of sum(cotangent . result) with respect to some arguments. O(n) + O(l).

    Args:
        at: the point.
        cotangents: by result, in the shape of the result in the chain's layout; missing ones are zero.
        by: some of `ARGUMENTS`.
        also: virtual powers whose gradients are added.
        together: whether the filter received the cotangents when it solved for the point; see `known_beforehand`.

    Returns:
        The gradients by argument, in the shape of the argument; those of poses are (.., 6) [turn; shift], and those of
        inertias are symmetric.
    """
    chain = at.motion.chain
    alpha_bar = cotangents.get("object_acceleration", np.zeros(6))
    loads = {name: cotangents_of(chain, name, cotangents) for name in chain.arms}
    case = at.motion.trunk_case
    assert case is not None
    solved = second_solve(at, loads, alpha_bar, trunk_load(at.motion, cotangents), together=together)
    bases, carried = {name: load.base for name, load in loads.items()}, case.carried(at.trunk, solved.trunk)
    bases |= {name: bases[name] + base.virtual for name, base in carried.items()}
    y = {name: one._replace(base=bases[name]) for name, one in solved.arms.items()}
    y = {name: one._replace(known=-loads[name].gap) if name in chain.bushings else one for name, one in y.items()}
    of_arms, below = gradient_of_arms(at, at.unknowns, y, solved.trunk, by)
    for sign, z, multipliers, below_them in also:
        more, under = gradient_of_arms(at, z, multipliers, below_them, by)
        of_arms = {arm: {name: x - sign * more[arm][name] for name, x in g.items()} for arm, g in of_arms.items()}
        below = {name: x - sign * under[name] for name, x in below.items()}
    found: dict[str, Array] = {name: below[name] for name in (*TRUNK_TO_ARM_NAMES, "floating_pose") if name in below}
    if "trunk_link_inertia" in found:
        found["trunk_link_inertia"] = symmetric_part(found["trunk_link_inertia"])
    for name in (*OF_JOINTS, *OF_LINKS):
        if name in by:
            first = [below[name]] if name in below else []
            found[name] = np.concatenate([*first, *(g[name] for g in of_arms.values())])
    for name in ("base_twist", "base_acceleration", "base_pose"):
        if name in by:
            found[name] = array([g[name] for g in of_arms.values()])
    if "gravity" in by:  # it acts as an acceleration of the bases, and the object's acceleration includes it
        less = [g["base_acceleration"][3:] for g in of_arms.values()]
        found["gravity"], _ = scan(lambda total, g: (total - g, None), alpha_bar[3:], less)
        found |= {"gravity": found["gravity"] + below["gravity"]} if "gravity" in below else {}
    held = [of_arms[name] for name in chain.grasps]
    if "grasp_pose" in by:
        found["grasp_pose"] = array([g["grasp_pose"] for g in held])
    return found | object_gradient(at, solved.object_acceleration, held, by)


def gradient_of_arms(
    at: Point,
    z: Mapping[str, ArmUnknowns],
    y: Mapping[str, ArmUnknowns],
    of_trunk: TrunkUnknowns,
    by: Sequence[str],
) -> tuple[dict[str, dict[str, Array]], dict[str, Array]]:
    """Return -dL/dtheta of every arm, and of the trunk including the effect on its arms' bases.

    Args:
        at: the point.
        z: solution by arm.
        y: multipliers by arm.
        of_trunk: y of the trunk.
        by: names of the arguments.
    """
    chain, names = at.motion.chain, numbers_of(by)
    mounted = list(dict.fromkeys((*names, *MOTION)))
    wanted = {name: mounted if name in chain.mounted_on else names for name in chain.arms}
    of_arms = each_of(chain.arms, arm_gradient, at.cases, z, y, wanted)
    return of_arms, gradient_through_trunk(at, z, y, of_trunk, of_arms, by)


def arm_gradient(case: ArmCase, z: ArmUnknowns, y: ArmUnknowns, names: Sequence[str]) -> dict[str, Array]:
    """Return -dL/dtheta of one arm with respect to its numbers and its poses."""
    of_grasp = () if case.grasp is not None else ("grasp", "object")
    wanted = [name for name in names if name not in OF_OBJECT and not name.startswith(of_grasp)]
    found = case.gradient(z, y, wanted)
    numbers = case.numbers(wanted)
    if "link_inertia" in found:
        found["link_inertia"] = symmetric_part(found["link_inertia"])
    for what in ("base", "grasp"):
        if f"{what}_R" in found:
            found[f"{what}_pose"] = by_motion(found[f"{what}_R"], numbers[f"{what}_R"], found[f"{what}_p"])
    return found


def object_gradient(at: Point, y: Array, of_arms: Sequence[Mapping[str, Array]], by: Sequence[str]) -> dict[str, Array]:
    """Return the gradients by the object's arguments, including the sum over the arms that hold it."""
    case = at.motion.object_case
    assert case is not None
    wanted = [name for name in by if name.startswith("object")]
    if not wanted:
        return {}
    found = case.gradient(at.found.object_acceleration, y, [n for n in numbers_of(wanted) if n != "object_p"])
    shared = [name for name in ("object_R", "object_twist") if name in found]
    total, _ = scan(
        lambda total, g: (tuple(x + g[name] for x, name in zip(total, shared, strict=True)), None),
        tuple(found[name] for name in shared),
        of_arms,
    )
    found |= dict(zip(shared, total, strict=True))
    if "object_pose" in wanted:
        shift, _ = scan(lambda total, g: (total + g["object_p"], None), np.zeros(3), of_arms)
        found["object_pose"] = by_motion(found["object_R"], case.frame.R, shift)
    if "object_inertia" in wanted:
        found["object_inertia"] = symmetric_part(found["object_inertia"])
    return {name: found[name] for name in wanted}


def forward(at: Point, tangents: Mapping[str, Array]) -> dict[str, Array]:
    """Return the rates of the results for given rates of some arguments. O(n) + O(l).

    Args:
        at: the point.
        tangents: rates by argument, some of `ARGUMENTS`, in the shapes of the gradients from `backward`.

    Returns:
        The rates by result, `RESULTS`, in the chain's layout.
    """
    return forward_along(at, {name: np.shape(x) for name, x in tangents.items()})(tangents)


def forward_along(
    at: Point, shapes: Mapping[str, tuple[int, ...]]
) -> Callable[[Mapping[str, Array]], dict[str, Array]]:
    """Return `forward` as a function of rates of the given arguments; the equations are linearised once.

    Args:
        at: the point.
        shapes: the shapes of the rates by argument.
    """
    case = at.motion.object_case
    assert case is not None
    still = {name: np.zeros(shape) for name, shape in shapes.items()}
    own = list(own_rates_of_object(at, still))
    of_object = case.residual(at.found.object_acceleration, own) if own else None
    of_arms = arm_residual_rates_along(at, at.unknowns, still)
    of_trunk = trunk_residual_rates_along(at, still)
    return lambda tangents: solved_for_rates(at, tangents, of_object, of_arms, of_trunk)


def own_rates_of_object(at: Point, tangents: Mapping[str, Array]) -> dict[str, Array]:
    """Return the rates of the numbers in the object's equations."""
    own = object_rates(at, tangents) | {name: x for name, x in tangents.items() if name in OF_OBJECT}
    own.pop("object_p", None)  # its equations do not depend on it
    return own


def solved_for_rates(
    at: Point,
    tangents: Mapping[str, Array],
    of_object: Linear | None,
    of_arms: Callable[[Mapping[str, Array]], dict[str, ArmUnknowns]],
    of_trunk: TrunkRates,
) -> dict[str, Array]:
    """Return the rates of the results, of the linearised equations of object, arms and trunk; see `forward`."""
    chain, none = at.motion.chain, np.zeros(6)
    residual = none
    if of_object is not None:
        (residual,) = of_object.rates(*own_rates_of_object(at, tangents).values())
    changed = of_arms(tangents)
    wrench, _ = scan(lambda total, r: (total - r.object_acceleration, None), -residual, changed.values())
    loads = {name: Load(-r.qdd, -r.wrench, -r.contact_acceleration, none) for name, r in changed.items()}
    r_t, floats = of_trunk(tangents, changed), chain.floats
    solved = second_solve(at, loads, wrench, TrunkLoad(-r_t.qdd, -r_t.base if floats else none, none))
    found, under = solved.arms, solved.base_wrench
    below = {} if under is None else {BASE_RESULT: none if floats else under + r_t.base}
    below |= {FLOATING_RESULT: solved.trunk.base} if floats else {}
    gravity = concatenate([np.zeros(3), tangents["gravity"]]) if "gravity" in tangents else none
    wrenches = {name: found[name].wrench for name in chain.arms}
    wrenches |= {name: wrenches[name] + changed[name].known for name in chain.bushings}
    bases = [found[name].base + r.base for name, r in changed.items()]
    return below | {
        "qdd": concatenate([solved.trunk.qdd, *(found[name].qdd for name in chain.arms)]),
        "grasp_wrench": array([*wrenches.values()]),
        "object_acceleration": solved.object_acceleration + gravity,
        "contact_acceleration": concatenate([found[name].contact_acceleration for name in chain.grasps]),
        "base_wrench": array(bases),
    }


def arm_residual_rates(
    at: Point, z: Mapping[str, ArmUnknowns], tangents: Mapping[str, Array]
) -> dict[str, ArmUnknowns]:
    """Return the rates of dL/dy of all arms for given rates of the arguments and constant z."""
    return arm_residual_rates_along(at, z, {name: np.zeros(np.shape(x)) for name, x in tangents.items()})(tangents)


def arm_residual_rates_along(
    at: Point, z: Mapping[str, ArmUnknowns], still: Mapping[str, Array]
) -> Callable[[Mapping[str, Array]], dict[str, ArmUnknowns]]:
    """Return `arm_residual_rates` as a function of rates of the arguments that have some in `still`, which are zero."""
    chain, trunk = at.motion.chain, at.motion.trunk_case
    assert trunk is not None
    motion = trunk.base_motion(at.trunk, list(trunk_rates(at, still)))

    def given(tangents: Mapping[str, Array]) -> dict[str, dict[str, Array]]:
        of_object, carried = object_rates(at, tangents), trunk.base_rates(motion, trunk_rates(at, tangents))
        own = {name: tangents_of(at, name, tangents, carried.get(name)) for name in chain.arms}
        own |= {name: own[name] | of_object for name in chain.grasps}
        return each_of(chain.arms, arm_rates, at.cases, own)

    names = {name: tuple(rates) for name, rates in given(still).items()}
    linear = each_of(chain.arms, lambda case, z, names: case.residual(z, names), at.cases, z, names)

    def rates(one: Linear, given: Mapping[str, Array]) -> ArmUnknowns:
        return ArmUnknowns(*one.rates(*given.values()))

    return lambda tangents: each_of(chain.arms, rates, linear, given(tangents))


def object_rates(at: Point, tangents: Mapping[str, Array]) -> dict[str, Array]:
    """Return the rates of the object's numbers that also appear in the equations of its arms."""
    case = at.motion.object_case
    assert case is not None
    twist = {"object_twist": tangents["object_twist"]} if "object_twist" in tangents else {}
    return rates_of(tangents, "object", case.frame.R) | twist


def known_beforehand(motion: ChainMotion, cotangents: Mapping[str, Array]) -> Second:
    """Return the second right-hand side for the filter, so that gradients need no further pass through the arms."""
    loads = {name: cotangents_of(motion.chain, name, cotangents) for name in motion.chain.arms}
    alpha_bar = cotangents.get("object_acceleration", np.zeros(6))

    def second(tips: Mapping[str, TipResponse]) -> ChainLoads:
        return right_hand_side(motion, tips, loads, alpha_bar, trunk_load(motion, cotangents)).loads

    return second


def cotangents_of(chain: ClosedChain, name: str, cotangents: Mapping[str, Array]) -> Load:
    """Return an arm's part of the cotangents. That of the base wrench is minus a virtual twist of the base."""
    row, part = chain.names.index(name), chain.joints[name]
    torque = cotangents["qdd"][part] if "qdd" in cotangents else np.zeros(chain.arms[name].joint_count)
    gap, base = (cotangents[w][row] if w in cotangents else np.zeros(6) for w in ("grasp_wrench", "base_wrench"))
    rates = cotangents.get("contact_acceleration", np.zeros(chain.contact_freedom_count))
    return Load(torque, gap, rates[chain.contact_freedoms.get(name, slice(0, 0))], -base)


def tangents_of(
    at: Point, name: str, tangents: Mapping[str, Array], carried: Mapping[str, Array] | None = None
) -> dict[str, Array]:
    """Return an arm's part of the tangents, by argument; `carried` has the rates of its base's motion on a trunk."""
    chain = at.motion.chain
    row, part = chain.names.index(name), chain.joints[name]
    first = chain.joint_count - sum(arm.joint_count for arm in chain.arms.values())  # first row of links
    found = {n: tangents[n][part] for n in OF_JOINTS if n in tangents}
    found |= {n: tangents[n][part.start - first : part.stop - first] for n in OF_LINKS if n in tangents}
    if "grasp_pose" in tangents and name in chain.grasps:
        found["grasp_pose"] = tangents["grasp_pose"][list(chain.grasps).index(name)]
    if carried is not None:
        return found | dict(carried)
    found |= {n: tangents[n][row] for n in ("base_twist", "base_acceleration", "base_pose") if n in tangents}
    if "gravity" in tangents:
        pseudo = concatenate([np.zeros(3), tangents["gravity"]])
        found["base_acceleration"] = found.get("base_acceleration", np.zeros(6)) - pseudo
    return found


def arm_rates(case: ArmCase, given: Mapping[str, Array]) -> dict[str, Array]:
    """Return the rates of an arm's numbers for tangents of its arguments."""
    found = {name: x for name, x in given.items() if name not in BODY_POSES}
    frames: dict[str, Any] = {"base": case.given.arm.base}
    if case.grasp is not None:
        frames["grasp"] = case.grasp.frame
    for what, frame in frames.items():
        found |= rates_of(given, what, frame.R)
    return found


def numbers_of(arguments: Iterable[str]) -> list[str]:
    """Return the names of the numbers in the equations that make up some arguments, each once."""
    found: list[str] = []
    for name in arguments:
        if name in TRUNK_TO_ARM_NAMES or name == "floating_pose":
            continue  # only the trunk's equations depend on it
        of_pose = [f"{name.removesuffix('_pose')}_R", f"{name.removesuffix('_pose')}_p"]
        found += of_pose if name in BODY_POSES else ["base_acceleration" if name == "gravity" else name]
    return list(dict.fromkeys(found))
