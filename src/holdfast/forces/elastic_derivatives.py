"""Derivatives of the elastic programme's central point: one more solve with the factors there.

At mu > 0 the central point is an analytic function of the programme's numbers, without a kink where a limit becomes
active. Its multipliers are z = mu s^-1, so dz = -W^-2 ds + s^-1 dmu, where W is the scaling at hand. With G, h, B all
limits, and H = P + G' W^-2 G the matrix that the iterations factorise:

    H dx + E' dnu - G' W^-2 B dv = -(dP x + dc + dG' z + dE' nu) + G' W^-2 (dh - dG x) - G' s^-1 dmu
    E dx = de - dE x
    (1 + z_v / v + B' W^-2 B) dv - B' W^-2 G dx = -drho - B' W^-2 (dh - dG x) + (B' s^-1 + 1 / v) dmu

The matrix is symmetric. With (p, n, p_v) its solution for cotangents (x_bar, 0, v_bar), and
r = W^-2 (G p - B p_v - z_bar), where the last is a cotangent of the multipliers, which also enters its right side:

    P_bar = -p x',   c_bar = -p,   G_bar = -(z p' + r x'),   h_bar = r,   E_bar = -(nu p' + n x'),   e_bar = n,
    rho_bar = -p_v,   mu_bar = (p_v (B' z + z_v) - p' G' z + z_bar' z) / mu

At mu = 0 there is no derivative where a limit becomes active, and elsewhere the last iterate does not have it: it is on
no central path, and the scaling of an active cone is off by as much as s o z is from a multiple of [1, 0, ..]. What is
returned then is NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import MethodNotApplicable, StateError
from holdfast.forces.elastic_programme import (
    ITERATIONS,
    Border,
    Distributed,
    Iterate,
    border_of,
    direction,
    solve,
)
from holdfast.forces.programme_block import Block, BlockFactors, BlockPoint, Cone, Ends, factorised, total
from holdfast.spatial.differentiation import by_rule_below, is_recorded
from holdfast.spatial.scalar import Array, Scalar, concatenate, each, reciprocal, where
from holdfast.spatial.vector import outer

_ARRAYS = 6  # of a block, besides its cones
OfLimits = tuple[Array, list[Array]]  # of bounds, and of each cone
BlockStep = tuple[Array, OfLimits]  # dx and dz


class CentralChange(NamedTuple):
    """A change of the central point.

    Attributes:
        of_blocks: dx and dz of every block.
        v: dv.
        nu: (rows,) dnu.
    """

    of_blocks: list[BlockStep]
    v: Scalar
    nu: Array


class CentralPointRule(NamedTuple):
    """The rule for derivatives of the central point by the numbers of the programme, in the order of `numbers_of`.

    Attributes:
        blocks: the blocks, with the coupling rows that are imposed.
        at: the central point.
        used: (rows,) 1 for the coupling rows that are imposed.
        of: factors of the blocks.
        border: the equations that these leave.
        stiffness: of v, without the blocks.
        prices: B' z + z_v.
        smooth: 1 at mu > 0, NaN at mu = 0.
    """

    blocks: list[Block]
    at: Iterate
    used: Array
    of: list[BlockFactors]
    border: Border
    stiffness: Scalar
    prices: Scalar
    smooth: Scalar

    def rates(self, *rates: Any) -> list[Array]:
        """Return the rates of x and of the multipliers of every block, and of v, for rates of the numbers."""
        changes, de, price, barrier = taken(self.blocks, rates)
        share, used, nu = barrier[()] * reciprocal(self.at.v * self.at.z), self.used, self.at.nu

        def changed(block: Block, at: BlockPoint, f: BlockFactors, by: Block) -> tuple[Array, OfLimits, Array]:
            by, along = by.with_rows(used), by.R @ at.x
            less = by.P @ at.x + by.c + by.pull(at.z, [z for _, z in at.of_cones]) + by.E.T @ nu
            shift = concatenate([by.high - along, along - by.low]), [cone.h - cone.G @ at.x for cone in by.cones]
            return -less - share * f.pull, shift, by.E @ at.x

        found = each(changed, self.blocks, self.at.points, self.of, changes)
        missing = total(of_rows for *_, of_rows in found) - used * de
        of_v = share * self.prices - price[()]
        solved = self.solved([x for x, *_ in found], missing, of_v, [x for _, x, _ in found])
        dz = [
            concatenate([z, [x[0] for x in of_cones]]) + share * at.multipliers
            for (_, (z, of_cones)), at in zip(solved.of_blocks, self.at.points, strict=True)
        ]
        return [*(dx for dx, _ in solved.of_blocks), *dz, np.asarray(solved.v)]

    def gradient(self, *cotangents: Any) -> list[Array]:
        """Return the gradients by the numbers of sum(x_bar . x) + sum(z_bar . multipliers) + v_bar v."""
        *of_blocks, of_v = cotangents
        of_x, of_z = of_blocks[: len(self.blocks)], of_blocks[len(self.blocks) :]

        def shift(at: BlockPoint, bar: Array) -> OfLimits:
            firsts = zip(at.of_cones, bar[len(at.s) :], strict=True)
            return bar[: len(at.s)], [concatenate([[x], np.zeros(len(s) - 1)]) for (s, _), x in firsts]

        shifts = [shift(at, bar) for at, bar in zip(self.at.points, of_z, strict=True)]
        solved = self.solved(of_x, np.zeros(len(self.at.nu)), of_v[()], shifts)
        used, nu, n = self.used, self.at.nu, solved.nu

        def gradients(block: Block, at: BlockPoint, f: BlockFactors, step: BlockStep) -> tuple[Block, Scalar]:
            (p, (r, of_cones)), x, m = step, at.x, len(block.low)
            R = -(outer(at.z[:m] - at.z[m:], p) + outer(r[:m] - r[m:], x))
            pairs = zip(at.of_cones, of_cones, strict=True)
            cones = tuple([Cone(-(outer(z, p) + outer(r, x)), r) for (_, z), r in pairs])
            E = -(outer(nu, p) + outer(n, x))
            return Block(-outer(p, x), -p, R, -r[m:], r[:m], cones, E).with_rows(used), p @ f.pull

        found = each(gradients, self.blocks, self.at.points, self.of, solved.of_blocks)
        by_share = total(bar @ at.multipliers for bar, at in zip(of_z, self.at.points, strict=True))
        by_share = by_share + solved.v * self.prices - total(x for _, x in found)
        barrier = by_share * reciprocal(self.at.v * self.at.z)
        return numbers_of([block for block, _ in found], used * n, -solved.v, barrier)

    def solved(self, right: Sequence[Array], missing: Array, of_v: Scalar, shifts: Sequence[OfLimits]) -> CentralChange:
        """Return the solution, once improved, of the equations with the multipliers among the unknowns.

            P dx + E' dnu + G' dz = right,             E dx = -missing
            G dx - B dv - W^2 dz = shift,              (1 + z_v / v) dv - B' dz = of_v

        W^-2 magnifies the rounding of dz, the more the larger multipliers are: to all digits where limits conflict.
        That is missing in the other rows, so they are solved once more for what they miss.
        """
        first = self.once(right, missing, of_v, shifts)

        def left(block: Block, b: Array, step: BlockStep) -> tuple[Array, Scalar, Array]:
            dx, (dz, of_cones) = step
            own = block.P @ dx + block.E.T @ first.nu + block.pull(dz, of_cones)
            return b - own, total(dz) + total(x[0] for x in of_cones), block.E @ dx

        found = each(left, self.blocks, right, first.of_blocks)
        rest = of_v - self.stiffness * first.v + total(price for _, price, _ in found)
        still = [(0.0 * s, [0.0 * x for x in of_cones]) for s, of_cones in shifts]
        more = self.once([x for x, *_ in found], missing + total(x for *_, x in found), rest, still)

        def added(a: BlockStep, b: BlockStep) -> BlockStep:
            (dx, (dz, of_cones)), (mx, (mz, more_cones)) = a, b
            return dx + mx, (dz + mz, [x + y for x, y in zip(of_cones, more_cones, strict=True)])

        return CentralChange(each(added, first.of_blocks, more.of_blocks), first.v + more.v, first.nu + more.nu)

    def once(self, right: Sequence[Array], missing: Array, of_v: Scalar, shifts: Sequence[OfLimits]) -> CentralChange:
        """Return the solution by the factors of H; see `solved`."""

        def pulled(block: Block, at: BlockPoint, f: BlockFactors, b: Array, shift: OfLimits) -> tuple[Array, Scalar]:
            pulls, of_cones = _pulls(at, f, *shift)
            return b + block.pull(pulls, of_cones), total(pulls) + total(x[0] for x in of_cones)

        found = each(pulled, self.blocks, self.at.points, self.of, right, shifts)
        of_v = self.smooth * (of_v - total(price for _, price in found))
        steps, dv, nu = direction(self.blocks, self.of, self.border, [x for x, _ in found], missing, of_v)

        def with_multipliers(at: BlockPoint, f: BlockFactors, ends: Ends, shift: OfLimits) -> BlockStep:
            dx, ds, of_cones = ends
            along = [-(a + b) for a, b in zip(shift[1], of_cones, strict=True)]
            return dx, _pulls(at, f, -(shift[0] + ds), along)

        return CentralChange(each(with_multipliers, self.at.points, self.of, steps, shifts), dv, nu)


def rule_at(blocks: Sequence[Block], found: Distributed, barrier: Scalar) -> CentralPointRule:
    """Return the rule at the central point of mu."""
    imposed = [block.with_rows(found.used) for block in blocks]
    last, of = found.last, each(factorised, imposed, found.last.points)
    stiffness = 1.0 + last.z * reciprocal(last.v)
    border, prices = border_of(of, stiffness, found.used), last.z + total(f.price for f in of)
    smooth = where(barrier > 0.0, 1.0, np.nan)
    return CentralPointRule(imposed, last, found.used, of, border, stiffness, prices, smooth)


def central_point(
    blocks: Sequence[Block], e: Array, price: Scalar, iterations: int = ITERATIONS, barrier: Scalar = 0.0
) -> Distributed:
    """Return what `solve` returns; where numbers of the programme vary, x, v and multipliers have their derivatives.

    Raises:
        MethodNotApplicable: a second derivative is asked.
    """
    given = numbers_of(blocks, e, price, barrier)
    if not any(map(is_recorded, given)):
        return solve(blocks, e, price, iterations, barrier)
    at: list[Distributed] = []

    def made(*numbers: Array) -> tuple[list[Array], CentralPointRule]:
        if any(map(is_recorded, numbers)):
            raise MethodNotApplicable(
                "distribute: expected one derivative, got a derivative within another, which it does not have"
            )
        own, rows, cost, mu = taken(blocks, numbers)
        found = solve(own, rows, cost[()], iterations, mu[()])
        at.append(found)
        return [*found.x, *found.multipliers, np.asarray(found.v)], rule_at(own, found, mu[()])

    *x, v = by_rule_below(made, *given)
    return at[0]._replace(x=x[: len(blocks)], multipliers=x[len(blocks) :], v=v[()])


def require_barrier(what: str, given: Mapping[str, Array]) -> None:
    """Refuse derivatives of a distribution without a barrier.

    Args:
        what: what is asked, for the message.
        given: the parameters of one system or a batch, among them `barrier`.

    Raises:
        StateError: mu is not above 0.
    """
    least = float(np.min(given["barrier"], initial=np.inf))
    if not least > 0.0:
        raise StateError(
            f"{what}: barrier: expected one above 0, got {least:g}: torques within limits have a kink where a limit"
            " becomes active, and no derivative there. Try barrier=1e-5 (`ForceCost.barrier`), the same in the calls"
            " whose derivatives these are"
        )


def numbers_of(blocks: Sequence[Block], e: Array, price: Scalar, barrier: Scalar) -> list[Array]:
    """Return the arrays of a programme: those of its blocks, then e, rho and mu."""
    of_blocks = [[*block[:5], block.E, *(x for cone in block.cones for x in cone)] for block in blocks]
    return [*(x for arrays in of_blocks for x in arrays), e, np.asarray(price), np.asarray(barrier)]


def taken(like: Sequence[Block], arrays: Sequence[Any]) -> tuple[list[Block], Array, Array, Array]:
    """Return the blocks, e, rho and mu of the arrays of `numbers_of`."""
    found, rest = [], [np.asarray(x) for x in arrays]
    for block in like:
        count = _ARRAYS + 2 * len(block.cones)
        (P, c, R, low, high, E, *own), rest = rest[:count], rest[count:]
        cones = tuple([Cone(G, h) for G, h in zip(own[::2], own[1::2], strict=True)])
        found.append(Block(P, c, R, low, high, cones, E, block.shared))
    e, price, barrier = rest
    return found, e, price, barrier


def _pulls(at: BlockPoint, f: BlockFactors, ends: Array, of_cones: Sequence[Array]) -> OfLimits:
    """Return W^-2 times changes of the slacks, of bounds and of cones; the matrix W^-2 has rounded its small parts."""
    return at.z * f.slack * ends, [w.over(w.over(x)) for w, x in zip(f.scalings, of_cones, strict=True)]
