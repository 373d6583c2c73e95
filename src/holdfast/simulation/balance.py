"""The energy balance: T + V changes by the work done, whatever the step or the grasps.

    (T + V)(t) - (T + V)(0) = W_drives + W_damping + W_base + W_external

Work is integrated as further states of the same Runge-Kutta step, so what is left over
measures the integrator and the projection, not a sampling rule.
"""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.energy import power
from holdfast.dynamics.result import ForwardResult
from holdfast.model.closed_chain import ClosedChain
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


def imbalance(kinetic: Array, potential: Array, work: Array) -> Array:
    """Return T + V less its first value and the work done since, (samples,) [J].

    Args:
        kinetic: (samples,) T [J].
        potential: (samples,) V [J].
        work: (samples, 4) work done since the first sample [J].
    """
    energy = kinetic + potential
    return energy - energy[0] - work.sum(axis=1)


def energy_moved(kinetic: Array, potential: Array, work: Array) -> float:
    """Return the largest energy that a run moved about [J]: what an imbalance is compared with."""
    sizes = (kinetic, potential - potential[0], *work.T)
    return max(float(np.abs(size).max()) for size in sizes)
