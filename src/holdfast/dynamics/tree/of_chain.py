"""The solution of a closed chain by the elimination of its forest, in which every arm is a limb."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.object_motion import acceleration_at_C
from holdfast.dynamics.closed.tip_response import Route, tip_response
from holdfast.dynamics.tree.elimination import ForestSolution, factorised
from holdfast.dynamics.tree.forest_motion import BodyMotion, Carrier, ClosureMotion, ForestMotion, Limb
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration, TrunkBody
from holdfast.errors import MethodNotApplicable
from holdfast.model.chain_forest import ChainForest, chain_forest
from holdfast.model.forest import GROUND
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import array, concatenate, each

_NONE = np.zeros(3)


def tree(motion: ChainMotion, route: Route = "auto") -> Solution:
    """Return the solution of a chain as a forest: O(n) + O(l), in the order of its plan.

    Raises:
        MethodNotApplicable: the rows to impose are given.
    """
    if any(c.held is not None for c in motion.contacts):
        raise MethodNotApplicable("chooses the rows that it imposes by their pivots; try method='sequential'")
    found = _forest_of(motion.chain)
    of_forest = motion_of_chain(motion, found, route)
    rates = motion.trunk is not None and motion.trunk.by_joints
    _, whole = factorised(of_forest, plan_of(found.forest.topology, trunk=tuple(found.trunk), rates=rates))
    return _of_chain(motion, found, of_forest, whole)


def _of_chain(motion: ChainMotion, found: ChainForest, of_forest: ForestMotion, whole: ForestSolution) -> Solution:
    """Return the solution of a chain from that of its forest."""
    chain, free, none = motion.chain, motion.body.free, np.zeros(6)
    qdd = {name: concatenate([np.zeros(0), *(whole.qdd[k] for k in own)]) for name, own in found.arms.items()}
    bases = dict(zip(_names_of_limbs(motion, found), whole.bases, strict=True))
    trunk, pivots = None, None
    if motion.trunk is not None:
        first = 1 if chain.floats else 0
        joints = found.trunk[first:]
        trunk = TrunkAcceleration(
            concatenate([np.zeros(0), *(whole.qdd[k] for k in joints)]), whole.beta[0] if chain.floats else None
        )
        pivots = concatenate([np.zeros(0), *(whole.pivots[k] for k in found.trunk)])
    tips = {limb.motion.arm.name: limb.tip for limb in of_forest.all_limbs}
    return Solution(
        [qdd[name] for name in chain.grasps],
        [whole.wrenches[found.closures[name]] if name in found.closures else none for name in chain.grasps],
        acceleration_at_C(free.centre, free.centripetal, whole.beta[found.held_object]),
        base_wrenches=[bases[name] for name in chain.grasps],
        rank=whole.rank + chain.contact_freedom_count,
        weakest_pivot=whole.weakest,
        trunk=trunk,
        trunk_pivots=pivots,
    )


_forest_of = lru_cache(maxsize=8)(chain_forest)  # chains are frozen, and compared by identity


def motion_of_chain(motion: ChainMotion, found: ChainForest, route: Route = "auto") -> ForestMotion:
    """Return the motion of a chain's forest, in which every arm is a limb.

    Args:
        motion: the chain's motion.
        found: its forest.
        route: method for the tip responses, see `tip_response`.
    """
    chain, forest = motion.chain, found.forest
    bodies: list[BodyMotion | None] = [None] * len(forest.bodies)
    arms = {name: (GROUND, _NONE, arm) for name, arm in motion.arms.items()}
    rates = tuple(found.trunk) if motion.trunk is not None and motion.trunk.by_joints else ()
    if motion.trunk is not None:
        bodies[: len(found.trunk)] = [_trunk_body(body) for body in motion.trunk.bodies]
        for name, mount in motion.trunk.mounts.items():
            arms[name] = mount.body, mount.offset, motion.arms[name]
    bodies[found.held_object] = _object(motion)
    names = [name for name in chain.arms if name in chain.grasps or arms[name][0] != GROUND]
    tips = each(lambda arm: tip_response(arm, route), [arms[name][2] for name in names])
    limbs = {
        name: Limb(tuple(found.arms[name]), on, offset, False, arm, tip, rates if on != GROUND else ())
        for name, tip in zip(names, tips, strict=True)
        for on, offset, arm in [arms[name]]
    }
    about = each(lambda c: c.about(motion.body.free.centre, motion.body.free.centripetal), motion.contacts)
    contacts = dict(zip(chain.grasps, about, strict=True))
    closures = [_closure(contacts[name], limbs[name]) for name in found.closures]
    closed = {i: limbs.pop(name) for name, i in found.closures.items()}
    return ForestMotion(forest, bodies, closures, [], closed, list(limbs.values()))


def _names_of_limbs(motion: ChainMotion, found: ChainForest) -> Sequence[str]:
    """Return the names of the limbs, in their order."""
    chain = motion.chain
    others = [name for name in chain.arms if name in chain.grasps or name in chain.mounted_on]
    return [*found.closures, *(name for name in others if name not in found.closures)]


def _closure(c: Contact, limb: Limb) -> ClosureMotion:
    arm = limb.motion
    return ClosureMotion(
        c, arm.at.tip, limb.offset + arm.base_to_tip, c.offset, c.g, arm.bias.tip_acceleration, c.a
    )


def _trunk_body(body: TrunkBody) -> BodyMotion:
    at, none = Carrier(body.frame, _NONE, body.twist, body.zeta), np.zeros(6)
    if body.H is None or body.joint is None:
        return BodyMotion(at, body.reach, np.eye(6), body.inertia.symmetric(), body.wrench, none, none, none)
    torque, armature = array([body.torque]), np.array([body.joint.armature])
    return BodyMotion(at, body.reach, body.H[:, None], body.inertia.symmetric(), body.wrench, torque, armature, none)


def _object(motion: ChainMotion) -> BodyMotion:
    """Return the object about its mass centre, without gravity: its accelerations are less [0; g]."""
    free, none = motion.body.free, np.zeros(6)
    at = Carrier(Pose.identity(), free.centre, none, none)
    inertia = motion.body.inertia.inertia_shifted(-free.centre)
    return BodyMotion(at, free.centre, np.eye(6), inertia, none, none, none, free.wrench, free)

