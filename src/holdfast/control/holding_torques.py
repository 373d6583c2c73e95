"""Inverse dynamics of the whole closed chain: torques for an object acceleration and an internal wrench."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from holdfast.control.balancing_wrenches import POSSIBLE, balancing_wrenches
from holdfast.control.computed_torque import joint_accelerations
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from holdfast.dynamics.inverse import inverse_dynamics
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, shift_twist
from holdfast.state import Inputs, State


def holding_torques(
    chain: ClosedChain,
    state: State,
    acceleration: Any = None,
    internal: Any = 0.0,
    *,
    undriven: Iterable[str] = (),
) -> Array:
    """Return torques that give the object an acceleration, with a chosen internal wrench, (n,) [N m or N].

    tau = M qdd + C + J^T f + damping qd, with the least qdd that goes with the object's
    acceleration and the f nearest to the chosen one (in the metric of `split`) that satisfies
    A^T f = M(C) (alpha - [0; g]) + b(C). `forward_dynamics` of the result returns alpha, and,
    where forces are unique, f. Bases are taken to stand still. O(n) + O(l^3).

    Args:
        chain: the chain.
        state: positions and velocities, closed.
        acceleration: (6,) [omega_dot; v_dot] of C, true, world axes; None: zero, which holds
            still what is still.
        internal: a push of every arm along its contact normal, into the object [N]; or (arms,
            6) wrenches of each arm on the object about its contact, world axes. Of both only
            the transmissible, internal part counts.
        undriven: joints "arm/joint" (without a name: "arm/joint1", counted from 1) whose torque
            is to be 0; the internal wrench then gives way as far as it must.

    Raises:
        StateError: wrong shapes, an acceleration that the arms cannot follow, a load that the
            grasps or the driven joints cannot bear, an unknown joint.
    """
    state.fits(chain)
    alpha = np.zeros(6) if acceleration is None else checks.numbers(acceleration, (6,), "acceleration", StateError)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain))
    qdd = joint_accelerations(motion, state.qd, alpha - pseudo_gravity(chain))
    _require_followed(motion, qdd, alpha - pseudo_gravity(chain))
    idle = joint_places(chain, undriven)
    free = inverse_dynamics(chain, state, qdd, np.zeros((len(chain.arms), 6)))
    wished = _wished(motion, internal)
    f = balancing_wrenches(motion, alpha, wished, idle, free[idle])
    tau = inverse_dynamics(chain, state, qdd, f)
    tau[idle] = 0.0  # to rounding already
    return tau


def joint_places(chain: ClosedChain, names: Iterable[str]) -> Array:
    """Return where joints named "arm/joint" lie in the flat arrays, as an array of whole numbers.

    Raises:
        StateError: no such joint.
    """
    places = {
        f"{name}/{joint.name or f'joint{k + 1}'}": chain.joints[name].start + k
        for name, arm in chain.arms.items()
        for k, joint in enumerate(arm.joints)
    }
    names = list(names)
    for name in names:
        if name not in places:
            raise StateError(f"undriven: no joint '{name}'.{checks.did_you_mean(str(name), places)}")
    return np.array([places[name] for name in names], dtype=int)


def _wished(motion: ChainMotion, internal: Any) -> Array:
    """Return the chosen wrenches before any balance, (arms, 6)."""
    chain = motion.chain
    if np.ndim(internal):
        wished = checks.numbers(internal, (len(chain.arms), 6), "internal", StateError)
        for name, f in zip(chain.names, wished, strict=True):
            if name not in chain.grasps and f.any():
                raise StateError(f"internal: arm '{name}' holds nothing, expected zeros, got {f}")
        return wished
    push = np.array([0.0, 0.0, 0.0, 0.0, 0.0, float(checks.numbers(internal, (), "internal", StateError))])
    wished = np.zeros((len(chain.arms), 6))
    for name, c in zip(chain.grasps, motion.contacts, strict=True):
        wished[chain.names.index(name)] = rotate(c.R, push)
    return wished


def _require_followed(motion: ChainMotion, qdd: Array, alpha: Array) -> None:
    """Refuse an acceleration that an arm cannot follow, naming the arms and what they miss."""
    missed = []
    for name, c in zip(motion.chain.grasps, motion.contacts, strict=True):
        arm = motion.arms[name]
        tip = shift_twist(c.offset, alpha) + c.a - c.g - arm.bias.tip_acceleration
        gap = c.transmitted(tip - jacobian(arm.arm, arm.at) @ qdd[motion.chain.joints[name]])
        if float(np.abs(gap).max()) > POSSIBLE * max(1.0, float(np.abs(tip).max())):
            missed.append(f"arm '{name}' misses {np.abs(gap).max():.3g} (m/s^2 or rad/s^2)")
    if missed:
        raise StateError(
            f"acceleration: expected one that the arms can follow, got {alpha} less gravity: {', '.join(missed)}. Try"
            " holdfast.diagnose for the lost directions"
        )
