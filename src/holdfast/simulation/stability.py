"""How fast joints settle, and which fixed step can follow.

What takes torque from the joints in proportion to velocity (damping, friction about standstill, a controller's
velocity feedback) makes velocities decay. Over the velocities v = Z y that the grasps allow,

    (Z^T M Z) dy/dt = -(Z^T R Z) y

with the kinetic energy v^T M v / 2 of joints and object and the torques R v that are taken. An explicit step h
multiplies the part of y that decays at a rate lambda by R(-h lambda), which grows without bound, step by step,
where h lambda is beyond the scheme's stability interval (`Tableau.stability_interval`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.control.controller import Controller
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.object_level import motion_basis
from holdfast.dynamics.projection import Change, quickened
from holdfast.dynamics.trunk.whole_chain import whole_chain
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.instant import Instant, friction_slope, joint_friction, passive_at
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array
from holdfast.state import State

# Part of the stability interval that is used: at its end nothing decays, and rates change with the configuration.
# At 0.9 what should die out within a step still loses a third (rk4) or a sixth (midpoint) of its size in each.
USED = 0.9
SUGGESTED = 0.5  # part of it that a suggested step uses: there steps of any scheme more than halve it
PROBE = 1e-5  # rad/s or m/s: by how much velocities are changed to see what a controller makes of it
CELL = 0.5  # rad or m: joints that have moved by as much may settle at another rate


class Decay(NamedTuple):
    """The fastest decay of a chain's velocities, or its fastest swing.

    Attributes:
        rate: lambda [1/s].
        joint: the joint that most of the power is taken from, as 'arm/joint'.
    """

    rate: float
    joint: str


def fastest_decay(chain: ClosedChain, state: State, resistance: Array) -> Decay:
    """Return the fastest decay of the velocities that the grasps allow. O((n + 6)^3).

    Args:
        chain: the chain.
        state: its configuration; velocities do not enter.
        resistance: (n, n + 6) torques taken from the joints per unit of (qd, V(C)); six columns more of a floating
            base.
    """
    return _fastest(chain, state, resistance)


def fastest_swing(chain: ClosedChain, state: State, stiffness: Array) -> Decay:
    """Return the fastest swing on the joints' springs of the velocities that the grasps allow [rad/s]. O((n + 6)^3).

    Args:
        chain: the chain.
        state: its configuration; velocities do not enter.
        stiffness: (n,) of the joints' springs [N m/rad or N/m].
    """
    if not stiffness.any():
        return Decay(0.0, chain.joint_names()[0])
    square, joint = _fastest(chain, state, np.eye(chain.joint_count, chain.velocity_count) * stiffness[:, None])
    return Decay(math.sqrt(square), joint)


def _fastest(chain: ClosedChain, state: State, resistance: Array) -> Decay:
    """Return the largest eigenvalue of M^-1 times torques per velocity, and the joint with most of its power."""
    n = chain.joint_count
    Z = motion_basis(chain, state)
    if not Z.shape[1]:
        return Decay(0.0, chain.joint_names()[0])
    M = _mass_matrix(chain_at_rest(chain, state))
    sizes = np.sqrt(np.diag(M))[:, None]
    Z = np.linalg.qr(sizes * Z)[0] / sizes  # the same velocities, of like kinetic energies
    L = np.linalg.cholesky(Z.T @ M @ Z)
    rates, modes = np.linalg.eig(np.linalg.solve(L, np.linalg.solve(L, (Z[:n].T @ resistance @ Z).T).T))
    decays = np.where(np.real(rates) > 0.0, np.abs(rates), 0.0)
    fastest = int(np.argmax(decays))
    v = Z @ np.linalg.solve(L.T, modes[:, fastest])
    power = np.real(v[:n].conj() * (resistance @ v))
    return Decay(float(decays[fastest]), chain.joint_names()[int(np.argmax(power))])


def _mass_matrix(motion: ChainMotion) -> Array:
    """Return the mass matrix of (qd, V(C)), and of a floating base last."""
    chain = motion.chain
    n, size = chain.joint_count, chain.velocity_count
    M = np.zeros((size, size))
    M[n : n + 6, n : n + 6] = motion.body.inertia.dense()
    if motion.trunk is not None:
        places = np.r_[n + 6 : size, :n]  # the floating base comes first there
        M[np.ix_(places, places)] += whole_chain(motion).M
        return M
    for name, arm in motion.arms.items():
        M[chain.joints[name], chain.joints[name]] = mass_matrix(arm.arm, arm.at)[0]
    return M


def passive_resistance(chain: ClosedChain, qd: Array) -> Array:
    """Return the torques that damping and friction take per unit of the velocities, (n, n + 6) or (n, n + 12)."""
    n, damping = chain.joint_count, np.array([joint.damping for joint in chain.all_joints])
    taken = np.diag(damping + friction_slope(joint_friction(chain), qd))
    return np.hstack([taken, np.zeros((n, chain.velocity_count - n))])


def feedback_resistance(controller: Controller, now: Instant) -> Array:
    """Return the torques that a controller takes per unit of the velocities that the grasps allow.

    (n, n + 6), or (n, n + 12) with a floating base.

    Found by asking it about velocities changed a little, two questions for each of them.
    """
    n, Z = len(now.state.q), motion_basis(now.chain, now.state)
    columns = []

    def asked(v: Array) -> Array:
        state = quickened(now.state, Change(v[:n], v[n : n + 6], v[n + 6 :] if len(v) > n + 6 else None))
        return checks.numbers(controller(now.t, state, now.memory)[0], (n,), "controller: torques", StateError)

    for v in Z.T:
        less, more = asked(-PROBE * v), asked(PROBE * v)
        columns.append((less - more) / (2.0 * PROBE))
    return np.reshape(columns, (-1, n)).T @ Z.T


def followed(decay: Decay, step: float, scheme: Tableau) -> bool:
    """Return whether a step can follow a decay."""
    return step * decay.rate <= USED * scheme.stability_interval


def step_for(decay: Decay, scheme: Tableau) -> float:
    """Return a step that follows a decay, two digits of it [s]."""
    return float(f"{SUGGESTED * scheme.stability_interval / decay.rate:.2g}")


def too_fast(chain: ClosedChain, state: State, step: float, scheme: Tableau) -> str | None:
    """Return why an explicit scheme of fixed steps cannot follow how fast joints settle or swing; None if it can."""
    if scheme.adaptive or scheme.implicit or not may_be_too_fast(chain, state.qd, step, scheme):
        return None
    fastest, swings = fastest_passive(chain, state)
    if followed(fastest, step, scheme):
        return None
    rate, joint = fastest
    limit, at = USED * scheme.stability_interval / rate, chain.all_joints[chain.joint_names().index(joint)]
    by = " and ".join(["damping"] * (at.damping > 0.0) + ["friction"] * (at.friction > 0.0))
    how = f"swings at {rate:.3g} rad/s by its spring" if swings else f"is slowed down at {rate:.3g} 1/s by {by}"
    return f"joint '{joint}' {how}, which {scheme.name} follows with steps of at most {limit:.2g} s"


def elsewhere(before: State, after: State) -> bool:
    """Return whether joints have moved so far that they may settle at another rate.

    Told by two instants alone, so that a run that was resumed sees it where an unbroken one does.
    """
    return bool((cell(before.q) != cell(after.q)).any())


def cell(q: Array) -> Array:
    """Return numbers that change where a joint moves so far that it may settle at another rate; any leading axes."""
    return np.floor(q / CELL + 1 / np.pi)


def fastest_passive(chain: ClosedChain, state: State) -> tuple[Decay, bool]:
    """Return the fastest decay by dampers and friction, or swing on springs, and whether it swings. O((n + 6)^3)."""
    try:
        decay = fastest_decay(chain, state, passive_resistance(chain, state.qd))
        swing = fastest_swing(chain, state, passive_at(chain, state.qd).stiffness)
    except np.linalg.LinAlgError:  # masses too far apart to tell; what a step shows is still checked
        return Decay(0.0, chain.joint_names()[0]), False
    return max((decay, False), (swing, True), key=lambda found: found[0].rate)


def may_be_too_fast(chain: ClosedChain, qd: Array, step: float, scheme: Tableau) -> bool:
    """Return False where the drives' inertias alone make every rate, in every configuration, slow enough.

    The grasps and the links only add inertia: no rate is beyond the largest resistance over armature.
    """
    passive, most = passive_at(chain, qd), USED * scheme.stability_interval
    armature = np.array([joint.armature for joint in chain.all_joints])
    with np.errstate(all="ignore"):  # of steps beyond all numbers
        fast = (step * passive.damping > most * armature) | (step * step * passive.stiffness > most**2 * armature)
    return bool(fast.any())
