"""Convex quadratic programmes over second-order cones, by an interior point method that ends in an answer or a proof.

    minimise 1/2 x'P x + c'x  subject to  h - G x = s,  s in K = R+^rows x Q x ... x Q,   Q: s_0 >= |s_1|

The homogeneous embedding in (x, s, z, tau, kappa) with P x + G'z + c tau = 0, G x + s = h tau and
x'P x / tau + c'x + h'z = -kappa always has a solution: one with tau > 0 solves the programme; one with kappa > 0
contains a z in K with G'z = 0 and h'z < 0, which proves that there is none, or a direction in which the value falls for
ever. Steps are Mehrotra's, predictor and corrector, in Nesterov and Todd's scaling W with W z = W^-1 s.

W^-2 s = z is known and never computed: right sides contain W^-2 (r - s), whose part W^-2 s would lose all digits as s
tends to zero.

Reference:
    E. Andersen, Y. Ye, On a homogeneous algorithm for the monotone complementarity problem, 1999; Y. Nesterov, M. Todd,
    Self-scaled barriers, 1997; P. Goulart, Y. Chen, Clarabel, 2024.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar

REACHED_RESIDUAL = 1e-7  # largest relative residual of a solution or a proof
GOAL = 1e-12  # steps go on to this residual while they help
MOST_CONE_STEPS = 60
WAITING = 4  # steps without progress before the best point counts
PIVOT_ROUNDING = (0.0, 1e-15, 1e-13, 1e-11, 1e-9)  # relative enlargements of a diagonal whose pivots round to 0
STEP_SHARE = 0.99  # of the longest step


class Verdict(Enum):
    """The end of a search."""

    OPTIMAL = "optimal"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    UNDECIDED = "undecided"


class Cones(NamedTuple):
    """K: `rows` numbers >= 0, then `number` second-order cones of `size` numbers each.

    Smaller cones are filled up with zeros, which change nothing.
    """

    rows: int
    number: int
    size: int

    @property
    def degree(self) -> int:
        """Number of complementarity conditions."""
        return self.rows + self.number

    def parts(self, s: Array) -> tuple[Array, Array]:
        """Return the orthant's part (rows,) and the cones' (number, size)."""
        return s[: self.rows], s[self.rows :].reshape(self.number, self.size)

    def joined(self, a: Array, b: Array) -> Array:
        """Return one vector from the parts."""
        return np.concatenate([a, b.ravel()])

    @property
    def unit(self) -> Array:
        """The unit of the Jordan algebra: 1 in the orthant, (1, 0) in each cone."""
        e = np.zeros((self.number, self.size))
        e[:, :1] = 1.0
        return self.joined(np.ones(self.rows), e)

    def depth(self, s: Array) -> float:
        """Return how far s is inside K: the least of s_j and s_0 - |s_1|; negative outside."""
        a, b = self.parts(s)
        return float(np.concatenate([a, b[:, 0] - np.linalg.norm(b[:, 1:], axis=1)]).min(initial=np.inf))

    def product(self, s: Array, t: Array) -> Array:
        """Return the Jordan product s o t."""
        (a, b), (c, d) = self.parts(s), self.parts(t)
        found = b[:, :1] * d + d[:, :1] * b
        found[:, 0] = (b * d).sum(axis=1)
        return self.joined(a * c, found)

    def quotient(self, s: Array, t: Array) -> Array:
        """Return x with s o x = t."""
        (a, b), (c, d) = self.parts(s), self.parts(t)
        first = (b[:, 0] * d[:, 0] - (b[:, 1:] * d[:, 1:]).sum(axis=1)) / _determinant(b)
        found = (d - first[:, None] * b) / b[:, :1]
        found[:, 0] = first
        return self.joined(c / a, found)

    def longest(self, s: Array, d: Array) -> float:
        """Return the largest t with s + t d in K, infinite if there is no end."""
        (a, b), (da, db) = self.parts(s), self.parts(d)
        root = np.sqrt(_determinant(b))
        u = b / root[:, None]
        first = u[:, 0] * db[:, 0] - (u[:, 1:] * db[:, 1:]).sum(axis=1)
        rest = db[:, 1:] - u[:, 1:] * ((first + db[:, 0]) / (1.0 + u[:, 0]))[:, None]
        rates = np.concatenate([-da / a, (np.linalg.norm(rest, axis=1) - first) / root])
        worst = float(rates.max(initial=0.0))
        return 1.0 / worst if worst > 0.0 else np.inf


class ConeProgramme(NamedTuple):
    """minimise 1/2 x'P x + c'x subject to h - G x in K."""

    P: Array
    c: Array
    G: Array
    h: Array
    cones: Cones


class ConeAnswer(NamedTuple):
    """The answer to a programme.

    Attributes:
        verdict: how the search ended.
        x: (k,) the solution; for an unbounded programme the direction in which the value falls, scaled to c'x = -1.
        s: (m,) h - G x in K.
        z: (m,) multipliers in K; for an infeasible programme the proof, scaled to h'z = -1.
        value: 1/2 x'P x + c'x.
        residual: largest relative residual of the conditions, or of the proof.
        steps: number of steps.
    """

    verdict: Verdict
    x: Array
    s: Array
    z: Array
    value: float
    residual: float
    steps: int


class _Point(NamedTuple):
    x: Array
    s: Array
    z: Array
    tau: Scalar
    kappa: Scalar

    def times(self, c: float) -> _Point:
        """Return a multiple of the point."""
        return _Point(c * self.x, c * self.s, c * self.z, c * self.tau, c * self.kappa)

    def moved(self, step: float, d: _Point) -> _Point:
        """Return the point after a step along d."""
        s, z = self.s + step * d.s, self.z + step * d.z
        return _Point(self.x + step * d.x, s, z, self.tau + step * d.tau, self.kappa + step * d.kappa)


class _Scaling:
    """W of Nesterov and Todd for s and z inside K, with W z = W^-1 s = lam."""

    def __init__(self, cones: Cones, s: Array, z: Array) -> None:
        self.cones = cones
        (a, b), (c, d) = cones.parts(s), cones.parts(z)
        self.root = np.sqrt(a / c)
        of_s, of_z = (np.sqrt(_determinant(one))[:, None] for one in (b, d))
        b, d = b / of_s, d / of_z
        w = b - d
        w[:, 0] = b[:, 0] + d[:, 0]
        self.w = w / np.sqrt(2.0 * (1.0 + (b * d).sum(axis=1)))[:, None]
        self.eta = np.sqrt(of_s / of_z)
        self.lam = self.times(z)

    def times(self, x: Array, inverse: bool = False) -> Array:
        """Return W x, or W^-1 x."""
        a, b = self.cones.parts(x)
        first, rest = self.w[:, :1], -self.w[:, 1:] if inverse else self.w[:, 1:]
        along = (rest * b[:, 1:]).sum(axis=1, keepdims=True)
        turned = np.hstack([first * b[:, :1] + along, b[:, 1:] + rest * (b[:, :1] + along / (1.0 + first))])
        return self.cones.joined(
            *((a / self.root, turned / self.eta) if inverse else (a * self.root, turned * self.eta))
        )

    def over_square(self, x: Array) -> Array:
        """Return W^-2 x."""
        return self.times(self.times(x, True), True)

    def gram(self, G: Array) -> Array:
        """Return G'W^-2 G."""
        rows, number, size = self.cones
        A = G[:rows] / self.root[:, None]
        B = G[rows:].reshape(number, size, G.shape[1])
        flipped = self.w.copy()
        flipped[:, 1:] *= -1.0
        along = np.sqrt(2.0) * (flipped[:, None] @ B)[:, 0] / self.eta
        B = B / self.eta[:, :, None]
        H = A.T @ A + along.T @ along - B[:, 0].T @ B[:, 0]
        return H + np.tensordot(B[:, 1:], B[:, 1:], axes=([0, 1], [0, 1]))


