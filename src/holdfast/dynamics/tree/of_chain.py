"""A closed chain as a forest in which every arm is a limb: the elimination of its object and of its trunk.

The arms' tip responses are given; whoever calls decides how they are found, and with which loads. One part holds
everything: the object, the arms as leaves of the trunk's bodies and of the world, and the joints of the trunk, over
which the root moves from the outermost body inward (docs/theory/tree.md, docs/theory/trunk.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.object_motion import FreeBody, acceleration_at_C
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.tree.crossing import across
from holdfast.dynamics.tree.elimination import factorised, inward, solve
from holdfast.dynamics.tree.forest_motion import BodyMotion, Carrier, ClosureMotion, ForestMotion, Limb
from holdfast.dynamics.tree.leaves import Leaves
from holdfast.dynamics.tree.order import CloseFrame, CrossAll, MeasureLeaves, PlanStep
from holdfast.dynamics.tree.outward import ForestFactors
from holdfast.dynamics.tree.plan import EliminationPlan, plan_of
from holdfast.dynamics.tree.right_hand_sides import ForestLoads, Outward
from holdfast.dynamics.trunk.trunk_motion import NO_TRUNK, TrunkAcceleration, TrunkBody, TrunkMotion
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.forest import GROUND, Topology
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.spatial.symmetric import symmetric6

_NONE = np.zeros(3)


class ChainGraph(NamedTuple):
    """The graph of a chain: the bodies of the trunk, then those of the arms in order, and the object.

    Attributes:
        topology: the graph.
        trunk: the bodies of the trunk, beginning with a floating base.
        arms: by name, the bodies of every arm; none for an anchor.
        held_object: the object's body.
        closures: by the name of an arm, the closure of its grasp; none for a bushing.
        grasps: names of the arms with a grasp.
        couplings: none.
    """

    topology: Topology
    trunk: range
    arms: Mapping[str, range]
    held_object: int
    closures: Mapping[str, int]
    grasps: Sequence[str]
    couplings: tuple[()] = ()


class ChainFactors(NamedTuple):
    """The factors of a chain, for further right-hand sides.

    Attributes:
        graph: its graph.
        free: the object.
        trunk: the trunk's motion.
        forest: factors of the forest.
    """

    graph: ChainGraph
    free: FreeBody
    trunk: TrunkMotion
    forest: ForestFactors


class ChainLoads(NamedTuple):
    """A right-hand side of a chain at rest.

    Attributes:
        gaps: per grasp, (6,) relative acceleration at the tip without any force, about the contact point.
        wrench: (6,) wrench on the object about C, world axes.
        trunk: the trunk at rest with its loads.
        tips: by name, the tip responses of the arms on the trunk, of which the loads at their bases matter.
    """

    gaps: Sequence[Array]
    wrench: Array
    trunk: TrunkMotion = NO_TRUNK
    tips: Mapping[str, TipResponse] = MappingProxyType({})


class ChainResponse(NamedTuple):
    """The accelerations and forces of a chain without those of the arms' joints, as in `ChainElimination`."""

    wrenches: list[Array]
    object_acceleration: Array
    trunk: TrunkAcceleration
    betas: Sequence[Array]
    columns: Mapping[str, Array]


class ChainElimination(NamedTuple):
    """The accelerations and forces of a chain, without those of the arms' joints.

    Attributes:
        wrenches: per grasp, (6,) f about the contact point, world axes.
        object_acceleration: (6,) alpha(C) minus [0; g], world axes.
        trunk: acceleration of the trunk.
        betas: per body of the trunk, beta (6,).
        columns: by arm on the trunk, the accelerations of its columns, (c,).
        rank: number of independent rows of the constraint, contact freedoms included.
        weakest_pivot: the smallest pivot for an independent row, relative to a typical one.
        independent: per grasp, (rows,) 1 for the independent rows, if the contacts have masks of rows.
        factors: for further right-hand sides; None of a solution that was chosen among several.
        pivots: inertias about the trunk's joints, > 0 if its mass matrix is regular.
        second: the response to the argument `second`.
    """

    wrenches: list[Array]
    object_acceleration: Array
    trunk: TrunkAcceleration
    betas: Sequence[Array]
    columns: Mapping[str, Array]
    rank: Scalar
    weakest_pivot: Scalar
    independent: list[Array]
    factors: ChainFactors | None
    pivots: Array
    second: ChainResponse | None = None


