"""The object's filter extended through a trunk: inward body by body, then the arms without a trunk, and back.

The state of the filter is alpha(G) = x + X beta with mobility P, where beta are the accelerations of the trunk's
columns. On each body, every arm with a grasp is one more measurement, whose tip response has a column for each
component of beta (`measurement`). The grasps add an inertia N and a load n to the equations of the columns. Then the
body's joint is crossed (`crossing`). After the last grasp the object is eliminated: its external wrench w has become a
load -X^T w on the columns, and only the equations of the trunk remain.

This is a block elimination of the equations of the whole chain in another order, and therefore exact. Nothing is
subtracted from N or P (docs/theory/trunk.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.factored_mobility import FactoredMobility
from holdfast.dynamics.closed.measurement import Measurement, measurement
from holdfast.dynamics.closed.object_filter import ObjectSolution, initial_size, wrench_at_contact
from holdfast.dynamics.closed.object_motion import FreeBody, acceleration_at_C
from holdfast.dynamics.closed.tip_response import BaseResponse, TipResponse
from holdfast.dynamics.trunk.crossing import (
    CarriedTerms,
    Crossing,
    FilterState,
    LockedBody,
    joint_crossed,
    joints_crossed,
    nothing_carried,
    set_free,
)
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration, TrunkMotion
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, concatenate, each
from holdfast.spatial.symmetric import symmetric6


class TrunkSolution(NamedTuple):
    """The result of the filter.

    Attributes:
        found: grasp wrenches, the object's acceleration and the rank.
        trunk: acceleration of the trunk; None without one.
        betas: per body, beta (6,).
        pivots: (n_t,) inertias about the trunk's joints, > 0 if its mass matrix is regular; None without a trunk.
    """

    found: ObjectSolution
    trunk: TrunkAcceleration | None = None
    betas: Sequence[Array] = ()
    pivots: Array | None = None

    def of_columns(self, trunk: TrunkMotion | None, name: str) -> Array | None:
        """Return the accelerations of an arm's columns, (c,); None if it is not mounted on a trunk."""
        return None if trunk is None or self.trunk is None else trunk.of_columns(name, self.trunk, self.betas)


def trunk_filter(
    trunk: TrunkMotion,
    grasps: Mapping[str, tuple[Contact, TipResponse]],
    lone: Mapping[str, TipResponse],
    body: FreeBody,
    tolerance: float = RANK_TOLERANCE,
) -> TrunkSolution:
    """Return grasp wrenches, and the accelerations of object and trunk. O(l) + O(n_t).

    Args:
        trunk: the trunk's motion.
        grasps: contact and tip response of the arms with a grasp, by name.
        lone: tip responses of the arms on the trunk without a grasp.
        body: the object.
        tolerance: relative size of a pivot that counts as zero, if the contacts have masks of rows.
    """
    contacts, tips = [c for c, _ in grasps.values()], {name: tip for name, (_, tip) in grasps.items()}
    about = each(lambda c: c.about(body.centre, body.centripetal), contacts)
    rows = dict(zip(grasps, each(measurement, about, tips.values()), strict=True))
    bases = {name: tip.base for name, tip in {**tips, **lone}.items() if tip.base is not None}
    contact_freedoms = sum(len(c.grasp.free) for c in contacts)
    sweep = inward(trunk, rows, bases, body, contact_freedoms, tolerance)
    wrenches, alpha, accelerations = outward(trunk, sweep, body.wrench)

    filter_state = sweep.filter_state
    found = ObjectSolution(
        each(wrench_at_contact, about, [wrenches[name] for name in grasps]),
        acceleration_at_C(body.centre, body.centripetal, alpha),
        symmetric6(filter_state.dense()).mobility_shifted(-body.centre).dense(),
        filter_state.kept,
        filter_state.weakest,
        [sweep.updates[name].independent for name in rows],
    )
    of_base = accelerations.pop(0) if trunk.floats else None
    accelerating = TrunkAcceleration(concatenate(accelerations), of_base)
    pivots = concatenate([sweep.crossings[k].pivots for k in stops(trunk)])
    return TrunkSolution(found, accelerating, trunk.accelerations(accelerating), pivots)


class InwardSweep(NamedTuple):
    """The result of the inward sweep, for the outward one.

    Attributes:
        filter_state: the state of the filter after all arms.
        order: the arms with a grasp, by the index of the body on which they are mounted, -1 for the world.
        last: the arm included last; None if no arm has a grasp.
        updates: by arm.
        crossings: by body.
    """

    filter_state: FilterState
    order: Mapping[int, list[str]]
    last: str | None
    updates: Mapping[str, Any]
    crossings: Mapping[int, Crossing]


