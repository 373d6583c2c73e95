"""The elastic programme of force distribution, by an interior point of fixed length.

    min   sum_i (1/2 x_i' P_i x_i + c_i' x_i) + rho v + 1/2 v^2
    s.t.  sum_i E_i x_i = e,   low_i - v <= R_i x_i <= high_i + v,   h_ij - G_ij x_i + v [1, 0, ..] in a cone,   v >= 0

Blocks i are arms. They are coupled in the rows of E, in v, and in the last unknowns of every x_i if the blocks share
some, such as the accelerations of a trunk. Each block is factorised alone, then the shared unknowns with what the
blocks leave of them, and what is left are as many equations as E has rows, and one for v: this is the border. Every
limit gives way by v at the price rho, so there is always a solution; v = 0 where the limits can be kept, as long as rho
exceeds the sum of their multipliers (exact penalty).

Slacks are s = h - G x + v from the start, and steps keep that. In the right-hand sides, W^-2 s is z by the definition
of the scaling W. It is used as known: computed, it would lose the digits that W^-2 magnifies.

References: Mehrotra, "On the implementation of a primal-dual interior point method", 1992; Nesterov and Todd,
"Self-scaled barriers and interior-point methods for convex programming", 1997; Colombo and Gondzio, "Further
development of multiple centrality correctors for interior point methods", 2008; Boyd and Wegbreit, "Fast computation of
optimal contact forces", 2007.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.forces.programme_block import (
    Block,
    BlockFactors,
    BlockPoint,
    Ends,
    change,
    corrected,
    factorised,
    gradient,
    gradient_sizes,
    greatest,
    predicted,
    right_side,
    step_ends,
    total,
)
from holdfast.spatial.linalg import MaskedLDL, back_substitution, cholesky, forward_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import (
    Array,
    Scalar,
    array,
    concatenate,
    each,
    maximum,
    minimum,
    reciprocal,
    scan,
    select,
    sqrt,
    where,
)
from holdfast.spatial.second_order_cone import cone_inverse
from holdfast.spatial.vector import outer

ITERATIONS = 16
SOLVED = 1e-9  # residual at which the iterate is kept
FRACTION = 0.99  # of the way to the boundary
LARGEST = 1e100  # step of v that is taken
SHORT_PREDICTOR = 0.3  # a longest step below which the predictor's second order is trusted in this proportion only
NULL = 1e-16  # a pivot of the coupling rows that is lost in rounding, relative to its row
LOST_PIVOT = 1e-13  # of pivots of shared unknowns, relative to their own curvature
# Along some shared unknowns, neither costs nor limits feel a step, and coupling rows alone determine it. There a pivot
# of rounding is taken as 1, the size of the others: a small one would spoil the digits of those rows.
UNFELT = 1e-6


class Iterate(NamedTuple):
    """The point of an iteration.

    Attributes:
        points: those of the blocks.
        v: by how much limits give way, which is also the slack of v >= 0.
        z: multiplier of v >= 0.
        nu: (rows,) multipliers of the coupling rows.
        left: the part of the first dual residual that is left.
        open: 1 until the residual is below `SOLVED`, then 0.
    """

    points: Sequence[BlockPoint]
    v: Scalar
    z: Scalar
    nu: Array
    left: Scalar
    open: Scalar


class Distributed(NamedTuple):
    """The solution.

    Attributes:
        x: (n,) of every block.
        v: by how much limits give way.
        residual: the largest residual of the optimality conditions: that of the gradient relative to 1 + rho, that of
            the coupling rows, and the gap of the objective relative to 1 + rho v.
        last: the point with its multipliers.
        used: (rows,) 1 for the coupling rows that are imposed, 0 for those that depend on others.
        multipliers: of every block, those of its bounds and the first entries of those of its cones.
    """

    x: list[Array]
    v: Scalar
    residual: Scalar
    last: Iterate
    used: Array
    multipliers: list[Array]


class CoupledRows(NamedTuple):
    """What the blocks have in common.

    Attributes:
        e: (rows,) right-hand side of the coupling rows.
        used: (rows,) 1 for those that are imposed, 0 for those that depend on others.
        price: rho.
        barrier: mu.
        first: size of the dual residual at the start, all of which every step reduces by the same factor.
    """

    e: Array
    used: Array
    price: Scalar
    barrier: Scalar
    first: Scalar


class Border(NamedTuple):
    """The equations for shared unknowns, v and the multipliers of the coupling rows that the factorised blocks leave.

    Attributes:
        C: (shared, shared) Cholesky factor of what the blocks leave for the shared unknowns.
        V: (shared, rows + 1) its inverse times what they leave of the columns of multipliers and of v.
        by_v: (rows,) what v does to the coupling rows.
        pivot: the inverse of what is left for v, which is eliminated before the multipliers: where limits leave a
            direction to v alone, the multipliers by themselves have a pivot there that is lost in rounding.
        factors: those of what is left for the multipliers.
    """

    C: Array
    V: Array
    by_v: Array
    pivot: Scalar
    factors: MaskedLDL

    def solved(self, sums: Array, missing: Array, of_shared: Array, right: Scalar) -> tuple[Scalar, Array, Array]:
        """Return dv, the multipliers after the step, and the step of the shared unknowns.

        Args:
            sums: (rows + shared + 1,) sum of V' y over the blocks' half-solved right-hand sides y.
            missing: (rows,) what the step takes off the coupling rows.
            of_shared: (shared,) right-hand side of the shared unknowns.
            right: right-hand side of v.
        """
        r, k = len(missing), len(of_shared)
        half = forward_substitution(self.C, of_shared - sums[r : r + k])
        sums = concatenate([sums[:r], sums[r + k :]])
        if k:
            sums = sums + self.V.T @ half
        own = self.pivot * (right - sums[r])
        after = ldl_solve(self.factors, sums[:r] + missing - own * self.by_v)
        dv = own + self.pivot * (self.by_v @ after)
        return dv, after, back_substitution(self.C, half - self.V @ concatenate([after, [dv]]))


def solve(
    blocks: Sequence[Block], e: Array, price: Scalar, iterations: int = ITERATIONS, barrier: Scalar = 0.0
) -> Distributed:
    """Return the solution of the elastic programme, or its central point at mu, s o z = mu [1, 0, ..]. O(blocks).

    Args:
        blocks: the blocks.
        e: (rows,) right-hand side of the coupling rows.
        price: rho.
        iterations: how many.
        barrier: mu; 0 for the solution.
    """
    known = total(block.E @ block.E.T for block in blocks)
    factors = ldl(known, np.diag(known))
    used = array([where(pivot > 0.0, 1.0, 0.0) for pivot in factors.pivots])
    chosen = [block.with_rows(used) for block in blocks]
    begin = _start(chosen, len(e), price)
    first = maximum(begin.v, greatest(gradient_sizes(chosen, each(gradient, chosen, begin.points))))
    coupling = CoupledRows(used * e, used, price, barrier, first)
    last, _ = scan(lambda at, _: (_advanced(chosen, coupling, at), None), begin, [None] * iterations)
    # what is left of the coupling rows is taken off with the smallest change
    left = ldl_solve(factors, e - total(block.E @ at.x for block, at in zip(blocks, last.points, strict=True)))
    shared = total(block.E.T[block.own :] @ left for block in blocks)
    points = each(
        lambda block, at: at._replace(x=at.x + concatenate([block.E.T[: block.own] @ left, shared])),
        blocks,
        last.points,
    )
    last = last._replace(points=points)
    x, multipliers = [at.x for at in points], [at.multipliers for at in points]
    return Distributed(x, last.v, _residual(blocks, e, price, last), last, used, multipliers)


def _start(blocks: Sequence[Block], rows: int, price: Scalar) -> Iterate:
    """Return x = 0, the v that puts every limit one unit inside, and multipliers mu s^-1 that add up to rho."""

    def needed(block: Block) -> Scalar:
        return greatest([-block.high, block.low, *(sqrt(h[1:] @ h[1:]) - h[0] for _, h in block.cones)])

    def slacks(block: Block) -> tuple[Array, list[Array], Scalar]:
        s = concatenate([block.high, -block.low]) + v
        of_cones = [concatenate([[h[0] + v], h[1:]]) for _, h in block.cones]
        return s, of_cones, total(reciprocal(s)) + total(cone_inverse(x)[0] for x in of_cones)

    v = 1.0 + greatest(each(needed, blocks))
    found = each(slacks, blocks)
    mu = price * reciprocal(reciprocal(v) + total(weight for *_, weight in found))

    def point(block: Block, s: Array, of_cones: list[Array]) -> BlockPoint:
        return BlockPoint(0.0 * block.c, s, mu * reciprocal(s), tuple([(x, mu * cone_inverse(x)) for x in of_cones]))

    points = each(point, blocks, [s for s, *_ in found], [of_cones for _, of_cones, _ in found])
    return Iterate(points, v, mu * reciprocal(v), np.zeros(rows), 1.0, 1.0)


def _advanced(blocks: Sequence[Block], coupling: CoupledRows, at: Iterate) -> Iterate:
    """Return the next iterate: a step of Mehrotra's predictor and corrector."""
    (points, v, z, nu, left, still), price = at, coupling.price
    of = each(factorised, blocks, points)
    missing = total(block.E @ own.x for block, own in zip(blocks, points, strict=True)) - coupling.e
    degree = 1 + sum(2 * len(block.low) + len(block.cones) for block in blocks)
    gap = total(f.gap for f in of) + v * z
    product = reciprocal(v * z)
    border = border_of(of, 1.0 + z * z * product, coupling.used)

    # predictor: u = z takes G' z off the gradient
    steps, dv, _ = direction(blocks, of, border, [-f.gradient for f in of], missing, -(v + price))
    ratio = dv * product * z
    ahead = each(predicted, points, of, steps)
    longest = reciprocal(greatest([1.0, -ratio, 1.0 + ratio, *(rate for *_, rate in ahead)]))
    less = 1.0 - longest
    sigma = less * less * less
    centre, part = maximum(sigma * gap * (1.0 / degree), coupling.barrier), 1.0 - sigma

    # corrector: the predictor aims at mu = 0, and its second order goes with the square of the way to the barrier's mu.
    # Where the predictor hardly moves, that of bounds says little: in full, two of them take turns for ten iterations.
    # Cones need theirs all the same, or they do
    less = 1.0 - minimum(coupling.barrier * degree * reciprocal(gap), 1.0)
    second = less * less
    of_bounds = second * where(longest < SHORT_PREDICTOR, longest, 1.0)
    factor = 1.0 - of_bounds * (ratio * (1.0 + ratio)) - centre * product
    wanted = each(lambda *of_block: right_side(centre, second, of_bounds, *of_block), blocks, points, of, ahead)
    right = [u.pull - part * (f.gradient + f.pull) for u, f in zip(wanted, of, strict=True)]
    own = v + price - z - total(f.price for f in of)
    of_v = -part * own - z * factor - total(u.price for u in wanted)
    steps, dv, after = direction(blocks, of, border, right, part * missing, of_v)
    ratio = dv * product * z
    found = each(corrected, points, of, wanted, steps)
    length = FRACTION * reciprocal(greatest([FRACTION, -ratio, ratio + factor, *(rate for _, rate in found)]))

    scaled = maximum(coupling.first * left * reciprocal(1.0 + price), gap * reciprocal(1.0 + price * v))
    solved = where(coupling.barrier > 0.0, 0.0, SOLVED)
    before = greatest([abs(missing)])
    rest = missing + length * total(block.E @ step.x for block, (step, _) in zip(blocks, found, strict=True))
    still = where(maximum(scaled, before) < solved, 0.0, still)
    # nor is a step taken that breaks the rows where the gap has the digits of the cost, whose size may be large
    cost = total(own.x @ (f.gradient + block.c) for block, own, f in zip(blocks, points, of, strict=True))
    digits = where(gap < SOLVED * (1.0 + price * v + abs(cost)), 1.0, 0.0)
    still = where(digits * greatest([abs(rest)]) > maximum(before, SOLVED), 0.0, still)
    still = where(border.factors.kept < len(missing), 0.0, still)  # a pivot is lost in rounding: a step would be noise
    still = where(abs(dv) < LARGEST, still, 0.0)  # nor is a step that is not finite
    moves = still * length > 0.0
    made = each(lambda own, step: own.moved(length, step, moves), points, [step for step, _ in found])
    changed = array([v + length * dv, z - length * z * (ratio + factor), left * (1.0 - length * part)])
    v, z, left = select(moves, changed, array([v, z, left]))
    return Iterate(made, v, z, select(moves, nu + length * (after - part * nu), nu), left, still)


