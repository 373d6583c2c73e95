"""An iteration of an interior-point method for programmes with second-order cones: an example of long straight code.

    min  sum_i 1/2 x_i' P_i x_i + c_i' x_i    s.t.   sum_i E_i x_i = e,   s_ij = h_ij - G_ij x_i in a cone of 4 numbers

Blocks i are coupled in six equations only, like arms that share a load. The step is Mehrotra's predictor-corrector step
with Nesterov-Todd scaling: every block is factorised alone, and the six multipliers by their Schur complement.

Reference: Vandenberghe, "The CVXOPT linear and quadratic cone program solvers", 2010, sections 4 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.traced_chain import traced
from holdfast.compiler.schedule import External, Schedule
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each, maximum, minimum, reciprocal, sqrt

BLOCKS, UNKNOWNS, CONES, COUPLED = 2, 6, 2, 6
DATA = {
    "P": (BLOCKS, UNKNOWNS, UNKNOWNS),
    "c": (BLOCKS, UNKNOWNS),
    "G": (BLOCKS, CONES, 4, UNKNOWNS),
    "h": (BLOCKS, CONES, 4),
    "E": (BLOCKS, COUPLED, UNKNOWNS),
    "e": (COUPLED,),
}
ITERATE = {"x": (BLOCKS, UNKNOWNS), "s": (BLOCKS, CONES, 4), "z": (BLOCKS, CONES, 4), "nu": (COUPLED,)}
DEGREE = BLOCKS * CONES
EXTERNALS: dict[str, External] = {
    **{name: External(shape, "input") for name, shape in (DATA | ITERATE).items()},
    **{f"next_{name}": External(shape, "output") for name, shape in ITERATE.items()},
}
UNIT = np.eye(4)[0]
FRACTION = 0.99  # of the way to the boundary


def schedule() -> Schedule:
    """Return the iteration as the compiler runs it."""
    return traced(EXTERNALS, lambda given: {f"next_{name}": x for name, x in iteration(given).items()})


def example(seed: int) -> dict[str, Array]:
    """Return the numbers of a programme that has a solution, and a point from which to start, by name."""
    random = np.random.default_rng(seed)
    given = {name: random.normal(size=shape) for name, shape in DATA.items()}
    given["P"] = np.broadcast_to(np.eye(UNKNOWNS), DATA["P"])
    inside = random.normal(size=ITERATE["x"])
    start = np.broadcast_to(2.0 * UNIT, ITERATE["s"])
    given["h"] = np.einsum("ijkl,il->ijk", given["G"], inside) + start
    given["e"] = np.einsum("ikl,il->k", given["E"], inside)
    return given | {"x": np.zeros(ITERATE["x"]), "s": start, "z": start / 4.0, "nu": np.zeros(COUPLED)}


class Scaling(NamedTuple):
    """The symmetric matrix W of a cone with W z = W^-1 s.

    Attributes:
        w: its direction, w0^2 - |w1|^2 = 1.
        eta: its size.
        inverse: 1 / eta.
    """

    w: Array
    eta: Scalar
    inverse: Scalar

    def times(self, x: Array) -> Array:
        """Return W x."""
        return self.eta * self._turned(x, 1.0)

    def over(self, x: Array) -> Array:
        """Return W^-1 x."""
        return self.inverse * self._turned(x, -1.0)

    def _turned(self, x: Array, sign: float) -> Array:
        w0, w1 = self.w[0], sign * self.w[1:]
        along = w1 @ x[1:]
        return concatenate([[w0 * x[0] + along], x[1:] + (x[0] + along * reciprocal(1.0 + w0)) * w1])


def scaling(s: Array, z: Array) -> Scaling:
    """Return the scaling of Nesterov and Todd."""
    of_s, of_z = sqrt(determinant(s)), sqrt(determinant(z))
    a, b = s * reciprocal(of_s), z * reciprocal(of_z)
    half = reciprocal(sqrt(2.0 + 2.0 * (a @ b)))
    eta = sqrt(of_s * reciprocal(of_z))
    return Scaling(concatenate([[(a[0] + b[0]) * half], (a[1:] - b[1:]) * half]), eta, reciprocal(eta))


def determinant(x: Array) -> Scalar:
    """Return x0^2 - |x1|^2."""
    size = sqrt(x[1:] @ x[1:])
    return (x[0] - size) * (x[0] + size)


def product(a: Array, b: Array) -> Array:
    """Return the product of the cone's algebra."""
    return concatenate([[a @ b], a[0] * b[1:] + b[0] * a[1:]])


def quotient(a: Array, b: Array) -> Array:
    """Return x with product(a, x) = b."""
    first = (a[0] * b[0] - a[1:] @ b[1:]) * reciprocal(determinant(a))
    return concatenate([[first], (b[1:] - first * a[1:]) * reciprocal(a[0])])


