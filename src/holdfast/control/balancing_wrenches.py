"""Grasp wrenches that carry the object, spare the undriven joints, and are as near as can be to wished ones."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, pseudo_gravity
from holdfast.dynamics.split import length_scale
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench

POSSIBLE = 1e-8  # of the sizes at hand: what may be left of a balance
DEPENDENT = 1e-12  # of the largest singular value


def balancing_wrenches(motion: ChainMotion, alpha: Array, wished: Array, idle: Array, free: Array) -> Array:
    """Return the transmissible wrenches nearest to the wished ones that balance, (arms, 6).

    min |lambda - K f_wished| in the metric of the force split (moments over its length), with
    A^T K^T lambda = M(C) (alpha - [0; g]) + b(C) and (J^T K^T lambda)_j = -(M qdd + C)_j at
    undriven joints j.

    Args:
        motion: the chain in motion.
        alpha: (6,) acceleration of C, true, world axes.
        wished: (arms, 6) about the contacts, world axes; of rows of arms that hold.
        idle: places of the undriven joints in the flat arrays.
        free: (idle,) their torques M qdd + C + damping qd [N m or N].

    Raises:
        StateError: no wrenches balance.
    """
    chain = motion.chain
    holding = [chain.names.index(name) for name in chain.grasps]
    length = length_scale([c.offset for c in motion.contacts])
    needed = motion.body.inertia.apply(alpha - pseudo_gravity(chain)) + motion.body.bias
    unit = np.r_[np.full(3, 1 / length), np.ones(3)]  # moments in newtons
    torque_unit = np.array([1 / length if j.kind == "revolute" else 1.0 for a in chain.arms.values() for j in a.joints])
    columns, start, root = [np.zeros((6 + len(idle), 0))], [np.zeros(0)], [np.zeros(0)]
    for i, (name, c) in zip(holding, zip(chain.grasps, motion.contacts, strict=True), strict=True):
        K, torques = c.K, np.zeros((chain.joint_count, len(c.K)))
        torques[chain.joints[name]] = (K @ jacobian(chain.arms[name], motion.arms[name].at)).T
        to_C = np.array([shift_wrench(c.offset, row) for row in K]).T
        columns.append(np.concatenate([unit[:, None] * to_C, (torque_unit[:, None] * torques)[idle]]))
        start.append(K @ wished[i])
        root.append(np.array([length if row < 3 else 1.0 for row in c.grasp.transmitted]))
    E, lam, root = np.concatenate(columns, axis=1), np.concatenate(start), np.concatenate(root)
    e = np.concatenate([unit * needed, -torque_unit[idle] * free])
    if lam.size:
        lam = lam + root * np.linalg.lstsq(E * root, e - E @ lam, rcond=DEPENDENT)[0]
    _require_balance(chain, E @ lam - e, max(1.0, float(np.abs(e).max()), float(np.abs(lam).max(initial=0.0))), idle)
    f = np.zeros((len(chain.arms), 6))
    ends = np.cumsum([len(c.grasp.transmitted) for c in motion.contacts])[:-1]
    for i, c, part in zip(holding, motion.contacts, np.split(lam, ends), strict=False):
        f[i] = c.K.T @ part
    return f


def _require_balance(chain: ClosedChain, left: Array, size: float, idle: Array) -> None:
    """Refuse a load that no transmissible wrenches bear, naming what is left of it [N]."""
    object_left, joint_left = np.abs(left[:6]).max(), np.abs(left[6:]).max(initial=0.0)
    if max(object_left, joint_left) <= POSSIBLE * size:
        return
    if not chain.grasps:
        raise StateError("holding_torques: no arm holds the object, so nothing bears it; try a chain with grasps")
    drives = f" and leave {len(idle)} joints undriven" if len(idle) else ""
    raise StateError(
        f"holding_torques: the grasps cannot bear this load{drives}: {max(object_left, joint_left):.3g} N (moments over"
        " the grasps' distance) are left. Try another acceleration, more grasps, or driving more joints"
    )
