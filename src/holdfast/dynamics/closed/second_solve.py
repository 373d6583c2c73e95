"""A second solve of the chain's linear equations, K z = r, with the factors from forward dynamics.

    M z_q + J^T z_f = r_q,    J z_q - A z_a + H^T z_W = r_f,    M_C z_a - sum A^T z_f = r_a,    H z_f = r_W

These are the equations of the chain at rest with joint torques r_q, a wrench r_a on the object, and prescribed relative
accelerations r_f at the grasps, which the filter solves with another r. The part r_W of the wrenches along the free
directions is known in advance. Bases may accelerate, and their wrenches are returned as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion, driven
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.chain_solution import contact_acceleration
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.tip_response import Route, TipResponse, responded, tip_response
from holdfast.dynamics.closed.virtual_power import ArmCase, ArmUnknowns
from holdfast.dynamics.tree.of_chain import solved_again
from holdfast.dynamics.trunk.trunk_power import TrunkUnknowns
from holdfast.spatial.scalar import Array, each, each_of, scan
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench


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
        trunk: the trunk's part of the solution; None without one.
    """

    motion: ChainMotion
    found: Solution
    tips: Mapping[str, TipResponse]
    unknowns: Mapping[str, ArmUnknowns]
    cases: Mapping[str, ArmCase]
    trunk: TrunkUnknowns | None = None


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
    trunk, cases, moved, of_columns = None, motion.cases, dict.fromkeys(chain.arms), dict.fromkeys(chain.arms)
    if motion.trunk is not None and found.trunk is not None:
        betas = motion.trunk.accelerations(found.trunk)
        trunk = TrunkUnknowns(found.trunk.qdd, none if found.trunk.base is None else found.trunk.base)
        moved = {name: motion.trunk.under(name, betas) for name in chain.arms}
        of_columns = {name: motion.trunk.of_columns(name, found.trunk, betas) for name in chain.arms}
        cases = each_of(cases, lambda case, beta: case.moved(beta), cases, moved)
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
    """The right-hand side of the object's filter for given loads.

    Attributes:
        tips: per grasp, the arm's tip response with its load.
        known: per grasp, (6,) the wrench along the free directions.
        gaps: per grasp, (6,) r about the contact point, world axes.
        wrench: (6,) wrench on the object about C, world axes.
    """

    tips: list[TipResponse]
    known: list[Array]
    gaps: list[Array]
    wrench: Array


def right_hand_side(
    motion: ChainMotion, tips: list[TipResponse], loads: Mapping[str, Load], wrench: Array
) -> RightHandSide:
    """Return the right-hand side of the filter; see `second_solve`.

    Args:
        motion: the chain's motion.
        tips: per grasp, the arm's tip response.
        loads: loads by arm.
        wrench: (6,) r_a.
    """
    held = [loads[name] for name in motion.chain.grasps]
    loaded = each(loaded_response, tips, motion.holding, held)
    known = each(lambda c, load: along_free(c, load.free), motion.contacts, held)
    gaps = each(lambda tip, f, load: tip.free_acceleration - tip.mobility.apply(f) - load.gap, loaded, known, held)
    if any(grasp.free for grasp in motion.chain.grasps.values()):
        wrench, _ = scan(lambda w, c, f: (w + shift_wrench(c.offset, f), None), wrench, motion.contacts, known)
    return RightHandSide(loaded, known, gaps, wrench)


def second_solve(
    at: Point, loads: Mapping[str, Load], wrench: Array, *, together: bool = False
) -> tuple[dict[str, ArmUnknowns], Array]:
    """Return z by arm, including the base's wrench, and z_a. O(n) + O(l).

    Args:
        at: the point.
        loads: loads by arm; for arms without a grasp the gap is not used.
        wrench: (6,) r_a, about C, world axes.
        together: whether the filter already received these loads when it solved for the point.
    """
    chain, motion, none = at.motion.chain, at.motion, np.zeros(6)
    lone = [name for name in chain.arms if name not in chain.grasps]
    held = [loads[name] for name in chain.grasps]
    tips, known, gaps, wrench = right_hand_side(motion, [at.tips[name] for name in chain.grasps], loads, wrench)
    if together:
        assert at.found.second is not None
        wrenches, alpha = at.found.second
    else:
        assert at.found.factors is not None
        wrenches, alpha = solved_again(at.found.factors, gaps, wrench)
    found = each(
        lambda c, tip, load, f, own: arm_solution(c, tip, load, f + own, alpha),
        motion.contacts,
        tips,
        held,
        wrenches,
        known,
    )
    alone = each_of(lone, lambda *one: loaded_response(*one).back_substitute(none), at.tips, motion.arms, loads)
    others = {name: ArmUnknowns(qdd, none, none[:0], alpha, base) for name, (qdd, base) in alone.items()}
    return dict(zip(chain.grasps, found, strict=True)) | others, alpha


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
