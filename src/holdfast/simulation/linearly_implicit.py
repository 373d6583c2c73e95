"""Steps that dampers and springs of joints cannot blow up: linearly implicit in both, by Rosenbrock-W methods.

A stage of such a method asks for k with (1 - gamma h A) k = f + h A sum_j<i gamma_ij k_j, for any A near the slope's
derivative (J. Rang, L. Angermann, "New Rosenbrock W-methods of order 3 for partial differential algebraic equations of
index 1", BIT 45, 2005). With A the derivative by what dampers (D) and springs (K) take from the joints, and v' = k,

    (M + gamma h D + (gamma h)^2 K) k = torques - D e_v - K (e_q + gamma h (v + e_v)) + J^T f ..,
    e = h sum_j<i gamma_ij k_j  of rates and positions

it is forward dynamics once more: with more armature and other torques, and grasps as ever.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.model.joint import Joint
from holdfast.simulation.runge_kutta import Tableau, weighted
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.state import State


class Passive(NamedTuple):
    """What dampers and springs take from the joints.

    Attributes:
        damping: (n,) torque per rate, friction's slope included [N m s/rad or N s/m].
        stiffness: (n,) torque per displacement [N m/rad or N/m].
    """

    damping: Array
    stiffness: Array


class Implicit(NamedTuple):
    """What makes forward dynamics a stage of an implicit step.

    Attributes:
        armature: (n,) what the joints have more of [kg m^2 or kg].
        torque: (n,) what they are driven by besides [N m or N].
    """

    armature: Array
    torque: Array


def rosenbrock_step(
    start: State, passive: Passive, h: Scalar, tableau: Tableau, stage: Callable[[int, Array | None, Implicit], Any]
) -> Generator[Any, Array, Array]:
    """Return by how much an `increment` grows in a step; a generator as `runge_kutta_step`.

    Args:
        start: at the step's start.
        passive: what counts as stiff there.
        h: the step's length [s].
        tableau: with gamma.
        stage: (i, increment, what is implicit) -> what is asked; the i-th stage is at t + c_i h. None for no
            increment, in the first.
    """
    assert tableau.gamma is not None
    n, gamma = len(start.q), float(tableau.gamma[0, 0]) * h
    D, K = passive
    sprung = (K != 0.0).astype(float)
    armature = gamma * D + gamma**2 * K
    slopes: list[Array] = []
    for i in range(len(tableau.b)):
        earlier, y = np.zeros(2 * n), None
        if i:
            earlier = h * weighted(tableau.gamma[i, :i], slopes)[: 2 * n]
            y = h * weighted(tableau.a[i, :i], slopes)
        rate = start.qd if y is None else start.qd + y[n : 2 * n]
        torque = -D * earlier[n:] - K * (earlier[:n] + gamma * (rate + earlier[n:]))
        slope = yield stage(i, y, Implicit(armature, torque))
        ahead = sprung * (earlier[n:] + gamma * slope[n : 2 * n])
        slopes.append(concatenate([slope[:n] + ahead, slope[n:]]))
    return h * weighted(tableau.b, slopes)


def with_armature(chain: ClosedChain, added: Array) -> ClosedChain:
    """Return the chain with more armature at its joints, (n,) in the order of q [kg m^2 or kg]."""
    made, put = copy.copy(chain), object.__setattr__
    of_arm = {name: added[part] for name, part in zip(chain.arms, chain.arm_joints, strict=True)}
    arms = {name: replace(arm, joints=_heavier(arm.joints, of_arm[name])) for name, arm in chain.arms.items()}
    put(made, "arms", FrozenDict(arms))
    if chain.trunk is not None and chain.trunk.joints:
        put(made, "trunk", replace(chain.trunk, joints=_heavier(chain.trunk.joints, added[chain.joints[TRUNK]])))
    return made


def _heavier(joints: Sequence[Joint], added: Array) -> list[Joint]:
    return [replace(joint, armature=joint.armature + more) for joint, more in zip(joints, added, strict=True)]