def inward(
    trunk: TrunkMotion,
    rows: Mapping[str, Measurement],
    bases: Mapping[str, BaseResponse],
    body: FreeBody,
    contact_freedoms: int,
    tolerance: float,
) -> InwardSweep:
    """Return the filter after all arms and all joints of the trunk, from the outermost body to the world.

    Args:
        trunk: the trunk's motion.
        rows: measurements of the arms with a grasp, by name.
        bases: base responses of the arms on the trunk, by name.
        body: the object.
        contact_freedoms: number of free components of all grasps, which count as independent rows.
        tolerance: relative size of a pivot that counts as zero, if the contacts have masks of rows.
    """
    welded = with_locked_arms(trunk, bases)
    order = {k: in_order(rows, [name for name in rows if on(trunk, name) == k]) for k in range(-1, len(trunk.bodies))}
    everyone = [name for k in reversed(order) for name in order[k]]
    last = everyone[-1] if everyone else None

    size = initial_size(body, [rows[name] for name in everyone])
    dense = bool(everyone) and rows[everyone[0]].parallel
    P = body.mobility.dense() if dense else FactoredMobility(body.D, body.w)
    X = np.zeros((6, trunk.column_count))
    filter_state = FilterState(body.acceleration, X, P, size, contact_freedoms, 1.0)
    carried, updates, crossings = nothing_carried(trunk.column_count), {}, {}
    for k in [*reversed(stops(trunk)), -1]:
        if k < 0:
            filter_state = filter_state._replace(X=np.zeros((6, 0)))  # the trunk's base has no additional acceleration
        for name, base in bases.items():
            if on(trunk, name) == k:
                carried = carried.plus(base.wrench, base.Y)
        for name in order[k]:
            see = filter_state.updated if name != last else partial(filter_state.updated_by_final, w=body.wrench)
            filter_state, updates[name] = see(rows[name], tolerance)
            if k >= 0:
                carried = carried.plus(updates[name].load, updates[name].inertia)
        if k >= 0:
            crossings[k] = crossed(trunk, k, welded, filter_state, carried)
            filter_state, carried = crossings[k].filter_state, crossings[k].carried
    return InwardSweep(filter_state, order, last, updates, crossings)


def outward(trunk: TrunkMotion, sweep: InwardSweep, w: Array) -> tuple[dict[str, Array], Array, list[Array]]:
    """Return the arms' wrenches at G, alpha(G), and the accelerations of the joints from the world outward.

    Args:
        trunk: the trunk's motion.
        sweep: the result of the inward sweep.
        w: (6,) external wrench on the object about G.
    """
    last, filter_state = sweep.last, sweep.filter_state
    alone = last is not None and on(trunk, last) >= 0  # only the trunk remains after the last grasp
    s, beta, wrenches, accelerations = np.zeros(6) if alone else w, np.zeros(0), {}, []
    alpha = filter_state.x + filter_state.factors().apply(w) if last is None else None
    for k in [-1, *stops(trunk)]:
        if k >= 0:
            a, beta = sweep.crossings[k].accelerated(beta if len(beta) else np.zeros(6), s)
            accelerations.append(a)
        for name in reversed(sweep.order[k]):
            if name == last:
                alpha, wrenches[name] = sweep.updates[name].solution(beta)
                s = w + wrenches[name]
            else:
                update = sweep.updates[name]
                wrenches[name] = update.factors.back(s, update.nu, beta)
                s = s + wrenches[name]
    assert alpha is not None
    return wrenches, alpha, accelerations


def stops(trunk: TrunkMotion) -> list[int]:
    """Return the indices of the bodies whose joints are crossed: all, or the outermost one for all joints at once."""
    return [len(trunk.bodies) - 1] if trunk.by_joints else list(range(len(trunk.bodies)))


def on(trunk: TrunkMotion, name: str) -> int:
    """Return the index of the body on which an arm is mounted; -1 for the world."""
    mount = trunk.mounts.get(name)
    return -1 if mount is None else mount.body


def in_order(rows: Mapping[str, Measurement], names: list[str]) -> list[str]:
    """Return the arms of one body; those included by a parallel sum come first."""
    return [*(n for n in names if rows[n].parallel), *(n for n in names if not rows[n].parallel)]


def with_locked_arms(trunk: TrunkMotion, bases: Mapping[str, BaseResponse]) -> list[LockedBody]:
    """Return every body of the trunk together with its arms, whose joints are locked."""
    arms = each(
        lambda inertia, wrench, offset: LockedBody(inertia, wrench).moved(offset),
        [base.locked for base in bases.values()],
        [base.at_rest for base in bases.values()],
        [trunk.mounts[name].offset for name in bases],
    )
    found = [LockedBody(body.inertia, body.wrench) for body in trunk.bodies]
    for name, arm in zip(bases, arms, strict=True):
        found[on(trunk, name)] = found[on(trunk, name)].plus(arm)
    return found


def crossed(
    trunk: TrunkMotion, k: int, welded: list[LockedBody], filter_state: FilterState, carried: CarriedTerms
) -> Crossing:
    """Return the result of crossing the joint of body k, or all joints if the columns are their accelerations."""
    if trunk.by_joints:
        return joints_crossed(trunk.bodies, welded, filter_state, carried)
    if trunk.bodies[k].joint is None:
        return set_free(welded[k], filter_state, carried)
    return joint_crossed(trunk.bodies[k], welded[k], filter_state, carried)
