"""The elastic programme of force distribution, by an interior point of fixed length.

    min   sum_i (1/2 x_i' P_i x_i + c_i' x_i) + rho v + 1/2 v^2
    s.t.  sum_i E_i x_i = e,   low_i - v <= R_i x_i <= high_i + v,   h_ij - G_ij x_i + v [1, 0, ..] in a cone,   v >= 0

Blocks i are arms. They are coupled in the rows of E and in v only, so each is factorised alone, and what is left are as
many equations as E has rows, and one for v. Every limit gives way by v at the price rho, so there is always a solution;
v = 0 where the limits can be kept, as long as rho exceeds the sum of their multipliers (exact penalty).

Slacks are s = h - G x + v from the start, and steps keep that. In the right-hand sides, W^-2 s is z by the definition of
the scaling W. It is used as known: computed, it would lose the digits that W^-2 magnifies.

References: Mehrotra, "On the implementation of a primal-dual interior point method", 1992; Nesterov and Todd,
"Self-scaled barriers and interior-point methods for convex programming", 1997; Boyd and Wegbreit, "Fast computation of
optimal contact forces", 2007.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.forces.second_order_cone import ConeScaling, cone_inverse, cone_scaling, step_rate
from holdfast.spatial.linalg import MaskedLDL, back_substitution, cholesky, forward_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import (
    Array,
    Scalar,
    array,
    concatenate,
    each,
    maximum,
    reciprocal,
    scan,
    select,
    sqrt,
    where,
)

ITERATIONS = 16
SOLVED = 1e-9  # residual at which the iterate is kept
COUPLED = 1e-12  # residual of the coupling rows at which it is
FRACTION = 0.99  # of the way to the boundary
NULL = 1e-30  # a pivot of the coupling rows that counts as zero, relative to its row

Ends = tuple[Array, Array, list[Array]]  # dx, and ds of bounds and of cones


class Cone(NamedTuple):
    """The limit h - G x + v [1, 0, ..] in the cone s_0 >= |s_1|.

    Attributes:
        G: (d, n).
        h: (d,).
    """

    G: Array
    h: Array


class Block(NamedTuple):
    """The unknowns of one arm: their cost, their limits and their part in the coupling rows.

    Attributes:
        P: (n, n) positive definite.
        c: (n,).
        R: (m, n) rows with bounds.
        low, high: (m,) the bounds.
        cones: the limits that are cones.
        E: (rows, n).
    """

    P: Array
    c: Array
    R: Array
    low: Array
    high: Array
    cones: tuple[Cone, ...]
    E: Array

    def pull(self, z: Array, of_cones: Iterable[Array]) -> Array:
        """Return G' z, (n,), for multipliers of bounds and of cones."""
        m = len(self.low)
        return self.R.T @ (z[:m] - z[m:]) + total(cone.G.T @ z for cone, z in zip(self.cones, of_cones, strict=True))


