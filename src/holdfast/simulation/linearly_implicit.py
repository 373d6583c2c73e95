"""Linearly implicit steps, which are stable for stiff joint dampers and springs and explicit in all other forces.

A stage of an implicit-explicit Runge-Kutta scheme has two states. The kinematics, the controller and all other forces
are evaluated at the state given by the explicit weights. The dampers (D), dry friction and springs (K) are evaluated at
the rates v and positions q given by the implicit weights, and the velocities of this second state are the rates of the
positions (S. Boscarino, F. Filbet, G. Russo, "High order semi-implicit schemes for time dependent partial differential
equations", J. Sci. Comput. 68, 2016). The acceleration k of a stage satisfies
    (M + h a D + (h a)^2 K) k = torques - D v - K (q + h a v) + J^T f ..,    v, q from the previous stages
This is forward dynamics with larger armatures and other torques, and with the same grasps. In the limit of strong
damping, every stage has the velocities at which torques and damping balance, and the steps become those of the explicit
scheme for these velocities. Dry friction F(v) is linearised in each stage about the rates u of the previous one,
    F(u) + F'(u) (v + h a k - u)
so that the stages of a step are the iterations of Newton's method for the rates at which torques and friction balance.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.joint import Joint
from holdfast.model.trunk import TRUNK
from holdfast.simulation.increment import OF_BODY, OF_WORK, moving_at, no_turns, turns_of, twists
from holdfast.simulation.joint_friction import friction_slope, friction_torque, joint_friction
from holdfast.simulation.runge_kutta import Tableau, weighted
from holdfast.spatial.frozen import FrozenDict, changed
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import State


class Passive(NamedTuple):
    """The damping, stiffness and dry friction of the joints, which are treated implicitly.

    Attributes:
        damping: (n,) torque per rate [N m s/rad or N s/m].
        stiffness: (n,) torque per displacement [N m/rad or N/m].
        friction: (n,) Coulomb friction F_c [N m or N].
    """

    damping: Array
    stiffness: Array
    friction: Array

    def resistance(self, qd: Array) -> Array:
        """Return the slope of the torques of damping and friction at joint rates qd, (n,) [N m s/rad or N s/m]."""
        return self.damping + friction_slope(self.friction, qd) if self.friction.any() else self.damping


def passive_terms(chain: ClosedChain) -> Passive:
    """Return the damping, stiffness and dry friction of the joints."""
    damping, stiffness = np.array([(joint.damping, joint.stiffness) for joint in chain.all_joints]).reshape(-1, 2).T
    return Passive(damping, stiffness, joint_friction(chain))


class Implicit(NamedTuple):
    """The modifications that turn forward dynamics into a stage of a linearly implicit step.

    Attributes:
        armature: (n,) armature to add to that of the joints [kg m^2 or kg].
        torque: (n,) torque to add to that of the joints [N m or N].
    """

    armature: Array
    torque: Array


def imex_step(
    start: State, passive: Passive, h: Scalar, tableau: Tableau, stage: Callable[[int, Array | None, Implicit], Any]
) -> Generator[Any, Array, Array]:
    """Return the `increment` of a step; a generator of requests like `runge_kutta_step`.

    Args:
        start: the state at the step's start.
        passive: damping, stiffness and friction to treat implicitly.
        h: the step's length [s].
        tableau: a scheme with implicit weights.
        stage: function of i, the increment by the explicit weights (None at the first stage) and the `Implicit` terms
            that returns the request for stage i, at t + c_i h.
    """
    assert tableau.a_implicit is not None
    (D, K, F), n, size = passive, len(start.q), 2 * len(start.q) + OF_BODY * len(twists(start)) + OF_WORK
    slopes: list[Array] = []
    near = start.qd  # the rates about which friction is linearised: those of the previous stage
    for i, (explicit, implicit) in enumerate(zip(tableau.a, tableau.a_implicit, strict=True)):
        y = h * weighted(explicit[:i], slopes) if i else None
        z = h * weighted(implicit[:i], slopes) if implicit[:i].any() else np.zeros(size)
        own = float(implicit[i]) * h
        ahead = z if y is None else z - y
        known = start.qd + z[n : 2 * n]
        torque = -D * ahead[n : 2 * n] - K * (ahead[:n] + own * known)
        if F.any():
            linear = friction_torque(F, near) + friction_slope(F, near) * (known - near)
            torque = torque + friction_torque(F, known - ahead[n : 2 * n]) - linear
        slope = yield stage(i, y, Implicit(own * passive.resistance(near) + own**2 * K, torque))
        near = known + own * slope[n : 2 * n]
        turns = no_turns(start) if y is None else turns_of(start, y)
        slopes.append(moving_at(start, z + own * slope, slope, turns))
    return h * weighted(tableau.b, slopes)


def with_armature(chain: ClosedChain, added: Array) -> ClosedChain:
    """Return the chain with `added`, (n,) in the order of q, added to the armatures of its joints [kg m^2 or kg]."""
    of_arm = {name: added[part] for name, part in zip(chain.arms, chain.arm_joints, strict=True)}
    arms = {name: arm.of(_heavier(arm.joints, of_arm[name])) for name, arm in chain.arms.items()}
    trunk = chain.trunk
    if trunk is not None and trunk.joints:
        trunk = replace(trunk, joints=_heavier(trunk.joints, added[chain.joints[TRUNK]]))
    return changed(chain, arms=FrozenDict(arms), trunk=trunk)


def _heavier(joints: Sequence[Joint], added: Array) -> list[Joint]:
    return [replace(joint, armature=joint.armature + more) for joint, more in zip(joints, added, strict=True)]