@np.errstate(all="ignore")  # a step that overflows is not taken
def solve(programme: ConeProgramme) -> ConeAnswer:
    """Return the solution of a programme, or the proof that it has none. O(k^2 m) per step, some 12 steps.

    Args:
        programme: with P symmetric and positive semidefinite, and P + G'G regular.
    """
    P, c, G, h, cones = programme
    per_x = 1.0 / np.sqrt((G * G).sum(axis=0) + np.diag(P) + 1e-300)
    P, c, G = P * per_x[:, None] * per_x, c * per_x, G * per_x
    cost = 1.0 / max(float(np.abs(P).max(initial=0.0)), float(np.abs(c).max(initial=0.0)), 1e-300)
    units = ConeProgramme(cost * P, cost * c, G, h, cones)
    at = _start(units)
    best, least, waited, steps = at, (Verdict.UNDECIDED, np.inf), 0, 0
    while steps < MOST_CONE_STEPS:
        found = _residual(units, at)
        if found[1] < least[1]:
            waited = 0 if found[1] < 0.5 * least[1] else waited + 1
            best, least = at, found
        else:
            waited += 1
        if least[1] < GOAL or (waited >= WAITING and least[1] < REACHED_RESIDUAL):
            break
        following = _stepped(units, at)
        if following is None:
            break
        at, steps = following, steps + 1
    verdict = least[0] if least[1] <= REACHED_RESIDUAL else Verdict.UNDECIDED
    x, s, z = _normalised(units, best, verdict)
    x, z = x * per_x, z if verdict is Verdict.INFEASIBLE else z / cost
    if verdict is Verdict.UNBOUNDED:
        x, s = x * cost, s * cost
    value = float(0.5 * x @ programme.P @ x + programme.c @ x)
    return ConeAnswer(verdict, x, s, z, value, least[1], steps)