def chain_elimination(
    chain: ClosedChain,
    contacts: Sequence[Contact],
    tips: Mapping[str, TipResponse],
    free: FreeBody,
    trunk: TrunkMotion,
    tolerance: float = RANK_TOLERANCE,
    second: ChainLoads | None = None,
) -> ChainElimination:
    """Return grasp wrenches, and the accelerations of object and trunk. O(l) + O(n_t).

    Args:
        chain: the chain.
        contacts: the grasps, in the order of the arms that have one.
        tips: by name, the tip responses of these arms, and of those on the trunk without a grasp.
        free: the object.
        trunk: the trunk's motion.
        tolerance: relative size of a pivot that counts as zero.
        second: another right-hand side that is known in advance, see `solved_again`.
    """
    graph, about = chain_graph(chain, trunk), each(lambda c: c.about(free.centre, free.centripetal), contacts)
    motion = _forest_motion(chain, graph, about, tips, free, trunk)
    others = [] if second is None else [_at_rest(graph, motion, free, second)]
    forest, (found, *more) = factorised(motion, _plan(graph, trunk), tolerance, others)
    factors = ChainFactors(graph, free, trunk, forest)
    return ChainElimination(
        *_response(factors, free, found),
        forest.rank + chain.contact_freedom_count,
        forest.weakest,
        _independent(graph, forest),
        factors,
        _pivots(graph, forest),
        None if second is None else _response(factors, free.at_rest(), more[0]),
    )


def solved_again(factors: ChainFactors, loads: ChainLoads) -> ChainResponse:
    """Return the response of a chain at rest to other loads, by its factors. O(l) + O(n_t)."""
    rhs = _at_rest(factors.graph, factors.forest.motion, factors.free, loads)
    (found,) = solve(factors.forest, [rhs])
    return _response(factors, factors.free.at_rest(), found)


class RestResponse(NamedTuple):
    """A chain's response at a configuration.

    Attributes:
        mobility: (6, 6) of the object in the chain at C, world axes.
        rank: number of independent rows of the constraint, contact freedoms included.
        weakest_pivot: the smallest pivot of these rows, relative to a typical one.
    """

    mobility: Array
    rank: Scalar
    weakest_pivot: Scalar


def object_response(
    chain: ClosedChain,
    contacts: Sequence[Contact],
    tips: Mapping[str, TipResponse],
    free: FreeBody,
    trunk: TrunkMotion,
) -> RestResponse:
    """Return the mobility of a chain's object, which stays open to the end. O(l) + O(n_t); see `chain_elimination`."""
    graph, about = chain_graph(chain, trunk), each(lambda c: c.about(free.centre, free.centripetal), contacts)
    motion, plan = _forest_motion(chain, graph, about, tips, free, trunk), _plan(graph, trunk)
    left_open = tuple(tuple(one for step in steps for one in _without_closing(step)) for steps in plan.steps)
    forest, _ = inward(motion, plan._replace(steps=left_open))
    mobility = free.mobility
    for i, part in forest.parts.items():
        now, root = part.belief, plan.parts[i].root
        if now.frames:
            now = now if root == GROUND else across(now, forest.settled[root], GROUND)[0]
            P = now.dense()
            mobility = symmetric6(now.factors.dense() if P is None else P)
    rank = forest.rank + chain.contact_freedom_count
    return RestResponse(mobility.mobility_shifted(-free.centre).dense(), rank, forest.weakest)


def _without_closing(step: PlanStep) -> list[PlanStep]:
    if isinstance(step, MeasureLeaves):
        return [step._replace(closes=None)]
    return [] if isinstance(step, CloseFrame) else [step]


def chain_graph(chain: ClosedChain, trunk: TrunkMotion) -> ChainGraph:
    """Return the graph of a chain."""
    count = len(trunk.bodies)
    parents = [*range(-1, count - 1)]
    arms: dict[str, range] = {}
    ends: list[tuple[int, int]] = []
    for name, arm in chain.arms.items():
        start = len(parents)
        arms[name] = range(start, start + arm.joint_count)
        parents += [_standing_on(chain, name), *range(start, start + arm.joint_count - 1)][: arm.joint_count]
    held = len(parents)
    closures: dict[str, int] = {}
    for name, grasp in chain.grasps.items():
        if grasp.of_kind.bushing is None:
            closures[name] = len(ends)
            ends.append((arms[name][-1] if arms[name] else _standing_on(chain, name), held))
    free = tuple((trunk.floats and k == 0) or k == held for k in range(held + 1))
    return ChainGraph(
        Topology((*parents, GROUND), free, tuple(ends), ()), range(count), arms, held, closures, [*chain.grasps]
    )


def _standing_on(chain: ClosedChain, name: str) -> int:
    body = chain.mounted_on.get(name)
    return GROUND if body is None else body


def _plan(graph: ChainGraph, trunk: TrunkMotion) -> EliminationPlan:
    return plan_of(graph.topology, trunk=tuple(graph.trunk), rates=trunk.by_joints)