def direction(
    blocks: Sequence[Block],
    of: Sequence[BlockFactors],
    border: Border,
    right: Sequence[Array],
    missing: Array,
    of_v: Scalar,
) -> tuple[list[Ends], Scalar, Array]:
    """Return dx and ds of every block, dv, and the multipliers nu after the step.

        H_i dx_i + E_i' nu + H_v dv = right_i,      sum E_i dx_i = -missing,      sum H_v' dx_i + H_vv dv = of_v

    Large entries of H cost the coupling rows their digits, and slacks that are smaller than what is missing then. What
    is missing is therefore solved for once more.

    Args:
        blocks: the blocks.
        of: their factors.
        border: the equations that these leave.
        right: (n,) right-hand side of every block; those of shared unknowns add up.
        missing: (rows,) what the step takes off the coupling rows.
        of_v: right-hand side of v.
    """
    halves = each(lambda block, f, b: forward_substitution(f.C, b[: block.own]), blocks, of, right)
    sums = total(f.V.T @ y for f, y in zip(of, halves, strict=True))
    of_shared = total(b[block.own :] for block, b in zip(blocks, right, strict=True))
    dv, after, shared = border.solved(sums, missing, of_shared, of_v)
    first = each(lambda f, y: change(f, y - f.V @ concatenate([after, shared, [dv]]), shared), of, halves)
    left = missing + total(block.E @ dx for block, dx in zip(blocks, first, strict=True))
    v, nu, other = border.solved(np.zeros(len(sums)), left, np.zeros(len(shared)), 0.0)
    more = each(lambda f: change(f, -(f.V @ concatenate([nu, other, [v]])), other), of)
    ends = each(lambda block, dx, further: step_ends(block, dx + further, dv + v), blocks, first, more)
    return ends, dv + v, after + nu


