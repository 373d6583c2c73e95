"""The balances that every run keeps, whatever the step or the grasps: energy and momentum.

    (T + V)(t) - (T + V)(0) = W_drives + W_damping + W_base + W_external + E_impacts
    (L, P)(t) - (L, P)(0)   = integral of (bases + weights + external wrenches) dt + base impulses

Work is integrated as further states of the same Runge-Kutta step, so what is left over measures the
integrator and the projection, not a sampling rule. The integral of the wrenches is taken over the
samples, by cubics: what is left of it falls with the fourth power of the step like the integrator's error.
"""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.energy import power
from holdfast.dynamics.result import ForwardResult
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.stops import MOMENT
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

# Columns of every work and power array.
WORK_TERMS = ("drives", "damping", "base", "external")


def power_terms(
    chain: ClosedChain, state: State, tau: Array, friction: Array, result: ForwardResult, inputs: Inputs
) -> Array:
    """Return the power of drives, damping and friction, bases, external wrenches, (4,) [W].

    Args:
        chain: the chain.
        state: positions and velocities.
        tau: (n,) torques of the drives.
        friction: (n,) what friction takes from them.
        result: forward dynamics under tau - friction.
        inputs: external wrenches and base motion.
    """
    p = power(chain, state, tau, result, inputs)
    return np.array([p.drives, p.damping - friction @ state.qd, p.base, p.external])


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
        t: (samples,) [s]; neighbours about `stops.MOMENT` apart are the two sides of a jump.
        momentum: (samples, 6) [angular; linear] about a fixed point.
        rate: (samples, 6) the wrenches on the whole chain about it.
        base_impulse: (samples, 6) of the bases in impacts so far, about it.
    """
    by_wrenches = np.zeros_like(momentum)
    jumps = np.flatnonzero(np.diff(t) <= np.maximum(4 * np.spacing(t[1:]), 2 * MOMENT)) + 1
    for part in np.split(np.arange(len(t)), jumps):
        if len(part) > 1:
            by_wrenches[part[1:]] = interval_integrals(t[part], rate[part])
    return momentum - momentum[0] - np.cumsum(by_wrenches, axis=0) - (base_impulse - base_impulse[0])


def interval_integrals(t: Array, f: Array) -> Array:
    """Return the integral of f over every interval, through the four nearest samples, (samples - 1, ...).

    Args:
        t: (samples,) increasing, at least two.
        f: (samples, ...).
    """
    size = min(4, len(t))
    first = np.clip(np.arange(len(t) - 1) - (size - 2) // 2, 0, len(t) - size)
    nodes = first[:, None] + np.arange(size)
    half, middle = 0.5 * np.diff(t), 0.5 * (t[1:] + t[:-1])
    total = np.zeros((len(t) - 1, *f.shape[1:]))
    for place in (-1.0, 1.0):  # Gauss's two points integrate cubics
        x = middle + place / np.sqrt(3.0) * half
        for j in range(size):
            others = [k for k in range(size) if k != j]
            gaps = [(x - t[nodes[:, k]]) / (t[nodes[:, j]] - t[nodes[:, k]]) for k in others]
            total += np.reshape(half * np.prod(gaps, axis=0), (-1, *[1] * (f.ndim - 1))) * f[nodes[:, j]]
    return total


def energy_moved(kinetic: Array, potential: Array, work: Array, impact: Array) -> float:
    """Return the largest energy that a run moved about [J]: what an imbalance is compared with."""
    sizes = (kinetic, potential - potential[0], *work.T, impact)
    return max(float(np.abs(size).max()) for size in sizes)