def _forest_motion(
    chain: ClosedChain,
    graph: ChainGraph,
    contacts: Sequence[Contact],
    tips: Mapping[str, TipResponse],
    free: FreeBody,
    trunk: TrunkMotion,
) -> ForestMotion:
    """Return the motion of a chain's forest, in which every arm is a limb."""
    bodies: list[BodyMotion | None] = [None] * len(graph.topology.parents)
    bodies[: len(graph.trunk)] = [_trunk_body(body) for body in trunk.bodies]
    bodies[graph.held_object] = _object(free)
    limbs = {name: _limb(trunk, name, tip) for name, tip in tips.items()}
    about = dict(zip(chain.grasps, contacts, strict=True))
    closures = [_closure(about[name]) for name in graph.closures]
    closed = {i: limbs.pop(name) for name, i in graph.closures.items()}
    return ForestMotion(graph, bodies, closures, [], closed, list(limbs.values()))


def _limb(trunk: TrunkMotion, name: str, tip: TipResponse) -> Limb:
    mount = trunk.mounts.get(name)
    return Limb(GROUND, _NONE, tip) if mount is None else Limb(mount.body, mount.offset, tip)


def _closure(c: Contact) -> ClosureMotion:
    """Return a grasp as a closure; the free acceleration of the arm is part of its response."""
    return ClosureMotion(c, Pose.identity(), _NONE, c.offset, c.g, np.zeros(6), c.a)


def _trunk_body(body: TrunkBody) -> BodyMotion:
    at, none = Carrier(body.frame, _NONE, body.twist, body.zeta), np.zeros(6)
    if body.H is None or body.joint is None:
        return BodyMotion(at, body.reach, np.eye(6), body.inertia.symmetric(), body.wrench, none, none, none)
    torque, armature = array([body.torque]), np.array([body.joint.armature])
    return BodyMotion(at, body.reach, body.H[:, None], body.inertia.symmetric(), body.wrench, torque, armature, none)


def _object(free: FreeBody) -> BodyMotion:
    """Return the object about its mass centre; its accelerations are less [0; g], as zeta = 0."""
    none = np.zeros(6)
    at = Carrier(Pose.identity(), free.centre, none, none)
    return BodyMotion(at, free.centre, np.eye(6), free.inertia, none, none, none, free.wrench, free)


def _at_rest(graph: ChainGraph, motion: ForestMotion, free: FreeBody, loads: ChainLoads) -> ForestLoads:
    """Return the right-hand side of a chain at rest."""
    none = np.zeros(6)
    bodies = [*motion.bodies]
    bodies[: len(graph.trunk)] = [_trunk_body(body) for body in loads.trunk.bodies]
    bodies[graph.held_object] = bodies[graph.held_object]._replace(wrench=shift_wrench(-free.centre, loads.wrench))
    pairs = zip(graph.grasps, loads.gaps, strict=True)
    by_closure = {graph.closures[name]: gap for name, gap in pairs if name in graph.closures}
    limbs = [_limb(loads.trunk, name, tip) for name, tip in loads.tips.items()]
    return ForestLoads(bodies, {graph.held_object: none}, motion.closures, [], limbs, by_closure)


def _response(factors: ChainFactors, free: FreeBody, found: Outward) -> ChainResponse:
    """Return the response of object and trunk."""
    graph, trunk = factors.graph, factors.trunk
    qdd = concatenate([np.zeros(0), *(found.qdd[k] for k in graph.trunk[int(trunk.floats) :])])
    return ChainResponse(
        _wrenches(factors, found),
        acceleration_at_C(free.centre, free.centripetal, found.beta[graph.held_object]),
        TrunkAcceleration(qdd, found.qdd[0] if trunk.floats else None),
        [found.beta[k] for k in graph.trunk],
        {name: qdd if trunk.by_joints else found.beta[mount.body] for name, mount in trunk.mounts.items()},
    )


def _wrenches(factors: ChainFactors, found: Outward) -> list[Array]:
    """Return the wrench of every grasp; none along the rows that a bushing does not have."""
    closures, none = factors.graph.closures, np.zeros(6)
    return [found.wrenches[closures[name]] if name in closures else none for name in factors.graph.grasps]


def _independent(graph: ChainGraph, forest: ForestFactors) -> list[Array]:
    """Return per grasp which of its rows are independent; empty if they have no masks."""
    found: dict[int, Array | None] = {}
    for part in forest.parts.values():
        for leaves in part.factors:
            if isinstance(leaves, Leaves):
                by_rows = leaves.leaves[len(leaves.leaves) - len(leaves.rows) :]
                pairs = zip(by_rows, leaves.independent, strict=True)
                found |= {leaf.step.closure: independent for leaf, independent in pairs}
    masks = [found.get(graph.closures[name]) if name in graph.closures else np.zeros(0) for name in graph.grasps]
    return [mask for mask in masks if mask is not None]


def _pivots(graph: ChainGraph, forest: ForestFactors) -> Array:
    """Return the inertias about the trunk's joints, (n_t,)."""
    for i, part in forest.parts.items():
        for step, found in zip(forest.plan.steps[i], part.factors, strict=True):
            if isinstance(step, CrossAll):
                return found.factors.pivots[::-1]
    return concatenate([np.zeros(0), *(forest.settled[k].factors.pivots for k in graph.trunk)])