def border_of(of: Sequence[BlockFactors], stiffness: Scalar, used: Array) -> Border:
    """Return the equations that the factorised blocks leave.

    Args:
        of: the blocks' factors.
        stiffness: of v, without the blocks.
        used: (rows,) 1 for the coupling rows that are imposed.
    """
    S, rows = total(f.V.T @ f.V for f in of), len(used)
    kept = [*range(rows), len(S) - 1]
    left = total(f.of_shared for f in of) - S[rows:-1]
    felt = np.diag(total(f.of_shared for f in of)[:, rows:-1])
    C = cholesky(left[:, rows:-1], UNFELT + LOST_PIVOT * felt)
    V = forward_substitution(C, left[:, kept])
    S = S[np.ix_(kept, kept)] + V.T @ V if len(left) else S
    by_v = S[rows, :rows]
    pivot = reciprocal(maximum(stiffness + (total(f.stiffness for f in of) - S[rows, rows]), stiffness))
    own = S[:rows, :rows] + np.diag(1.0 - used) + outer(pivot * by_v, by_v)
    return Border(C, V, by_v, pivot, ldl(own, np.diag(own), NULL))


def _residual(blocks: Sequence[Block], e: Array, price: Scalar, at: Iterate) -> Scalar:
    """Return the largest residual of the optimality conditions; see `Distributed`."""

    def of_block(block: Block, own: BlockPoint) -> tuple[Array, Scalar, Scalar]:
        gap = own.s @ own.z + total(s @ z for s, z in own.of_cones)
        price = total(own.z) + total(z[0] for _, z in own.of_cones)
        return gradient(block, own) + block.E.T @ at.nu, price, gap

    found = each(of_block, blocks, at.points)
    gap = total(gap for *_, gap in found) + at.v * at.z
    of_v = at.v + price - at.z - total(price for _, price, _ in found)
    sizes = gradient_sizes(blocks, [left for left, *_ in found])
    dual = greatest([*sizes, abs(of_v)]) * reciprocal(1.0 + price)
    missing = total(block.E @ own.x for block, own in zip(blocks, at.points, strict=True)) - e
    return greatest([dual, gap * reciprocal(1.0 + price * at.v), abs(missing)])
