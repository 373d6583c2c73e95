"""The balances that every run keeps, whatever the step or the grasps: energy and momentum.

    (T + V)(t) - (T + V)(0) = W_drives + W_damping + W_base + W_external + E_impacts
    (L, P)(t) - (L, P)(0)   = integral of (bases + weights + external wrenches) dt + base impulses

Work is integrated as further states of the same Runge-Kutta step, so what is left over measures the
integrator and the projection, not a sampling rule. The integral of the wrenches is taken over the
samples, by cubics that do not look around corners: what is left of it falls with the fourth power of
the step like the integrator's error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.energy import Power
from holdfast.simulation.stops import JUMP_WIDTH
from holdfast.spatial.scalar import Array, array

# Columns of every work and power array.
WORK_TERMS = ("drives", "damping", "base", "external")
GAUSS = (-1.0 / np.sqrt(3.0), 1.0 / np.sqrt(3.0))  # on -1 .. 1


class Sums(NamedTuple):
    """What has gone into the chain since the start.

    Attributes:
        work: (4,) see `WORK_TERMS` [J].
        impact: energy, by impulses [J].
        base_impulse: (6,) by impulses of the bases, about the world's origin [N m s, N s].
    """

    work: Array
    impact: float
    base_impulse: Array


def work_rates(p: Power, friction: Array, qd: Array) -> Array:
    """Return power in the order of `WORK_TERMS`, (4,) [W].

    Args:
        p: power under the drives' torques.
        friction: (n,) what friction takes from them.
        qd: (n,) joint rates; friction's power goes with the damping's.
    """
    return array([p.drives, p.damping - friction @ qd, p.base, p.external])


def imbalance(kinetic: Array, potential: Array, work: Array, impact: Array) -> Array:
    """Return T + V less its first value and the energy put in since, (samples,) [J].

    Args:
        kinetic: (samples,) T [J].
        potential: (samples,) V [J].
        work: (samples, 4) work done since the first sample [J].
        impact: (samples,) energy that impulses have added [J].
    """
    energy = kinetic + potential
    return energy - energy[0] - work.sum(axis=1) - impact


def momentum_imbalance(t: Array, momentum: Array, rate: Array, base_impulse: Array) -> Array:
    """Return (L, P) less its first value and all impulses since, (samples, 6) [N m s, N s].

    Args:
        t: (samples,) [s]; neighbours about `stops.JUMP_WIDTH` apart are the two sides of a jump.
        momentum: (samples, 6) [angular; linear] about a fixed point.
        rate: (samples, 6) the wrenches on the whole chain about it.
        base_impulse: (samples, 6) of the bases in impacts so far, about it.
    """
    by_wrenches = np.zeros_like(momentum)
    jumps = np.flatnonzero(np.diff(t) <= np.maximum(4 * np.spacing(t[1:]), 2 * JUMP_WIDTH)) + 1
    for part in np.split(np.arange(len(t)), jumps):
        if len(part) > 1:
            by_wrenches[part[1:]] = interval_integrals(t[part], rate[part])
    return momentum - momentum[0] - np.cumsum(by_wrenches, axis=0) - (base_impulse - base_impulse[0])


def interval_integrals(t: Array, f: Array) -> Array:
    """Return the integral of f over every interval, by the smoothest cubic through it, (samples - 1, ...).

    Of the cubics through four neighbouring samples that span the interval the one with the smallest third
    difference is taken, component by component: where f or its slope has a corner at a sample, the one that
    does not look around it.

    Args:
        t: (samples,) increasing, at least two.
        f: (samples, ...).
    """
    size, last = min(4, len(t)), len(t) - 1
    flat = f.reshape(len(t), -1)
    found = np.zeros((last, flat.shape[1]))
    roughness = np.full(found.shape, np.inf)
    for before in (1, 0, 2):  # samples of the cubic that lie before the interval; of equals the first
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
        # Gauss's two points integrate cubics
        values = sum(np.prod((middle + place * half)[:, None] - others, axis=1) for place in GAUSS)
        total += (half * values / apart)[:, None] * f[nodes[:, j]]
        leading += f[nodes[:, j]] / apart[:, None]
    return total, np.abs(leading)


def energy_moved(kinetic: Array, potential: Array, work: Array, impact: Array) -> float:
    """Return the largest energy that a run moved about [J]: what an imbalance is compared with."""
    sizes = (kinetic, potential - potential[0], *work.T, impact)
    return max(float(np.abs(size).max()) for size in sizes)