class Point(NamedTuple):
    """The unknowns of a block with the slacks and multipliers of its limits, or a step of them.

    Attributes:
        x: (n,).
        s, z: (2 m,) of the upper bounds, then of the lower ones.
        of_cones: slack and multiplier of each cone.
    """

    x: Array
    s: Array
    z: Array
    of_cones: tuple[tuple[Array, Array], ...]

    def moved(self, length: Scalar, by: Point, moves: Scalar) -> Point:
        """Return the point moved by a multiple of a step, or itself."""
        go = lambda x, d: select(moves, x + length * d, x)  # noqa: E731
        pairs = zip(self.of_cones, by.of_cones, strict=True)
        cones = tuple([(go(s, ds), go(z, dz)) for (s, z), (ds, dz) in pairs])
        return Point(go(self.x, by.x), go(self.s, by.s), go(self.z, by.z), cones)


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

    points: Sequence[Point]
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
    """

    x: list[Array]
    v: Scalar
    residual: Scalar


class Factors(NamedTuple):
    """What both directions need of a block.

    Attributes:
        product: (2 m,) 1 / (s z).
        slack: (2 m,) 1 / s.
        scalings: those of the cones.
        squares: W^-2 of each cone.
        gradient: (n,) P x + c.
        pull: (n,) G' z.
        C: (n, n) Cholesky factor of H = P + G' W^-2 G.
        V: (n, rows + 1) C^-1 [E', H_v].
        stiffness: of v, B' W^-2 B.
        price: B' z.
        gap: s' z.
    """

    product: Array
    slack: Array
    scalings: list[ConeScaling]
    squares: list[Array]
    gradient: Array
    pull: Array
    C: Array
    V: Array
    stiffness: Scalar
    price: Scalar
    gap: Scalar


class Wanted(NamedTuple):
    """The right-hand side u of a corrector.

    Attributes:
        factor: (2 m,) u / z of bounds.
        of_cones: u of each cone.
        pull: (n,) G' u.
        price: B' u.
    """

    factor: Array
    of_cones: list[Array]
    pull: Array
    price: Scalar


class Border(NamedTuple):
    """The equations for v and the multipliers of the coupling rows that the factorised blocks leave.

    Attributes:
        S: (rows + 1, rows + 1) sum of V' V.
        factors: those of its first rows.
        column: (rows,) the multipliers that v brings with it.
        pivot: the inverse of what is left for v.
    """

    S: Array
    factors: MaskedLDL
    column: Array
    pivot: Scalar

    def solved(self, sums: Array, missing: Array, right: Scalar) -> tuple[Scalar, Array]:
        """Return dv, and the multipliers after the step.

        Args:
            sums: (rows + 1,) sum of V' y over the blocks' half-solved right-hand sides y.
            missing: (rows,) what the step takes off the coupling rows.
            right: right-hand side of v.
        """
        r = len(missing)
        through = ldl_solve(self.factors, sums[:r] + missing)
        dv = self.pivot * (right - sums[r] + self.S[r, :r] @ through)
        return dv, through - dv * self.column


def solve(blocks: Sequence[Block], e: Array, price: Scalar, iterations: int = ITERATIONS) -> Distributed:
    """Return the solution of the elastic programme. O(blocks).

    Args:
        blocks: the blocks.
        e: (rows,) right-hand side of the coupling rows.
        price: rho.
        iterations: how many.
    """
    known = total(block.E @ block.E.T for block in blocks)
    kept = array([where(pivot > 0.0, 1.0, 0.0) for pivot in ldl(known, np.diag(known)).pivots])
    full = blocks, e
    blocks, e = [block._replace(E=(block.E.T * kept).T) for block in blocks], kept * e
    begin = _start(blocks, len(e), price)
    first = maximum(begin.v, greatest(each(_gradient, blocks, begin.points)))
    last, _ = scan(lambda at, _: (_advanced(blocks, e, kept, price, first, at), None), begin, [None] * iterations)
    return Distributed([at.x for at in last.points], last.v, _residual(*full, price, last))


def total(values: Iterable[Any]) -> Any:
    """Return the sum."""
    return reduce(lambda a, b: a + b, values, 0.0)


def greatest(values: Iterable[Any]) -> Scalar:
    """Return the largest of all entries of arrays and of scalars, at least 0."""
    found = [0.0, *(x for value in values for x in np.ravel(value))]
    while len(found) > 1:  # in pairs, which need not wait for each other
        odd = found[-1:] if len(found) % 2 else []
        found = [maximum(a, b) for a, b in zip(found[::2], found[1::2], strict=False)] + odd
    return found[0]


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

    def point(block: Block, s: Array, of_cones: list[Array]) -> Point:
        return Point(0.0 * block.c, s, mu * reciprocal(s), tuple([(x, mu * cone_inverse(x)) for x in of_cones]))

    points = each(point, blocks, [s for s, *_ in found], [of_cones for _, of_cones, _ in found])
    return Iterate(points, v, mu * reciprocal(v), np.zeros(rows), 1.0, 1.0)


def _gradient(block: Block, at: Point) -> Array:
    """Return |P x + c + G' z|, (n,)."""
    return abs(block.P @ at.x + block.c + block.pull(at.z, [z for _, z in at.of_cones]))


def _advanced(blocks: Sequence[Block], e: Array, kept: Array, price: Scalar, first: Scalar, at: Iterate) -> Iterate:
    """Return the next iterate: a step of Mehrotra's predictor and corrector.

    Args:
        blocks: the blocks.
        e: (rows,) right-hand side of the coupling rows.
        price: rho.
        first: size of the dual residual at the start, which every step reduces by the same factor.
        at: the iterate.
    """
    points, v, z, nu, left, still = at
    of = each(_factors, blocks, points)
    missing = total(block.E @ own.x for block, own in zip(blocks, points, strict=True)) - e
    degree = 1 + sum(2 * len(block.low) + len(block.cones) for block in blocks)
    gap = total(f.gap for f in of) + v * z
    product = reciprocal(v * z)
    border = _border(of, 1.0 + z * z * product, kept)

    def direction(kept: Scalar, right: list[Array], of_v: Scalar) -> tuple[list[Ends], Scalar, Array]:
        """Return dx and ds of every block, dv, and the multipliers after the step."""
        halves = each(lambda f, b: forward_substitution(f.C, b), of, right)
        sums = total(f.V.T @ y for f, y in zip(of, halves, strict=True))
        dv, after = border.solved(sums, kept * missing, of_v)
        return each(lambda block, f, y: _ends(block, f, y, dv, after), blocks, of, halves), dv, after

    steps, dv, _ = direction(1.0, [-f.gradient for f in of], -(v + price))
    ratio = dv * product * z
    ahead = each(_predicted, points, of, steps)
    longest = reciprocal(greatest([1.0, -ratio, 1.0 + ratio, *(rates for *_, rates in ahead)]))
    less = 1.0 - longest
    sigma = less * less * less
    centre, kept = sigma * gap * (1.0 / degree), 1.0 - sigma

    factor = 1.0 - ratio * (1.0 + ratio) - centre * product
    wanted = each(lambda *given: _wanted(*given, centre), blocks, points, of, ahead)
    right = [u.pull - kept * (f.gradient + f.pull) for u, f in zip(wanted, of, strict=True)]
    own = v + price - z - total(f.price for f in of)
    steps, dv, after = direction(kept, right, -kept * own - z * factor - total(u.price for u in wanted))
    ratio = dv * product * z
    found = each(_corrected, points, of, wanted, steps)
    rates = greatest([FRACTION, -ratio, ratio + factor, *(rates for _, rates in found)])
    length = FRACTION * reciprocal(rates)

    scaled = maximum(first * left * reciprocal(1.0 + price), gap * reciprocal(1.0 + price * v))
    open_ = maximum(scaled * (1.0 / SOLVED), greatest([abs(missing)]) * (1.0 / COUPLED))
    still = where(open_ < 1.0, 0.0, still)
    moves = still * length > 0.0  # not where a number is not finite
    made = each(lambda own, step: own.moved(length, step, moves), points, [step for step, _ in found])
    changed = array([v + length * dv, z - length * z * (ratio + factor), left * (1.0 - length * kept)])
    v, z, left = select(moves, changed, array([v, z, left]))
    return Iterate(made, v, z, select(moves, nu + length * (after - kept * nu), nu), left, still)


def _factors(block: Block, at: Point) -> Factors:
    """Return what both directions need of a block."""
    m, (x, s, z, of_cones) = len(block.low), at
    product = reciprocal(s * z)  # one division for 1 / s and 1 / z
    slack = product * z
    up, down = (z * slack)[:m], (z * slack)[m:]
    scalings = [cone_scaling(*pair) for pair in of_cones]
    squares = [w.inverse_square for w in scalings]
    pairs = [(cone.G, W) for cone, W in zip(block.cones, squares, strict=True)]
    H = block.P + (block.R.T * (up + down)) @ block.R + total(G.T @ (W @ G) for G, W in pairs)
    of_v = block.R.T @ (down - up) - total(G.T @ W[0] for G, W in pairs)
    C = cholesky(H)
    return Factors(
        product,
        slack,
        scalings,
        squares,
        block.P @ x + block.c,
        block.pull(z, [z for _, z in of_cones]),
        C,
        forward_substitution(C, np.concatenate([block.E, [of_v]]).T),
        total(up + down) + total(W[0, 0] for W in squares),
        total(z) + total(z[0] for _, z in of_cones),
        s @ z + total(s @ z for s, z in of_cones),
    )


def _border(of: Sequence[Factors], stiffness: Scalar, kept: Array) -> Border:
    """Return the equations that the factorised blocks leave.

    Args:
        of: the blocks' factors.
        stiffness: of v, without the blocks.
        rows: number of coupling rows.
    """
    S, rows = total(f.V.T @ f.V for f in of), len(kept)
    own = S[:rows, :rows] + np.diag(1.0 - kept)
    factors = ldl(own, np.diag(own), NULL)
    column = ldl_solve(factors, S[rows, :rows])
    left = stiffness + total(f.stiffness for f in of) - S[rows, rows] + S[rows, :rows] @ column
    return Border(S, factors, column, reciprocal(left))


def _ends(block: Block, f: Factors, half: Array, dv: Scalar, after: Array) -> tuple[Array, Array, list[Array]]:
    """Return dx, and ds of bounds and of cones."""
    dx = back_substitution(f.C, half - f.V @ concatenate([after, [dv]]))
    along, by_v = block.R @ dx, [-(cone.G @ dx) for cone in block.cones]
    return dx, concatenate([dv - along, dv + along]), [concatenate([[ds[0] + dv], ds[1:]]) for ds in by_v]


def _predicted(at: Point, f: Factors, ends: Ends) -> tuple[Array, list[tuple[Array, Array]], Scalar]:
    """Return the predictor's ds / s of bounds, ds and dz of cones, and the inverse of the longest step."""
    _, ds, of_cones = ends
    ratio = ds * f.slack
    pairs = zip(f.squares, of_cones, at.of_cones, strict=True)
    steps = [(ds, -(W @ ds) - z) for W, ds, (_, z) in pairs]
    return ratio, steps, greatest([-ratio, 1.0 + ratio, *_cone_rates(at, f, steps)])


def _cone_rates(at: Point, f: Factors, steps: Iterable[tuple[Array, Array]]) -> list[Scalar]:
    found: list[Scalar] = []
    for w, (s, z), (ds, dz) in zip(f.scalings, at.of_cones, steps, strict=True):
        found += [step_rate(s, w.of_s, ds), step_rate(z, w.of_z, dz)]
    return found


def _wanted(
    block: Block, at: Point, f: Factors, ahead: tuple[Array, list[tuple[Array, Array]], Scalar], centre: Scalar
) -> Wanted:
    """Return the corrector's right-hand side u = z + W^-1 (..) of a block."""
    ratio, steps, _ = ahead
    factor = 1.0 - ratio * (1.0 + ratio) - centre * f.product
    pairs = zip(f.scalings, at.of_cones, steps, strict=True)
    of_cones = [z + w.corrected(ds, dz, centre) for w, (_, z), (ds, dz) in pairs]
    u = at.z * factor
    return Wanted(factor, of_cones, block.pull(u, of_cones), total(u) + total(u[0] for u in of_cones))


def _corrected(at: Point, f: Factors, wanted: Wanted, ends: Ends) -> tuple[Point, Scalar]:
    """Return the corrector's step of a block, and the inverse of the longest step."""
    dx, ds, of_cones = ends
    ratio = ds * f.slack
    steps = [(ds, -(W @ ds) - u) for W, ds, u in zip(f.squares, of_cones, wanted.of_cones, strict=True)]
    rates = greatest([-ratio, ratio + wanted.factor, *_cone_rates(at, f, steps)])
    return Point(dx, ds, -at.z * (ratio + wanted.factor), tuple(steps)), rates


def _residual(blocks: Sequence[Block], e: Array, price: Scalar, at: Iterate) -> Scalar:
    """Return the largest residual of the optimality conditions; see `Distributed`."""

    def of_block(block: Block, own: Point) -> tuple[Scalar, Scalar, Scalar]:
        z = [z for _, z in own.of_cones]
        gradient = block.P @ own.x + block.c + block.pull(own.z, z) + block.E.T @ at.nu
        gap = own.s @ own.z + total(s @ z for s, z in own.of_cones)
        return greatest([abs(gradient)]), total(own.z) + total(x[0] for x in z), gap

    found = each(of_block, blocks, at.points)
    gap = total(gap for *_, gap in found) + at.v * at.z
    of_v = at.v + price - at.z - total(price for _, price, _ in found)
    dual = greatest([*(gradient for gradient, *_ in found), abs(of_v)]) * reciprocal(1.0 + price)
    missing = total(block.E @ own.x for block, own in zip(blocks, at.points, strict=True)) - e
    return greatest([dual, gap * reciprocal(1.0 + price * at.v), abs(missing)])