def _determinant(b: Array) -> Array:
    length = np.sqrt((b[:, 1:] * b[:, 1:]).sum(axis=1))
    return (b[:, 0] - length) * (b[:, 0] + length)


def _start(programme: ConeProgramme) -> _Point:
    """Return the least-squares solution of G x + s = h and its residual, moved into K."""
    P, c, G, h, cones = programme
    x = np.linalg.lstsq(P + G.T @ G, G.T @ h - c, rcond=None)[0]
    moved = []
    for v in (h - G @ x, G @ x - h):
        depth, wanted = cones.depth(v), max(1.0, 0.1 * float(np.abs(v).mean())) if len(v) else 1.0
        moved.append(v + (wanted - depth if depth < wanted else 0.0) * cones.unit)
    return _Point(x, moved[0], moved[1], 1.0, 1.0)


def _residual(programme: ConeProgramme, at: _Point) -> tuple[Verdict, float]:
    """Return what a point approximates best, and its relative residual."""
    P, c, G, h, _ = programme
    x, s, z, tau, kappa = at
    Px, Gx, Gz = P @ x, G @ x, G.T @ z
    large = [float(np.abs(v).max(initial=0.0)) for v in (c, h, Px, Gz, s)]
    primal = _size(Gx + s - h * tau) / tau / max(1.0, large[1], large[4] / tau)
    dual = _size(Px + Gz + c * tau) / tau / max(1.0, large[0], large[2] / tau, large[3] / tau)
    values = 0.5 * (x @ Px) / tau**2 + (c @ x) / tau, -0.5 * (x @ Px) / tau**2 - (h @ z) / tau
    gap = abs(values[0] - values[1]) / max(1.0, min(abs(values[0]), abs(values[1])))
    proofs: list[tuple[Verdict, float]] = [(Verdict.OPTIMAL, float(max(primal, dual, gap)))]
    if tau < kappa:
        if h @ z < 0.0:
            proofs.append((Verdict.INFEASIBLE, max(_size(Gz), _size(Px)) / float(-h @ z)))
        if c @ x < 0.0:
            proofs.append((Verdict.UNBOUNDED, max(_size(Gx + s), _size(Px)) / float(-c @ x)))
    return min(proofs, key=lambda one: one[1] if one[1] == one[1] else np.inf)


def _size(v: Array) -> float:
    return float(np.abs(v).max(initial=0.0))


