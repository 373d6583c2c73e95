"""Stability of fixed steps: the fastest decay of the joint velocities, and the step that can follow it.

Resisting torques in proportion to velocity (damping, friction near standstill, the velocity feedback of a controller)
make velocities decay. For the velocities v = Z y that the grasps allow,
    (Z^T M Z) dy/dt = -(Z^T R Z) y
where v^T M v / 2 is the kinetic energy of links and object and R v are the resisting torques. An explicit step h
multiplies a mode of y with decay rate lambda by the stability function at -h lambda. The mode grows without bound, step
by step, if h lambda exceeds the stability interval of the scheme (`Tableau.stability_interval`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.control.controller import Controller
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.object_level import motion_basis
from holdfast.dynamics.projection import Change, quickened
from holdfast.dynamics.trunk.whole_chain import whole_chain
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.increment import displaced
from holdfast.simulation.instant import Instant
from holdfast.simulation.linearly_implicit import passive_terms
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array
from holdfast.state import State

# Fraction of the stability interval that steps may use. At its end nothing decays, and rates change with the
# configuration. At 0.9 each step still reduces a mode by a third (rk4) or a sixth (midpoint) of its size.
USED = 0.9
SUGGESTED = 0.5  # fraction that a suggested step uses: with any scheme it reduces a mode to less than half
PROBE = 1e-5  # rad/s or m/s, rad or m: change of the state with which a controller's feedback is measured
CELL_SIZE = 0.5  # rad or m: joints that have moved by as much may have another decay rate


class Decay(NamedTuple):
    """The fastest decay of a chain's velocities, or its fastest oscillation.

    Attributes:
        rate: lambda [1/s].
        joint: the joint with the largest share of the power, as 'arm/joint'.
    """

    rate: float
    joint: str


def fastest_decay(chain: ClosedChain, state: State, resistance: Array) -> Decay:
    """Return the fastest decay of the velocities that the grasps allow. O((n + 6)^3).

    Args:
        chain: the chain.
        state: its configuration; velocities are ignored.
        resistance: (n, n + 6) resisting joint torques per unit of (qd, V(C)); a floating base adds six columns.
    """
    # the largest eigenvalue of M^-1 R on the velocities that the grasps allow, and the joint of most power
    n = chain.joint_count
    Z = motion_basis(chain, state)
    if not Z.shape[1]:
        return Decay(0.0, chain.joint_names()[0])
    M = _mass_matrix(chain_at_rest(chain, state))
    sizes = np.sqrt(np.diag(M))[:, None]
    Z = np.linalg.qr(sizes * Z)[0] / sizes  # the same subspace, in a basis of similar kinetic energies
    L = np.linalg.cholesky(Z.T @ M @ Z)
    rates, modes = np.linalg.eig(np.linalg.solve(L, np.linalg.solve(L, (Z[:n].T @ resistance @ Z).T).T))
    decays = np.where(np.real(rates) > 0.0, np.abs(rates), 0.0)
    fastest = int(np.argmax(decays))
    v = Z @ np.linalg.solve(L.T, modes[:, fastest])
    power = np.real(v[:n].conj() * (resistance @ v))
    return Decay(float(decays[fastest]), chain.joint_names()[int(np.argmax(power))])


def fastest_swing(chain: ClosedChain, state: State, stiffness: Array) -> Decay:
    """Return the highest frequency of oscillations on springs that the grasps allow [rad/s]. O((n + 6)^3).

    Args:
        chain: the chain.
        state: its configuration; velocities are ignored.
        stiffness: (n, n + 6) restoring joint torques per displacement along (qd, V(C)), as in `fastest_decay`.
    """
    if not stiffness.any():
        return Decay(0.0, chain.joint_names()[0])
    square, joint = fastest_decay(chain, state, stiffness)
    return Decay(math.sqrt(square), joint)


def _mass_matrix(motion: ChainMotion) -> Array:
    """Return the mass matrix of (qd, V(C)); the twist of a floating base comes last."""
    chain = motion.chain
    n, size = chain.joint_count, chain.velocity_count
    M = np.zeros((size, size))
    M[n : n + 6, n : n + 6] = motion.body.inertia.dense()
    places = np.r_[n + 6 : size, :n]  # in that of the whole chain a floating base comes first
    M[np.ix_(places, places)] += whole_chain(motion).M
    return M


def passive_resistance(chain: ClosedChain, qd: Array) -> Array:
    """Return the torques of damping and friction per unit of the velocities, (n, n + 6) or (n, n + 12)."""
    return of_joints(chain, passive_terms(chain).resistance(qd))


def of_joints(chain: ClosedChain, sizes: Array) -> Array:
    """Return the torques of dampers or springs of such sizes in the joints, as `passive_resistance` does."""
    return np.eye(chain.joint_count, chain.velocity_count) * sizes[:, None]


def feedback_resistance(controller: Controller, now: Instant) -> Array:
    """Return the resisting torques of a controller per unit of the velocities that the grasps allow.

    The shape is (n, n + 6), or (n, n + 12) with a floating base. The torques are found by central differences: the
    controller is evaluated twice for each velocity.
    """
    Z = motion_basis(now.chain, now.state)
    return feedback(controller, now, Z, quicker) @ Z.T


def feedback_stiffness(controller: Controller, now: Instant) -> Array:
    """Return the restoring torques of a controller per unit of displacement, found as in `feedback_resistance`."""
    Z = motion_basis(now.chain, now.state)
    return feedback(controller, now, Z, moved) @ Z.T


def feedback(controller: Controller, now: Instant, along: Array, changed: Callable[[State, Array], State]) -> Array:
    """Return the torques against changes of the state, per unit of each, by central differences, (n, changes).

    Args:
        controller: the controller.
        now: the chain and its state.
        along: (n + 6, changes) changes of the velocities, or displacements, as columns.
        changed: `quicker` or `moved`, which applies them.
    """
    n = len(now.state.q)

    def asked(v: Array) -> Array:
        torques = controller(now.t, changed(now.state, v), now.memory)[0]
        return checks.numbers(torques, (n,), "controller: torques", StateError)

    columns = [(asked(-PROBE * v) - asked(PROBE * v)) / (2.0 * PROBE) for v in along.T]
    return np.reshape(columns, (along.shape[1], n)).T


def quicker(state: State, v: Array) -> State:
    """Return the state with its velocities changed by v, (n + 6,)."""
    n = len(state.q)
    return quickened(state, Change(v[:n], v[n : n + 6], v[n + 6 :] if len(v) > n + 6 else None))


def moved(state: State, v: Array) -> State:
    """Return the state displaced along velocities v, (n + 6,)."""
    n = len(state.q)
    bodies = [np.concatenate([v[first : first + 6], np.zeros(6)]) for first in range(n, len(v), 6)]
    return displaced(state, np.concatenate([v[:n], np.zeros(n), *bodies]))


def followed(decay: Decay, step: float, scheme: Tableau) -> bool:
    """Return whether a step is short enough for the scheme to follow a decay."""
    return step * decay.rate <= USED * scheme.stability_interval


def step_for(decay: Decay, scheme: Tableau) -> float:
    """Return a step that is short enough for a decay, rounded to two digits [s]."""
    return float(f"{SUGGESTED * scheme.stability_interval / decay.rate:.2g}")


def too_fast(chain: ClosedChain, state: State, step: float, scheme: Tableau) -> str | None:
    """Return why steps of an explicit scheme are too long for the joints' dampers and springs; None if they are not."""
    if scheme.adaptive or scheme.implicit or step <= surely_stable_step(chain, state.qd, scheme):
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
    """Return whether joints have moved so far that their decay rates may have changed.

    The answer depends on two instants only, so that a resumed run finds it at the same time as an uninterrupted one.
    """
    return bool((cell(before.q) != cell(after.q)).any())


