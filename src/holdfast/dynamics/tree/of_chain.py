"""The solution of a closed chain by the elimination of its forest."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, pseudo_gravity
from holdfast.dynamics.tree.elimination import solved
from holdfast.dynamics.tree.forest_motion import ForestMotion, forest_motion, moving_world
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration
from holdfast.errors import MethodNotApplicable
from holdfast.model.chain_forest import ChainForest, chain_forest
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.spatial_vector import shift_wrench


def tree(motion: ChainMotion) -> Solution:
    """Return the solution of a chain as a forest: O(n) + O(l), in the order of its plan.

    Raises:
        MethodNotApplicable: the rows to impose are given.
    """
    if any(c.held is not None for c in motion.contacts):
        raise MethodNotApplicable("chooses the rows that it imposes by their pivots; try method='sequential'")
    chain, found = motion.chain, _forest_of(motion.chain)
    of_forest = motion_of_chain(motion, found)
    whole = solved(of_forest, plan_of(found.forest.topology))
    qdd = {name: concatenate([whole.qdd[k] for k in own]) for name, own in found.arms.items()}
    none = np.zeros(6)
    held = of_forest.bodies[found.held_object]
    alpha = held.true_acceleration(whole.beta[found.held_object], chain.gravity)
    trunk = None
    if chain.trunk is not None:
        first = 1 if chain.floats else 0
        base = of_forest.bodies[0].true_acceleration(whole.beta[0], chain.gravity) if chain.floats else None
        trunk = TrunkAcceleration(concatenate([whole.qdd[k] for k in found.trunk[first:]]), base)
    return Solution(
        [qdd[name] for name in chain.grasps],
        [whole.wrenches[found.closures[name]] if name in found.closures else none for name in chain.grasps],
        alpha - pseudo_gravity(chain),
        rank=whole.rank + chain.contact_freedom_count,
        weakest_pivot=whole.weakest,
        trunk=trunk,
    )


_forest_of = lru_cache(maxsize=8)(chain_forest)  # chains are frozen, and compared by identity


def motion_of_chain(motion: ChainMotion, found: ChainForest) -> ForestMotion:
    """Return the motion of a chain's forest, with the same torques and wrenches, and those of its force elements.

    Args:
        motion: the chain's motion.
        found: its forest.
    """
    chain, forest = motion.chain, found.forest
    parts: dict[int, tuple[Array, Array, Array]] = {}
    wrenches = np.zeros((len(forest.bodies), 6))
    under, behind = {}, {}
    if motion.trunk_case is not None and motion.trunk is not None:
        case, first = motion.trunk_case, 1 if chain.floats else 0
        if chain.floats:
            parts[0] = case.base.wxyz_xyz, case.base_twist, np.zeros(6)
        elif found.trunk:
            under[0] = moving_world(case.base.p, case.base_twist, case.base_acceleration)
        for k, at in zip(found.trunk[first:], range(len(case.q)), strict=True):
            parts[k] = case.q[[at]], case.qd[[at]], np.array([motion.trunk.bodies[k].torque])
        wrenches[: len(found.trunk)] += case.wrenches
    for name, own in found.arms.items():
        arm, given = motion.arms[name], motion.cases[name].given
        for k, body in enumerate(own):
            parts[body] = given.q[[k]], given.qd[[k]], arm.torque[[k]]
        if given.link_wrenches is not None:
            wrenches[own.start : own.stop] += given.link_wrenches
        mount = chain.mounted_on.get(name)
        if mount is None:
            world = moving_world(given.arm.base.p, given.base_twist, given.base_acceleration)
            if own:
                under[own[0]] = world
            elif name in found.closures:
                behind[found.closures[name]] = world
        if arm.known is not None and own:
            wrenches[own[-1]] -= shift_wrench(arm.at.reach[-1], arm.known)
        elif arm.known is not None and mount is not None and motion.trunk is not None:
            wrenches[mount] -= shift_wrench(motion.trunk.mounts[name].offset + arm.base_to_tip, arm.known)
    held = motion.object_case
    assert held is not None
    parts[found.held_object] = held.frame.wxyz_xyz, held.twist, np.zeros(6)
    wrenches[found.held_object] = held.wrench
    q, qd, torque = (concatenate([parts[k][i] for k in range(len(forest.bodies))]) for i in range(3))
    return forest_motion(forest, q, qd, torque, wrenches, under, behind)