def rate(x: Array, step: Array) -> Scalar:
    """Return the inverse of the largest multiple of a step that stays in the cone, negative if there is none."""
    inverse = reciprocal(sqrt(determinant(x)))
    a = x * inverse
    along = a[0] * step[0] - a[1:] @ step[1:]
    across = step[1:] - ((along + step[0]) * reciprocal(1.0 + a[0])) * a[1:]
    return (sqrt(across @ across) - along) * inverse


class Block(NamedTuple):
    """What both directions need of a block: data, scalings, residuals, and factors of P + G' W^-2 G."""

    G: Array
    E: Array
    W: list[Scaling]
    rx: Array
    rz: list[Array]
    C: Array
    V: Array  # C^-1 E'


def iteration(given: Mapping[str, Array]) -> dict[str, Array]:
    """Return the next iterate."""
    x, s, z, nu, e = (given[name] for name in ("x", "s", "z", "nu", "e"))

    def begin(P: Array, c: Array, G: Array, h: Array, E: Array, x: Array, s: Array, z: Array) -> Block:
        W = [scaling(*pair) for pair in zip(s, z, strict=True)]
        scaled = [array([w.over(column) for column in g.T]) for w, g in zip(W, G, strict=True)]  # G' W^-1
        C = cholesky(P + sum(g @ g.T for g in scaled))
        rx = P @ x + c + E.T @ nu + sum(g.T @ y for g, y in zip(G, z, strict=True))
        rz = [y + g @ x - b for y, g, b in zip(s, G, h, strict=True)]
        return Block(G, E, W, rx, rz, C, forward_substitution(C, E.T))

    blocks = each(begin, *(given[name] for name in ("P", "c", "G", "h", "E")), x, s, z)
    re: Any = sum(block.E @ own for block, own in zip(blocks, x, strict=True)) - e
    gap = sum(a @ b for some in zip(s, z, strict=True) for a, b in zip(*some, strict=True))
    S = cholesky(sum((block.V.T @ block.V for block in blocks), start=np.zeros((COUPLED, COUPLED))))

    def direction(kept: Scalar, d: list[list[Array]]) -> tuple[list[Any], Array]:
        """Return the steps dx, ds, dz of every block and dnu, for W dz + W^-1 ds = -d."""

        def right(block: Block, d: list[Array]) -> Array:
            rows = zip(block.G, block.W, block.rz, d, strict=True)
            known: Any = sum((g.T @ w.over(w.over(kept * r) - v) for g, w, r, v in rows), start=kept * block.rx)
            return forward_substitution(block.C, -known)

        half = each(right, blocks, d)
        summed: Any = sum((block.V.T @ y for block, y in zip(blocks, half, strict=True)), start=kept * re)
        dnu = back_substitution(S, forward_substitution(S, summed))

        def ends(block: Block, y: Array, d: list[Array]) -> tuple[Array, list[Array], list[Array]]:
            dx = back_substitution(block.C, y - block.V @ dnu)
            ds = [-kept * r - g @ dx for g, r in zip(block.G, block.rz, strict=True)]
            dz = [-w.over(w.over(step) + v) for w, step, v in zip(block.W, ds, d, strict=True)]
            return dx, ds, dz

        return each(ends, blocks, half, d), dnu

    def longest(steps: list[Any]) -> Scalar:
        """Return the largest step up to 1 that stays in all cones."""
        largest: Scalar = 1.0
        for some, others, (_, ds, dz) in zip(s, z, steps, strict=True):
            for point, step in [*zip(some, ds, strict=True), *zip(others, dz, strict=True)]:
                largest = maximum(largest, rate(point, step))
        return reciprocal(largest)

    on: Callable[..., Any] = lambda block, z: [w.times(y) for w, y in zip(block.W, z, strict=True)]  # noqa: E731
    points = each(on, blocks, z)
    steps, _ = direction(1.0, points)
    left = 1.0 - longest(steps)
    sigma = left * left * left
    centre = sigma * gap * (1.0 / DEGREE) * UNIT

    def corrected(block: Block, points: list[Array], step: tuple[Array, list[Array], list[Array]]) -> list[Array]:
        rows = zip(block.W, points, *step[1:], strict=True)
        return [y + quotient(y, product(w.over(ds), w.times(dz)) - centre) for w, y, ds, dz in rows]

    steps, dnu = direction(1.0 - sigma, each(corrected, blocks, points, steps))
    length = minimum(1.0, FRACTION * longest(steps))
    dx, ds, dz = (array([[*rows] for rows in some]) for some in zip(*steps, strict=True))
    return {"x": x + length * dx, "s": s + length * ds, "z": z + length * dz, "nu": nu + length * dnu}
