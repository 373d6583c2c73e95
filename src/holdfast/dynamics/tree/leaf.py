"""A leaf: a chain of joints that ends at one closure and that nothing else needs, as a measurement.

The response of a chain at its tip, alpha_f + X beta_base - Lambda f, turns its closure into a measurement of the body
at the other end, as an arm's grasp measures the object (`measurement`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.filter_updates import IndependentRows
from holdfast.dynamics.closed.measurement import Measurement, measurement, seen_along
from holdfast.dynamics.closed.tip_response import BaseResponse, TipResponse
from holdfast.dynamics.tree.belief import first_by, picked
from holdfast.dynamics.tree.forest_motion import ClosureMotion
from holdfast.dynamics.tree.order import MeasureLeaf
from holdfast.dynamics.tree.right_hand_sides import Inward, Outward
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.dynamics.tree.steps import PartMotion
from holdfast.spatial.inertia import NO_INERTIA
from holdfast.spatial.scalar import Array, array, each, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import symmetric6
from holdfast.spatial.vector import outer

_NONE = np.zeros(6)
NEGLIGIBLE_NOISE = 1e-26  # the square of a row of factors that is only rounding, relative to its size


Noise = tuple[Array, Array] | None


class LeafMeasurement(NamedTuple):
    """A leaf before it is included.

    Attributes:
        step: the step.
        contact: its contact, with the point of the body at the other end in place of C.
        seen: its measurement of that body, with X if its base moves.
        joints: its bodies, if it is no limb.
        noise: (rows, factors), (factors,) the noise R = Z diag(D) Z^T of such a leaf's rows in factors; None of a limb.
    """

    step: MeasureLeaf
    contact: Contact
    seen: Measurement
    joints: list[SettledBody]
    noise: Noise = None

    @property
    def parallel(self) -> bool:
        """Whether the leaf can be included by a parallel sum; rows in factors keep more digits beside heavy bodies."""
        return self.seen.parallel and self.noise is None


def leaves_of(of: PartMotion, steps: Sequence[MeasureLeaf]) -> dict[int, LeafMeasurement]:
    """Return the leaves of a part, by closure."""
    limbs = [step for step in steps if step.closure in of.motion.limbs]
    tips = [of.motion.limbs[step.closure].tip for step in limbs]
    contacts = [contact_of(of.motion.closures[step.closure], step) for step in limbs]
    seen = each(measurement, contacts, tips)
    found = {step.closure: LeafMeasurement(step, c, m, []) for step, c, m in zip(limbs, contacts, seen, strict=True)}
    return found | {step.closure: chain_of_joints(of, step) for step in steps if step.closure not in found}


def chain_of_joints(of: PartMotion, step: MeasureLeaf) -> LeafMeasurement:
    """Return the leaf of joints that are no limb, from their own responses."""
    c = of.motion.closures[step.closure]
    joints, X, w, D = [of.settled[k] for k in step.joints], np.eye(6), np.zeros((6, 0)), []
    for body in joints:
        X, w = body.carried(X), np.hstack([body.carried(w), body.columns])
        D += body.factors.inverse_pivots.tolist()
    X, w = (_shifted(c.l_b if step.is_b else c.l_a, columns) for columns in (X, w))
    base = None if step.of is None else BaseResponse(X, np.zeros((6, 6)), _NONE, NO_INERTIA, _NONE)
    mobility, contact = symmetric6((w * array(D)) @ w.T), contact_of(c, step)
    tip = TipResponse(mobility, _NONE, array(D), lambda *_: (_NONE, _NONE), 0.0, base)
    seen = measurement(contact, tip)
    Z = array([seen_along(contact, seen, column) for column in w.T]).reshape(-1, len(seen.r)).T
    return LeafMeasurement(step, contact, seen, joints, (Z, array(D)))


def independent(noise: Noise, m: Measurement, scale: Array, typical: Array) -> IndependentRows | None:
    """Return a leaf's rows with independent noise, R = L diag(d) L^T by weighted Gram-Schmidt; None of a limb.

    The row with the largest remaining noise, relative to its size, comes first, so that the entries of L are small.
    Rows beyond the number of factors have no noise: what remains of it is rounding.

    Args:
        noise: the noise of its rows in factors.
        m: its rows among all open frames.
        scale: (rows,) sizes of the terms in the pivots.
        typical: (rows,) typical pivots.
    """
    if noise is None:
        return None
    (Z, D), (count, n), c = noise, m.C.shape, m.X.shape[1]
    factors = len(D)
    numbers = factors + n + c
    table = np.column_stack([Z, m.C, m.X, scale, typical, m.own_sizes()])
    done, d, steps = [], [], []
    for j in range(count):
        row, table, picks = first_by((table[:, :factors] * table[:, :factors]) @ D, table)
        of = (row[:factors] * row[:factors]) @ D
        alive = of > NEGLIGIBLE_NOISE * row[-1] if j < factors else np.False_
        inverse = where(alive, 1.0 / where(alive, of, 1.0), 0.0)
        L = inverse * (table[:, :factors] @ (D * row[:factors]))
        table = np.column_stack([table[:, :numbers] - outer(L, row[:numbers]), table[:, numbers:]])
        done.append(row)
        d.append(where(alive, of, 0.0))
        steps.append((picks, L))

    def made_independent(r: Array) -> Array:
        rest, found = r.reshape(count, -1), []
        for picks, L in steps:
            first, rest = picked(picks, rest)
            rest = rest - outer(L, first)
            found.append(first)
        return array(found).reshape(r.shape)

    rows = array(done).reshape(count, -1)
    sizes, which = rows[:, numbers : numbers + 2], np.zeros((count, 0))
    C, X = rows[:, factors : factors + n], rows[:, factors + n : numbers]
    return IndependentRows(C, d, X, sizes, which, made_independent)


def contact_of(c: ClosureMotion, step: MeasureLeaf) -> Contact:
    """Return the contact of a leaf, about the point of the body at its other end; r is its g - a."""
    if step.is_b:
        return replace(c.contact, offset=c.l_a, g=c.zeta_b, a=c.g + c.zeta_a)
    return replace(c.contact, offset=c.l_b, g=c.g + c.zeta_a, a=c.zeta_b)


def _shifted(l: Array, columns: Array) -> Array:
    return array([shift_twist(l, column) for column in columns.T]).reshape(-1, 6).T


def given_to(side: Inward, leaf: LeafMeasurement) -> tuple[ClosureMotion | None, list[Array], Array | None]:
    """Return what a right-hand side gives a leaf: its closure, accelerations nu of its joints, and its gap."""
    step = leaf.step
    closure = side.rhs.closures[step.closure] if leaf.joints else None
    return closure, [side.nu[k] for k in step.joints if leaf.joints], side.rhs.gaps.get(step.closure)


def right_hand_side(leaf: LeafMeasurement, c: ClosureMotion | None, nus: list[Array], gap: Array | None) -> Array:
    """Return r of a leaf's measurement, (rows,), of what `given_to` returns."""
    if c is not None:
        step, free = leaf.step, np.zeros((6, 1))
        for body, nu in zip(leaf.joints, nus, strict=True):
            free = body.carried(free) + (body.motion.H @ nu)[:, None]
        still = contact_of(c, step)
        gap = shift_twist(c.l_b if step.is_b else c.l_a, free[:, 0]) + still.g - still.a
    return leaf.seen.r if gap is None else seen_along(leaf.contact, leaf.seen, gap)


def through_joints(back: Outward, leaf: LeafMeasurement, f: Array) -> None:
    """Let the wrench f of a leaf's end on the other body pass inward through its joints, if they are no limb."""
    if leaf.joints:
        c = back.rhs.closures[leaf.step.closure]
        t = -shift_wrench(c.l_b if leaf.step.is_b else c.l_a, f)
        for k, body in zip(reversed(leaf.step.joints), reversed(leaf.joints), strict=True):
            back.extra[k], t = body.through(t)


def wrench_at_contact(about: Contact, from_leaf: Array) -> Array:
    """Return a leaf's wrench about its contact point, exactly 0 along the grasp's freedoms, (6,)."""
    return about.transmissible(shift_wrench(-about.offset, from_leaf))
