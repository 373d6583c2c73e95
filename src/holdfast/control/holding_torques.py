"""Inverse dynamics of the whole closed chain: torques for an object acceleration and an internal wrench.

The grasp wrenches accelerate the object, need no torque at passive joints, and are as close as possible to wished
ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from holdfast.control.balanced_torques import FEASIBLE, Missed, balanced, missed_accelerations, pushes
from holdfast.control.computed_torque import joint_accelerations
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, needed_wrench, pseudo_gravity
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.inverse import torques, trunk_torques
from holdfast.dynamics.tree.mechanism_inverse import mechanism_holding
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest, require_unused
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import Inputs, State, require_fit

DEPENDENT_DIRECTIONS = 1e-12  # singular values below this, relative to the largest, count as zero


def balancing_wrenches(
    motion: ChainMotion, alpha: Array, wished: Array, idle: Array, free: Array, base: Array | None = None
) -> Array:
    """Return the transmissible wrenches nearest to the wished ones that satisfy the balances, (arms, 6).

    min |lambda - K f_wished| in the metric of the force split (moments divided by its length), subject to
    A^T K^T lambda = M(C) (alpha - [0; g]) + b(C) - w, with w of springs and bushings, and to
    (J^T K^T lambda)_j = -(M qdd + C)_j at passive joints j and at the six rows of a floating base, which has no drive.

    Args:
        motion: the chain's motion.
        alpha: (6,) true acceleration of C, world axes.
        wished: (arms, 6) wished wrenches about the contacts, world axes; only the rows of arms with a grasp count.
        idle: indices of the passive joints in the flat arrays.
        free: (idle,) their torques M qdd + C + damping qd + stiffness (q - rest) [N m or N].
        base: (6,) wrench that a floating base would need without grasp wrenches, about its origin; None without one.

    Raises:
        StateError: no wrenches satisfy the balances.
    """
    chain = motion.chain
    holding = [chain.names.index(name) for name in chain.grasps]
    length = length_scale([c.offset for c in motion.contacts])
    needed = needed_wrench(motion, alpha)
    unit = np.r_[np.full(3, 1 / length), np.ones(3)]  # moments in newtons
    torque_unit = np.array([1 / length if joint.turns else 1.0 for joint in chain.all_joints])
    base_load = np.zeros(0) if base is None else unit * base
    columns, start, root = [np.zeros((6 + len(idle) + len(base_load), 0))], [np.zeros(0)], [np.zeros(0)]
    for i, (name, c) in zip(holding, zip(chain.grasps, motion.contacts, strict=True), strict=True):
        K, arm = c.K, motion.arms[name]
        torques, on_base = np.zeros((chain.joint_count, len(K))), np.zeros((6, len(K)))
        torques[chain.joints[name]] = (K @ jacobian(arm.arm, arm.at)).T
        by_joints, by_base = motion.trunk.jacobian(name, arm.base_to_tip)
        torques[motion.trunk.joints] = (K @ by_joints).T
        on_base = (K @ by_base).T if len(base_load) else on_base
        to_C = np.array([shift_wrench(c.offset, row) for row in K]).T
        of_base = (unit[:, None] * on_base)[: len(base_load)]
        columns.append(np.concatenate([unit[:, None] * to_C, (torque_unit[:, None] * torques)[idle], of_base]))
        start.append(K @ wished[i])
        root.append(np.array(c.grasp.of_kind.row_scales(length)))
    E, lam, root = np.concatenate(columns, axis=1), np.concatenate(start), np.concatenate(root)
    e = np.concatenate([unit * needed, -torque_unit[idle] * free, -base_load])
    if lam.size:
        lam = lam + root * np.linalg.lstsq(E * root, e - E @ lam, rcond=DEPENDENT_DIRECTIONS)[0]
    size = max(1.0, float(np.abs(e).max()), float(np.abs(lam).max(initial=0.0)))
    _require_balance(chain, float(np.abs(E @ lam - e).max()), size, idle)
    f = np.zeros((len(chain.arms), 6))
    ends = np.cumsum([len(c.grasp.transmitted) for c in motion.contacts])[:-1]
    for i, c, part in zip(holding, motion.contacts, np.split(lam, ends), strict=False):
        f[i] = c.K.T @ part
    return f


def _require_balance(chain: ClosedChain, left: float, size: float, idle: Array) -> None:
    """Refuse a load that no transmissible wrenches can balance; the message gives the residual [N]."""
    if left <= FEASIBLE * size:
        return
    if not chain.grasps:
        raise StateError("holding_torques: no arm holds the object, so nothing carries it; try a chain with grasps")
    given = [f"{len(idle)} passive joints"] if len(idle) else []
    given += ["the floating base at rest"] if chain.floats else []
    drives = f" with {' and '.join(given)}" if given else ""
    raise StateError(
        f"holding_torques: the grasps cannot bear this load{drives}: {left:.3g} N (moments over the grasps' distance)"
        " remain. Try another acceleration, more grasps, or driving more joints"
    )


@np.errstate(all="ignore")  # what overflows is refused below
def holding_torques(
    chain: ClosedChain,
    state: State,
    acceleration: Any = None,
    internal_force: Any = 0.0,
    *,
    passive: Iterable[str] = (),
) -> Array:
    """Return the torques for an acceleration of the object and a chosen internal wrench, (n,) [N m or N].

    tau = M qdd + C + J^T f + damping qd + stiffness (q - rest), with the smallest qdd that agrees with the object's
    acceleration, and the f nearest to the chosen one (in the metric of `split`) that satisfies
    A^T f = M(C) (alpha - [0; g]) + b(C). `forward_dynamics` with the result returns alpha and, if the forces are
    unique, f. Bases are assumed to stand still, and so are a trunk and its floating base; the latter has no drive, so
    arms with bases in the world must hold it. O(n) + O(l^3).

    Args:
        chain: the chain.
        state: positions and velocities, which must satisfy the grasps.
        acceleration: (6,) [omega_dot; v_dot] of C, the true acceleration, world axes; None for zero, which keeps a
            chain at rest.
        internal_force: a push of every arm along its contact normal into the object [N], or wrenches (arms, 6) of each
            arm on the object about its contact, world axes. Only the transmissible internal part of either counts.
            Of a chain with branches, loops, couplings or several objects a row for each grasp and then for each loop;
            an acceleration is then (k, 6) for k objects, and passive joints are those without a drive.
        passive: joints "arm/joint" (without a name: "arm/joint1", counted from 1) whose torque
            shall be 0; the internal wrench then deviates from the chosen one as far as necessary.

    Raises:
        StateError: a shape is wrong, the arms cannot follow the acceleration, the grasps or the driven joints cannot
            hold the load, or a joint is unknown.
    """
    if answered_as_forest(chain):
        require_unused(passive=not checks.is_listed(passive) or any(True for _ in passive))
        return mechanism_holding(chain, state, acceleration, internal_force)
    require_fit(chain, state)
    alpha = np.zeros(6) if acceleration is None else checks.numbers(acceleration, (6,), "acceleration", StateError)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain))
    idle, wished = joint_places(chain, passive), _wished(motion, internal_force)
    if not len(idle) and not chain.floats:
        found = balanced(motion, alpha, wished)
        checks.finite(np.array([*found.tau, found.left, found.size]), "holding torques")
        _require_followed(motion, found.missed, alpha)
        _require_balance(chain, float(found.left), float(found.size), idle)
        return found.tau
    qdd = joint_accelerations(motion, alpha - pseudo_gravity(chain), np.zeros(chain.joint_count))
    _require_followed(motion, missed_accelerations(motion, qdd, alpha), alpha)
    none, base = np.zeros((len(chain.arms), 6)), None
    if chain.floats:
        base = trunk_torques(motion, qdd, none, np.zeros(6)).base
    f = balancing_wrenches(motion, alpha, wished, idle, torques(motion, qdd, none)[idle], base)
    tau = checks.finite(torques(motion, qdd, f), "holding torques")
    tau[idle] = 0.0  # it is zero up to rounding
    return tau


def joint_places(chain: ClosedChain, names: Iterable[str]) -> Array:
    """Return the indices of joints named "arm/joint" in the flat arrays.

    Raises:
        StateError: there is no such joint.
    """
    places = {name: k for k, name in enumerate(chain.joint_names())}
    if not checks.is_listed(names):
        raise StateError(f"passive: expected names of joints, got {checks.short(names)}")
    names = list(names)
    for name in names:
        if not isinstance(name, str) or name not in places:
            raise StateError(f"passive: no joint {checks.short(name)}.{checks.did_you_mean(str(name), places)}")
    return np.array([places[name] for name in names], dtype=int)


def _wished(motion: ChainMotion, internal_force: Any) -> Array:
    """Return the chosen wrenches as an array (arms, 6)."""
    chain = motion.chain
    if not np.ndim(internal_force):
        return pushes(motion, float(checks.numbers(internal_force, (), "internal_force", StateError)))
    wished = checks.numbers(internal_force, (len(chain.arms), 6), "internal_force", StateError)
    for name, f in zip(chain.names, wished, strict=True):
        if name not in chain.grasps and f.any():
            raise StateError(f"internal_force: arm '{name}' holds nothing, expected zeros, got {checks.place(f)}")
    return wished


def _require_followed(motion: ChainMotion, missed: list[Missed], alpha: Array) -> None:
    """Refuse an acceleration that an arm cannot follow; the message names the arms and their errors."""
    short = [
        f"arm '{name}' misses {gap:.3g} (m/s^2 or rad/s^2)"
        for name, (gap, size) in zip(motion.chain.grasps, missed, strict=True)
        if gap > FEASIBLE * size
    ]
    if short:
        raise StateError(
            f"acceleration: expected one that the arms can follow at this state, got {checks.place(alpha)}:"
            f" {', '.join(short)}. Try a state at rest, or holdfast.diagnose for the singular directions"
        )
