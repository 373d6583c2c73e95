"""The object's filter carried through a trunk: inward body by body, then the arms in the world, and back.

The belief about the object is alpha(G) = x + X beta, mobility P, beta the accelerations of the trunk's columns. At a
body every arm that holds there is one more measurement, whose answer has a column for each component of beta
(`measurement`); what the grasps learn of beta is an inertia N and a load n on the columns. Then the body's joint is
crossed (`crossing`). Behind the last grasp nobody asks for the object any more: its external wrench w has been put upon
the columns as a load -X^T w, and the trunk goes on alone.

It is block elimination of the whole chain's equations in another order, hence exact; nothing is subtracted from N or P
(docs/theory/trunk.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.factored_mobility import FactoredMobility
from holdfast.dynamics.closed.measurement import Measurement, measurement
from holdfast.dynamics.closed.object_filter import ObjectSolution, initial_size, wrench_at_contact
from holdfast.dynamics.closed.object_motion import FreeBody, acceleration_at_C
from holdfast.dynamics.closed.tip_response import BaseResponse, TipResponse
from holdfast.dynamics.trunk.belief import Belief
from holdfast.dynamics.trunk.crossing import (
    Crossing,
    Felt,
    Welded,
    joint_crossed,
    joints_crossed,
    nothing_felt,
    set_free,
)
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration, TrunkMotion
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, concatenate, each
from holdfast.spatial.symmetric import symmetric6


class TrunkSolution(NamedTuple):
    """What the filter finds.

    Attributes:
        found: grasp wrenches, the object's acceleration and the rank.
        trunk: how the trunk accelerates.
        betas: per body, (6,).
        pivots: (n_t,) inertias about the joints, > 0 for a proper trunk.
    """

    found: ObjectSolution
    trunk: TrunkAcceleration
    betas: list[Array]
    pivots: Array


def trunk_filter(
    trunk: TrunkMotion,
    grasps: Mapping[str, tuple[Contact, TipResponse]],
    lone: Mapping[str, TipResponse],
    body: FreeBody,
    tolerance: float = RANK_TOLERANCE,
) -> TrunkSolution:
    """Return grasp wrenches, and the accelerations of object and trunk. O(l) + O(n_t).

    Args:
        trunk: the trunk in motion.
        grasps: the arms that hold, by name: grasp, and answer at tip and base.
        lone: the answers of the arms on the trunk that hold nothing.
        body: the object.
        tolerance: relative size of a pivot that counts as zero, where the contacts say which rows are held.
    """
    contacts, tips = [c for c, _ in grasps.values()], {name: tip for name, (_, tip) in grasps.items()}
    about = each(lambda c: c.about(body.centre, body.centripetal), contacts)
    rows = dict(zip(grasps, each(measurement, about, tips.values()), strict=True))
    bases = {name: tip.base for name, tip in {**tips, **lone}.items() if tip.base is not None}
    welded = with_locked_arms(trunk, bases)
    order = {k: in_order(rows, [name for name in rows if on(trunk, name) == k]) for k in range(-1, len(trunk.bodies))}
    everyone = [name for k in reversed(order) for name in order[k]]
    last = everyone[-1] if everyone else None

    size = initial_size(body, [rows[name] for name in everyone])
    dense = bool(everyone) and rows[everyone[0]].parallel
    P = body.mobility.dense() if dense else FactoredMobility(body.D, body.w)
    x = np.column_stack([body.acceleration, np.zeros((6, trunk.column_count))])
    belief = Belief(x, P, size, sum(len(c.grasp.free) for c in contacts), 1.0)
    felt, updates, crossings = nothing_felt(trunk.column_count), {}, {}
    stops = [len(trunk.bodies) - 1] if trunk.by_joints else range(len(trunk.bodies))
    for k in [*reversed(stops), -1]:
        if k < 0:
            belief = belief._replace(x=belief.x[:, 0])  # what carries the trunk does not accelerate by more than said
        for name, base in bases.items():
            if on(trunk, name) == k:
                felt = felt.plus(base.wrench, base.Y)
        for name in order[k]:
            see = belief.seen if name != last else partial(belief.seen_last, w=body.wrench)
            belief, updates[name] = see(rows[name], tolerance)
            added = updates[name].on_trunk
            felt = felt if added is None else felt.plus(added[:, 0], added[:, 1:])
        if k >= 0:
            crossings[k] = crossed(trunk, k, welded, belief, felt)
            belief, felt = crossings[k].belief, crossings[k].felt

    alone = last is not None and on(trunk, last) >= 0  # the trunk, behind the last grasp
    s, beta, found, accelerations = np.zeros(6) if alone else body.wrench, None, {}, []
    alpha = None if everyone else belief.x + belief.factors().apply(body.wrench)
    for k in [-1, *stops]:
        if k >= 0:
            a, beta = crossings[k].accelerated(np.zeros(6) if beta is None else beta, s)
            accelerations.append(a)
        for name in reversed(order[k]):
            if name == last:
                alpha, found[name] = updates[name].answer(beta)
                s = body.wrench + found[name]
            else:
                found[name] = updates[name].back_substitute(s, beta)
                s = s + found[name]

    assert alpha is not None
    answer = ObjectSolution(
        each(wrench_at_contact, about, [found[name] for name in grasps]),
        acceleration_at_C(body.centre, body.centripetal, alpha),
        symmetric6(belief.dense()).mobility_shifted(-body.centre).dense(),
        belief.kept,
        belief.weakest,
        [updates[name].independent for name in rows],
    )
    of_base = accelerations.pop(0) if trunk.floats else None
    accelerating = TrunkAcceleration(concatenate(accelerations), of_base)
    pivots = concatenate([crossings[k].pivots for k in stops])
    return TrunkSolution(answer, accelerating, trunk.accelerations(accelerating), pivots)


def on(trunk: TrunkMotion, name: str) -> int:
    """Return the place of the body that an arm stands on; -1 for the world."""
    mount = trunk.mounts.get(name)
    return -1 if mount is None else mount.body


def in_order(rows: Mapping[str, Measurement], names: list[str]) -> list[str]:
    """Return the arms of one body, those first that add in parallel."""
    return [*(n for n in names if rows[n].parallel), *(n for n in names if not rows[n].parallel)]


def with_locked_arms(trunk: TrunkMotion, bases: Mapping[str, BaseResponse]) -> list[Welded]:
    """Return every body of the trunk with its arms, their joints locked."""
    arms = each(
        lambda inertia, wrench, offset: Welded(inertia, wrench).moved(offset),
        [base.locked for base in bases.values()],
        [base.at_rest for base in bases.values()],
        [trunk.mounts[name].offset for name in bases],
    )
    found = [Welded(body.inertia, body.wrench) for body in trunk.bodies]
    for name, arm in zip(bases, arms, strict=True):
        found[on(trunk, name)] = found[on(trunk, name)].plus(arm)
    return found


def crossed(trunk: TrunkMotion, k: int, welded: list[Welded], belief: Belief, felt: Felt) -> Crossing:
    """Return the joint of body k crossed, or all that the columns stand for."""
    if trunk.by_joints:
        return joints_crossed(trunk.bodies, welded, belief, felt)
    if trunk.bodies[k].joint is None:
        return set_free(welded[k], belief, felt)
    return joint_crossed(trunk.bodies[k], welded[k], belief, felt)