def cell(q: Array) -> Array:
    """Return the number of the cell of width `CELL_SIZE` in which each joint lies; q may have any leading axes."""
    return np.floor(q / CELL_SIZE + 1 / np.pi)


def fastest_passive(chain: ClosedChain, state: State) -> tuple[Decay, bool]:
    """Return the faster of decay (dampers, friction) and oscillation (springs), and whether it is the latter.

    O((n + 6)^3).
    """
    try:
        decay = fastest_decay(chain, state, passive_resistance(chain, state.qd))
        swing = fastest_swing(chain, state, of_joints(chain, passive_terms(chain).stiffness))
    except (np.linalg.LinAlgError, StateError):  # masses differ by too much for an answer; each step is still checked
        return Decay(0.0, chain.joint_names()[0]), False
    return max((decay, False), (swing, True), key=lambda found: found[0].rate)


def surely_stable_step(chain: ClosedChain, qd: Array, scheme: Tableau) -> float:
    """Return a step length that is stable in every configuration, because of the armatures alone [s].

    Links and grasps only add inertia, so no rate exceeds the largest ratio of resistance to armature.
    """
    passive, most = passive_terms(chain), USED * scheme.stability_interval
    armature = np.array([joint.armature for joint in chain.all_joints])
    with np.errstate(all="ignore"):  # infinite without resistance, which is 0 / 0 without armature, too
        damped, sprung = armature / passive.resistance(qd), np.sqrt(armature / passive.stiffness)
    return most * float(np.min(np.nan_to_num([damped, sprung], nan=np.inf, posinf=np.inf), initial=np.inf))
