"""One block of the elastic programme: its cost and limits, its factors at an iterate, and its part of a step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, Scalar, concatenate, maximum, reciprocal, select
from holdfast.spatial.second_order_cone import ConeScaling, cone_scaling, step_rate

PIVOT_OF_ROUNDING = 3e-16  # relative to its entry, of which large curvatures of other directions were taken off
Predicted = tuple[Array, list[tuple[Array, Array]], Scalar]  # see `predicted`
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

    The last of them may be shared by all blocks: what they cost is the sum over the blocks.

    Attributes:
        P: (n, n) positive semidefinite; the sum over the blocks is definite.
        c: (n,).
        R: (m, n) rows with bounds.
        low, high: (m,) the bounds.
        cones: the limits that are cones.
        E: (rows, n).
        shared: number of the unknowns that all blocks share, the last ones.
    """

    P: Array
    c: Array
    R: Array
    low: Array
    high: Array
    cones: tuple[Cone, ...]
    E: Array
    shared: int = 0

    @property
    def own(self) -> int:
        """Number of the unknowns that it does not share."""
        return len(self.c) - self.shared

    def with_rows(self, used: Array) -> Block:
        """Return the block with those coupling rows alone that are 1 in `used`, (rows,)."""
        return self._replace(E=(self.E.T * used).T)

    def pull(self, z: Array, of_cones: Iterable[Array]) -> Array:
        """Return G' z, (n,), for multipliers of bounds and of cones."""
        m = len(self.low)
        return self.R.T @ (z[:m] - z[m:]) + total(cone.G.T @ z for cone, z in zip(self.cones, of_cones, strict=True))


class BlockPoint(NamedTuple):
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

    @property
    def multipliers(self) -> Array:
        """Those of bounds, and the first entries of those of cones, which are their products with [1, 0, ..]."""
        return concatenate([self.z, [z[0] for _, z in self.of_cones]])

    def moved(self, length: Scalar, by: BlockPoint, moves: Scalar) -> BlockPoint:
        """Return the point moved by a multiple of a step, or itself."""
        go = lambda x, d: select(moves, x + length * d, x)  # noqa: E731
        pairs = zip(self.of_cones, by.of_cones, strict=True)
        cones = tuple([(go(s, ds), go(z, dz)) for (s, z), (ds, dz) in pairs])
        return BlockPoint(go(self.x, by.x), go(self.s, by.s), go(self.z, by.z), cones)


class BlockFactors(NamedTuple):
    """What both directions need of a block.

    Attributes:
        product: (2 m,) 1 / (s z).
        slack: (2 m,) 1 / s.
        scalings: those of the cones.
        squares: W^-2 of each cone.
        gradient: (n,) P x + c.
        pull: (n,) G' z.
        C: (own, own) Cholesky factor of H = P + G' W^-2 G without the shared unknowns.
        V: (own, rows + shared + 1) C^-1 [E', H_shared, H_v].
        of_shared: (shared, rows + shared + 1) these columns in the rows of the shared unknowns.
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
    of_shared: Array
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


def gradient(block: Block, at: BlockPoint) -> Array:
    """Return P x + c + G' z, (n,)."""
    return block.P @ at.x + block.c + block.pull(at.z, [z for _, z in at.of_cones])


def gradient_sizes(blocks: Sequence[Block], gradients: Sequence[Array]) -> list[Array]:
    """Return the sizes of all entries of gradients (n,); those of shared unknowns add up."""
    shared = total(g[block.own :] for block, g in zip(blocks, gradients, strict=True))
    return [*(abs(g[: block.own]) for block, g in zip(blocks, gradients, strict=True)), abs(shared)]


def factorised(block: Block, at: BlockPoint) -> BlockFactors:
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
    own = block.own
    C = cholesky(H[:own, :own], PIVOT_OF_ROUNDING * np.diag(H)[:own])
    columns = np.concatenate([block.E, H[own:], [of_v]]).T
    return BlockFactors(
        product,
        slack,
        scalings,
        squares,
        block.P @ x + block.c,
        block.pull(z, [z for _, z in of_cones]),
        C,
        forward_substitution(C, columns[:own]),
        columns[own:],
        total(up + down) + total(W[0, 0] for W in squares),
        total(z) + total(z[0] for _, z in of_cones),
        s @ z + total(s @ z for s, z in of_cones),
    )


def change(f: BlockFactors, half: Array, shared: Array) -> Array:
    """Return dx, (n,), for a half-solved right-hand side (own,) and the step of the shared unknowns."""
    return concatenate([back_substitution(f.C, half), shared])


def step_ends(block: Block, dx: Array, dv: Scalar) -> Ends:
    """Return dx, and ds of bounds and of cones."""
    along, by_v = block.R @ dx, [-(cone.G @ dx) for cone in block.cones]
    return dx, concatenate([dv - along, dv + along]), [concatenate([[ds[0] + dv], ds[1:]]) for ds in by_v]


def predicted(at: BlockPoint, f: BlockFactors, ends: Ends) -> Predicted:
    """Return the predictor's ds / s of bounds, ds and dz of cones, and the inverse of the longest step."""
    _, ds, of_cones = ends
    ratio = ds * f.slack
    pairs = zip(f.squares, of_cones, at.of_cones, strict=True)
    steps = [(ds, -(W @ ds) - z) for W, ds, (_, z) in pairs]
    return ratio, steps, greatest([-ratio, 1.0 + ratio, *_cone_rates(at, f, steps)])


def _cone_rates(at: BlockPoint, f: BlockFactors, steps: Iterable[tuple[Array, Array]]) -> list[Scalar]:
    found: list[Scalar] = []
    for w, (s, z), (ds, dz) in zip(f.scalings, at.of_cones, steps, strict=True):
        found += [step_rate(s, w.of_s, ds), step_rate(z, w.of_z, dz)]
    return found


def right_side(
    centre: Scalar, second: Scalar, of_bounds: Scalar, block: Block, at: BlockPoint, f: BlockFactors, ahead: Predicted
) -> Wanted:
    """Return the corrector's right-hand side of a block.

    u = z + W^-1 (second W^-1 ds o W dz - centre [1, 0, ..]) / (W z), with `of_bounds` in place of `second` for bounds.
    """
    ratio, steps, _ = ahead
    factor = 1.0 - of_bounds * (ratio * (1.0 + ratio)) - centre * f.product
    pairs = zip(f.scalings, at.of_cones, steps, strict=True)
    of_cones = [z + w.corrected(second * ds, dz, centre) for w, (_, z), (ds, dz) in pairs]
    u = at.z * factor
    return Wanted(factor, of_cones, block.pull(u, of_cones), total(u) + total(u[0] for u in of_cones))


def corrected(at: BlockPoint, f: BlockFactors, wanted: Wanted, ends: Ends) -> tuple[BlockPoint, Scalar]:
    """Return the corrector's step of a block, and the inverse of the longest step."""
    dx, ds, of_cones = ends
    ratio = ds * f.slack
    steps = [(ds, -(W @ ds) - u) for W, ds, u in zip(f.squares, of_cones, wanted.of_cones, strict=True)]
    rates = greatest([-ratio, ratio + wanted.factor, *_cone_rates(at, f, steps)])
    return BlockPoint(dx, ds, -at.z * (ratio + wanted.factor), tuple(steps)), rates
