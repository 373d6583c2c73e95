"""The balances of energy and momentum, which hold in every run for any step and any grasps.

    (T + V)(t) - (T + V)(0) = W_drives + W_damping + W_base + W_external + E_impacts
    (L, P)(t) - (L, P)(0)   = integral of (bases + weights + external wrenches) dt + base impulses

Work is integrated with the state in the same Runge-Kutta steps, so the energy imbalance measures the error of the
integrator and of the projection, and not that of a quadrature over the samples. The integral of the wrenches is
computed from the samples, with piecewise cubics that are not fitted across discontinuities of the slope. Its error
decreases with the fourth power of the step, as the integrator's does.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.power_terms import Power
from holdfast.simulation.stops import JUMP_WIDTH
from holdfast.spatial.scalar import Array, array

# Columns of every work and power array.
WORK_TERMS = ("drives", "damping", "base", "external")
GAUSS = (-1.0 / np.sqrt(3.0), 1.0 / np.sqrt(3.0))  # on -1 .. 1


class Sums(NamedTuple):
    """The work and impulses that the chain has received since the start.

    Attributes:
        work: (4,) in the order of `WORK_TERMS` [J].
        impact: change of the energy by impulses [J].
        base_impulse: (6,) impulses of the bases, about the world's origin [N m s, N s].
    """

    work: Array
    impact: float
    base_impulse: Array


def work_rates(p: Power, friction: Array, qd: Array) -> Array:
    """Return power in the order of `WORK_TERMS`, (4,) [W].

    Args:
        p: power with the torques of the drives.
        friction: (n,) friction torques, which are subtracted from those of the drives.
        qd: (n,) joint rates. The power of friction is counted as damping.
    """
    return array([p.drives, p.damping - friction @ qd, p.base, p.external])


def imbalance(kinetic: Array, potential: Array, work: Array, impact: Array) -> Array:
    """Return the change of T + V since the first sample that the work and impulses do not explain, (samples,) [J].

    Args:
        kinetic: (samples,) T [J].
        potential: (samples,) V [J].
        work: (samples, 4) work done since the first sample [J].
        impact: (samples,) energy added by impulses [J].
    """
    energy = kinetic + potential
    return energy - energy[0] - work.sum(axis=1) - impact


def momentum_imbalance(t: Array, momentum: Array, rate: Array, base_impulse: Array) -> Array:
    """Return the change of (L, P) since the first sample that no impulse explains, (samples, 6) [N m s, N s].

    Args:
        t: (samples,) [s]; neighbours that are about `stops.JUMP_WIDTH` apart are the two sides of a jump.
        momentum: (samples, 6) [angular; linear] about a fixed point.
        rate: (samples, 6) sum of the external wrenches on the whole chain, about the same point.
        base_impulse: (samples, 6) impulses of the bases in all impacts so far, about the same point.
    """
    balance = MomentumBalance()
    return np.concatenate([balance.add(t, momentum, rate, base_impulse), balance.rest()])


class MomentumBalance:
    """The `momentum_imbalance` of a run of which one part after another is seen.

    The integral over an interval depends on two samples before it and two after it. The imbalances of a part's last
    samples are therefore found with the next part.
    """

    def __init__(self) -> None:
        self._held: tuple[
            Array, ...
        ] = ()  # t, momentum, rate, base_impulse: what waits, and up to three samples before
        self._done = 0  # samples of these whose imbalance was returned
        self._first: tuple[Array, Array] | None = None
        self._total = np.zeros((1, 6))

    def add(self, *part: Array) -> Array:
        """Take times, momenta, their rates and impulses of bases; return the imbalances that are known, (k, 6)."""
        self._held = tuple(np.concatenate(both) for both in zip(self._held, part, strict=True)) if self._held else part
        return self._next(ended=False)

    def rest(self) -> Array:
        """Return the imbalances of the last samples, (k, 6)."""
        return self._next(ended=True)

    def _next(self, ended: bool) -> Array:
        t, momentum, rate, base_impulse = self._held
        self._first = self._first or (momentum[0], base_impulse[0])
        jumps = np.flatnonzero(np.diff(t) <= np.maximum(4 * np.spacing(t[1:]), 2 * JUMP_WIDTH)) + 1
        begins = [0, *jumps.tolist()]
        by_wrenches = np.zeros_like(momentum)
        for a, b in pairwise([*begins, len(t)]):
            if b - a > 1:
                by_wrenches[a + 1 : b] = interval_integrals(t[a:b], rate[a:b])
        done, known = self._done, len(t) if ended else max(begins[-1] + 1, len(t) - 2)
        totals = np.cumsum(np.concatenate([self._total, by_wrenches[done:known]]), axis=0)
        momentum0, impulse0 = self._first
        found = momentum[done:known] - momentum0 - totals[1:] - (base_impulse[done:known] - impulse0)
        kept = max(known - 3, *(a for a in begins if a < known))
        self._held, self._done = tuple(x[kept:] for x in self._held), known - kept
        self._total = totals[-1:]
        return found


def interval_integrals(t: Array, f: Array) -> Array:
    """Return the integral of f over each interval, computed from the smoothest cubic, (samples - 1, ...).

    Up to three cubics through four neighbouring samples span an interval. For each component, the one with the smallest
    third difference is used. If f or its slope is discontinuous at a sample, this is a cubic that does not cross it.

    Args:
        t: (samples,) increasing, at least two.
        f: (samples, ...).
    """
    size, last = min(4, len(t)), len(t) - 1
    flat = f.reshape(len(t), -1)
    found = np.zeros((last, flat.shape[1]))
    roughness = np.full(found.shape, np.inf)
    for before in (1, 0, 2):  # number of nodes before the interval; among equally smooth cubics the first is used
        first = np.clip(np.arange(last) - before, 0, len(t) - size)
        nodes = first[:, None] + np.arange(size)
        total, rough = _through(t, flat, nodes)
        better = rough < roughness
        found, roughness = np.where(better, total, found), np.where(better, rough, roughness)
    return found.reshape(last, *f.shape[1:])


def _through(t: Array, f: Array, nodes: Array) -> tuple[Array, Array]:
    """Return each interval's integral of the polynomial through its nodes, and that polynomial's leading coefficient.

    Args:
        t: (samples,).
        f: (samples, components).
        nodes: (samples - 1, size) indices.
    """
    half, middle = 0.5 * np.diff(t), 0.5 * (t[1:] + t[:-1])
    total, leading = (np.zeros((len(nodes), f.shape[1])) for _ in range(2))
    for j in range(nodes.shape[1]):
        others = t[np.delete(nodes, j, axis=1)]
        apart = np.prod(t[nodes[:, j], None] - others, axis=1)
        # Gauss's rule with two points integrates cubics exactly
        values = sum(np.prod((middle + place * half)[:, None] - others, axis=1) for place in GAUSS)
        total += (half * values / apart)[:, None] * f[nodes[:, j]]
        leading += f[nodes[:, j]] / apart[:, None]
    return total, np.abs(leading)