def _stepped(programme: ConeProgramme, at: _Point) -> _Point | None:
    """Return the next point; None if rounding prevents one."""
    P, c, G, h, cones = programme
    x, s, z, tau, kappa = at
    Px = P @ x
    rx, rz = Px + G.T @ z + c * tau, G @ x + s - h * tau
    rt = kappa + x @ Px / tau + c @ x + h @ z
    mu = (s @ z + tau * kappa) / (cones.degree + 1)
    W = _Scaling(cones, s, z)
    L = _factor(P + W.gram(G))
    if L is None:
        return None

    def solved(a: Array, r: Array, y: Array) -> tuple[Array, Array]:
        """Return x, z with P x + G'z = a and G x - W^2 z = r + W^2 y."""
        b = a + G.T @ (W.over_square(r) + y)
        dx = np.linalg.solve(L.T, np.linalg.solve(L, b))
        return dx, W.over_square(G @ dx - r) - y

    xi, zeta = x / tau, z / tau
    slope = 2.0 * (P @ xi) + c
    if tau < kappa:
        x2, z2 = solved(-c, h, np.zeros_like(z))
        divisor = -kappa / tau - xi @ P @ xi + slope @ x2 + h @ z2
    else:  # the same less (x, z) / tau: near a solution the difference has all its digits
        x2, z2 = solved(-rx / tau, -rz / tau, 2.0 * zeta)
        divisor = (rt - 2.0 * kappa) / tau + slope @ x2 + h @ z2
        x2, z2 = x2 + xi, z2 + zeta

    def direction(part: float, more: Array, of_kappa: Scalar) -> _Point:
        u = W.times(more, True)
        x1, z1 = solved(-part * rx, -part * rz, z + u)
        dtau = (-part * rt + of_kappa / tau - slope @ x1 - h @ z1) / divisor
        dx, dz = x1 + dtau * x2, z1 + dtau * z2
        return _Point(dx, -part * rz - G @ dx + h * dtau, dz, dtau, -(of_kappa + kappa * dtau) / tau)

    d = direction(1.0, np.zeros_like(z), kappa * tau)
    sigma = (1.0 - min(1.0, _longest(cones, at, d))) ** 3
    crossed = cones.product(W.times(d.s, True), W.times(d.z)) - sigma * mu * cones.unit
    of_kappa = kappa * tau + d.tau * d.kappa - sigma * mu
    d = direction(1.0 - sigma, cones.quotient(W.lam, crossed), of_kappa)
    step = min(1.0, STEP_SHARE * _longest(cones, at, d))
    found = at.moved(step, d)
    scaled = found.times(1.0 / max(found.tau, found.kappa))
    finite = all(np.isfinite(one).all() for one in scaled)
    return scaled if finite and step > 0.0 and cones.depth(scaled.s) > 0.0 < cones.depth(scaled.z) else None


def _factor(H: Array) -> Array | None:
    """Return L with L L' = H, enlarged on its diagonal as little as rounding requires; None if H is not finite."""
    for more in PIVOT_ROUNDING:
        try:
            return np.linalg.cholesky(H + np.diag(more * np.diag(H)))
        except np.linalg.LinAlgError:
            continue
    return None


def _longest(cones: Cones, at: _Point, d: _Point) -> float:
    ends = [cones.longest(at.s, d.s), cones.longest(at.z, d.z)]
    ends += [-old / new for old, new in ((at.tau, d.tau), (at.kappa, d.kappa)) if new < 0.0]
    return min(ends)


def _normalised(programme: ConeProgramme, at: _Point, verdict: Verdict) -> tuple[Array, Array, Array]:
    """Return x, s and z of a solution, or of a proof scaled to h'z = -1 or c'x = -1."""
    if verdict is Verdict.INFEASIBLE:
        scale = float(-(programme.h @ at.z))
    elif verdict is Verdict.UNBOUNDED:
        scale = float(-(programme.c @ at.x))
    else:
        scale = at.tau
    return at.x / scale, at.s / scale, at.z / scale
