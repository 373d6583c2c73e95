"""Steps that dampers and springs of joints cannot blow up: implicit in both, explicit in all else.

A stage of an implicit-explicit Runge-Kutta scheme has two states: one by the explicit weights, at which configurations,
controller and all forces are evaluated, and one by the implicit weights, whose rates v and positions q dampers (D) and
springs (K) feel, and whose velocities are what positions change by (S. Boscarino, F. Filbet, G. Russo, "High order
semi-implicit schemes for time dependent partial differential equations", J. Sci. Comput. 68, 2016). Its acceleration k,

    (M + h a D + (h a)^2 K) k = torques - D v - K (q + h a v) + J^T f ..,    v, q of the stages before

is forward dynamics once more: with more armature and other torques, and grasps as ever. Where damping takes all, every
stage has the velocities at which torques and damping balance, and steps are those of the explicit scheme for them.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.model.joint import Joint
from holdfast.simulation.increment import OF_BODY, OF_WORK, moving_at, no_turns, turns_of, twists
from holdfast.simulation.runge_kutta import Tableau, weighted
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array, Scalar
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


def imex_step(
    start: State, passive: Passive, h: Scalar, tableau: Tableau, stage: Callable[[int, Array | None, Implicit], Any]
) -> Generator[Any, Array, Array]:
    """Return by how much an `increment` grows in a step; a generator as `runge_kutta_step`.

    Args:
        start: at the step's start.
        passive: what is taken implicitly.
        h: the step's length [s].
        tableau: with implicit weights.
        stage: (i, increment by the explicit weights, what is implicit) -> what is asked; the i-th stage is at
            t + c_i h, the first without an increment (None).
    """
    assert tableau.a_implicit is not None
    (D, K), n, size = passive, len(start.q), 2 * len(start.q) + OF_BODY * len(twists(start)) + OF_WORK
    slopes: list[Array] = []
    for i, (explicit, implicit) in enumerate(zip(tableau.a, tableau.a_implicit, strict=True)):
        y = h * weighted(explicit[:i], slopes) if i else None
        z = h * weighted(implicit[:i], slopes) if i else np.zeros(size)
        own = float(implicit[i]) * h
        ahead = z if y is None else z - y
        torque = -D * ahead[n : 2 * n] - K * (ahead[:n] + own * (start.qd + z[n : 2 * n]))
        slope = yield stage(i, y, Implicit(own * D + own**2 * K, torque))
        turns = no_turns(start) if y is None else turns_of(start, y)
        slopes.append(moving_at(start, z + own * slope, slope, turns))
    return h * weighted(tableau.b, slopes)


def with_armature(chain: ClosedChain, added: Array) -> ClosedChain:
    """Return the chain with more armature at its joints, (n,) in the order of q [kg m^2 or kg]."""
    made, put = copy.copy(chain), object.__setattr__
    of_arm = {name: added[part] for name, part in zip(chain.arms, chain.arm_joints, strict=True)}
    arms = {name: arm.of(_heavier(arm.joints, of_arm[name])) for name, arm in chain.arms.items()}
    put(made, "arms", FrozenDict(arms))
    if chain.trunk is not None and chain.trunk.joints:
        put(made, "trunk", replace(chain.trunk, joints=_heavier(chain.trunk.joints, added[chain.joints[TRUNK]])))
    return made


def _heavier(joints: Sequence[Joint], added: Array) -> list[Joint]:
    return [replace(joint, armature=joint.armature + more) for joint, more in zip(joints, added, strict=True)]
