"""A second solve of the chain's linear equations, K z = r, with the factors from forward dynamics.

    M z_q + J^T z_f = r_q,    J z_q - A z_a + H^T z_W = r_f,    M_C z_a - sum A^T z_f = r_a,    H z_f = r_W

These are the equations of the chain at rest with joint torques r_q, a wrench r_a on the object, and prescribed relative
accelerations r_f at the grasps, which the filter solves with another r. The part r_W of the wrenches along the free
directions is known in advance. Bases may accelerate, and their wrenches are returned as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion, driven
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.chain_solution import base_wrench, contact_acceleration
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.tip_response import Route, TipResponse, responded, tip_response
from holdfast.dynamics.closed.virtual_power import ArmCase, ArmUnknowns
from holdfast.dynamics.tree.of_chain import ChainLoads, solved_again
from holdfast.dynamics.trunk.trunk_motion import TrunkMotion
from holdfast.dynamics.trunk.trunk_power import TrunkUnknowns
from holdfast.spatial.scalar import Array, each, each_of, scan
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench


class TrunkLoad(NamedTuple):
    """The trunk's part of r.

    Attributes:
        torque: (n_t,) torques of its joints.
        wrench: (6,) wrench on a floating base about its origin, world axes; 0 without one.
        base: (6,) acceleration of a base in the world; 0 for a floating base.
    """

    torque: Array
    wrench: Array
    base: Array


class Load(NamedTuple):
    """One arm's part of r.

    Attributes:
        torque: (N,) r_q.
        gap: (6,) r_f, about the contact point, world axes.
        free: (n_g,) r_W.
        base: (6,) acceleration of the base origin, in world axes.
    """

    torque: Array
    gap: Array
    free: Array
    base: Array


@dataclass(frozen=True, eq=False)
class Point:
    """Forward dynamics at one state, with the data that its derivatives need.

    Attributes:
        motion: the chain's motion.
        found: its solution by `sequential`.
        tips: tip responses of all arms, by name.
        unknowns: the solution by arm, in which the base's wrench is zero.
        cases: arguments of every arm's equations, by name; bases on a trunk accelerate with it.
        trunk: the trunk's part of the solution.
    """

    motion: ChainMotion
    found: Solution
    tips: Mapping[str, TipResponse]
    unknowns: Mapping[str, ArmUnknowns]
    cases: Mapping[str, ArmCase]
    trunk: TrunkUnknowns


def point(motion: ChainMotion, found: Solution, route: Route) -> Point:
    """Return the point at which derivatives are taken.

    Args:
        motion: the chain's motion.
        found: its solution by `sequential`.
        route: method for the arms without a grasp, see `tip_response`.
    """
    chain, alpha, none = motion.chain, found.object_acceleration, np.zeros(6)
    lone = [name for name in chain.arms if name not in chain.grasps]
    alone = each_of(lone, lambda arm: tip_response(arm, route), motion.arms)
    betas = motion.trunk.accelerations(found.trunk)
    trunk = TrunkUnknowns(found.trunk.qdd, none if found.trunk.base is None else found.trunk.base)
    moved = {name: motion.trunk.under(name, betas) for name in chain.arms}
    of_columns = {name: motion.trunk.of_columns(name, found.trunk, betas) for name in chain.arms}
    on = each_of(motion.trunk.mounts, lambda case, beta: case.moved(beta), motion.cases, moved)
    cases = {**motion.cases, **on}
    rates = each(
        lambda arm, c, qdd, beta: contact_acceleration(arm, c, qdd, alpha, beta),
        motion.holding,
        motion.contacts,
        found.qdd,
        [moved[name] for name in chain.grasps],
    )
    held = zip(chain.grasps, found.qdd, found.wrenches, rates, strict=True)
    unknowns = {
        name: ArmUnknowns(qdd, f, W, alpha, none, none if name in chain.bushings else none[:0])
        for name, qdd, f, W in held
    }
    free = each_of(lone, lambda tip, beta: responded(tip, none, beta)[0], alone, of_columns)
    unknowns |= {name: ArmUnknowns(qdd, none, none[:0], alpha, none) for name, qdd in free.items()}
    tips = dict(zip(chain.grasps, found.tips, strict=True)) | alone
    return Point(motion, found, tips, unknowns, cases, trunk)


class RightHandSide(NamedTuple):
    """The right-hand side of the elimination for given loads.

    Attributes:
        loads: of the forest.
        tips: by name, the arms' tip responses with their loads.
        known: per grasp, (6,) the wrench along the free directions.
    """

    loads: ChainLoads
    tips: dict[str, TipResponse]
    known: list[Array]


def right_hand_side(
    motion: ChainMotion, tips: Mapping[str, TipResponse], loads: Mapping[str, Load], wrench: Array, below: TrunkLoad
) -> RightHandSide:
    """Return the right-hand side of the elimination; see `second_solve`.

    Args:
        motion: the chain's motion.
        tips: by name, the tip responses of the arms with a grasp, and of others, which are loaded, too.
        loads: loads by arm.
        wrench: (6,) r_a.
        below: load of the trunk.
    """
    trunk, grasps = driven_trunk(motion.trunk, below), motion.chain.grasps
    bases = {name: loads[name].base + mount.acceleration for name, mount in trunk.mounts.items()}
    loads = {**loads, **{name: loads[name]._replace(base=base) for name, base in bases.items()}}
    held = [loads[name] for name in grasps]
    loaded = each(loaded_response, [tips[name] for name in grasps], motion.holding, held)
    known = each(lambda c, load: along_free(c, load.free), motion.contacts, held)
    gaps = each(lambda tip, f, load: tip.free_acceleration - tip.mobility.apply(f) - load.gap, loaded, known, held)
    if any(grasp.free for grasp in grasps.values()):
        wrench, _ = scan(lambda w, c, f: (w + shift_wrench(c.offset, f), None), wrench, motion.contacts, known)
    lone = each_of([name for name in tips if name not in grasps], loaded_response, tips, motion.arms, loads)
    found = dict(zip(grasps, loaded, strict=True)) | lone
    pushed = dict(zip(grasps, known, strict=True))
    on_trunk = {name: with_known(tip, pushed.get(name)) for name, tip in found.items() if name in trunk.mounts}
    return RightHandSide(ChainLoads(gaps, wrench, trunk, on_trunk), found, known)


class SecondSolution(NamedTuple):
    """The solution z.

    Attributes:
        arms: parts of z by arm; `base` is the wrench of the base, or of the trunk, on the arm.
        object_acceleration: (6,) acceleration of the object.
        trunk: accelerations of the trunk's joints and base.
        base_wrench: (6,) wrench of the base on the trunk; None without bodies.
    """

    arms: dict[str, ArmUnknowns]
    object_acceleration: Array
    trunk: TrunkUnknowns
    base_wrench: Array | None


def second_solve(
    at: Point, loads: Mapping[str, Load], wrench: Array, below: TrunkLoad, *, together: bool = False
) -> SecondSolution:
    """Return z. O(n) + O(l).

    Args:
        at: the point.
        loads: loads by arm; for arms without a grasp the gap is not used.
        wrench: (6,) r_a, about C, world axes.
        below: load of the trunk.
        together: whether the elimination already received these loads when it solved for the point.
    """
    chain, motion, none = at.motion.chain, at.motion, np.zeros(6)
    rhs = right_hand_side(motion, at.tips, loads, wrench, below)
    assert at.found.factors is not None
    found = at.found.second if together else solved_again(at.found.factors, rhs.loads)
    alpha, tips, trunk = found.object_acceleration, rhs.tips, rhs.loads.trunk
    betas = {name: found.columns.get(name) for name in chain.arms}
    holds = each(
        lambda c, tip, load, f, own, beta: arm_solution(c, tip, load, f + own, alpha, beta),
        motion.contacts,
        [tips[name] for name in chain.grasps],
        [loads[name] for name in chain.grasps],
        found.wrenches,
        rhs.known,
        [betas[name] for name in chain.grasps],
    )
    lone = [name for name in chain.arms if name not in chain.grasps]
    others = each_of(lone, lambda tip, beta: tip.back_substitute(none, beta), tips, betas)
    solved = {name: ArmUnknowns(qdd, none, none[:0], alpha, base) for name, (qdd, base) in others.items()}
    solved |= dict(zip(chain.grasps, holds, strict=True))
    of_base = base_wrench(trunk, found.betas, {name: solved[name].base for name in trunk.mounts})
    moved = below.base if found.trunk.base is None else found.trunk.base
    return SecondSolution(solved, alpha, TrunkUnknowns(found.trunk.qdd, moved), of_base)


def driven_trunk(trunk: TrunkMotion, load: TrunkLoad) -> TrunkMotion:
    """Return the trunk at rest with a load."""
    still, zeta, bodies, k = trunk.at_rest(), load.base, [], 0
    for body in still.bodies:
        if body.joint is None:
            bodies.append(body._replace(wrench=-load.wrench))
            continue
        zeta = shift_twist(body.reach, zeta)
        bodies.append(body._replace(zeta=zeta, wrench=body.inertia.apply(zeta), torque=load.torque[k]))
        k += 1
    mounts = {
        name: mount._replace(acceleration=shift_twist(mount.offset, bodies[mount.body].zeta))
        for name, mount in still.mounts.items()
    }
    return still._replace(bodies=bodies, mounts=mounts)


def with_known(tip: TipResponse, known: Array | None) -> TipResponse:
    """Return the tip response for the elimination, with the load X^T f of a known wrench f at the base."""
    if tip.base is None or known is None:
        return tip
    return replace(tip, base=tip.base._replace(wrench=tip.base.wrench + known @ tip.base.X))


def loaded_response(tip: TipResponse, arm: ArmMotion, load: Load) -> TipResponse:
    """Return the arm's tip response at rest with a load."""
    assert tip.for_load is not None
    return tip.for_load(driven(arm, load.torque, load.base))


def along_free(c: Contact, free: Array) -> Array:
    """Return the wrench f (6,) along the free directions with H f = r_W."""
    return c.without_rates(free) if c.grasp.free else np.zeros(6)


def arm_solution(
    c: Contact, tip: TipResponse, load: Load, f: Array, alpha: Array, beta: Array | None = None
) -> ArmUnknowns:
    """Return one arm's part of z from its wrench f and the accelerations of the object and of the trunk's columns."""
    qdd, base = tip.back_substitute(f, beta)
    apart = load.gap + shift_twist(c.offset, alpha) - tip.free_acceleration + tip.mobility.apply(f)
    if tip.base is not None and beta is not None:
        apart = apart - tip.base.X @ beta
    return ArmUnknowns(qdd, f, c.rates(apart) if c.grasp.free else np.zeros(0), alpha, base)
