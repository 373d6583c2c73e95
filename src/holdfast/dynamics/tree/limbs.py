"""Limbs of a forest: chains of joints with one degree of freedom that end at one closure, each solved as an arm.

What a limb does to the rest follows from its tip response, in the axes of its links, which takes fewer operations than
to carry its bodies one by one. The elimination takes it as a leaf, and its joints follow from its wrench and from the
acceleration of the body on which it stands (`tip_response`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.arm.motion import ArmInputs, ArmMotion, arm_motion, at_rest
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.closed.tip_response import TipResponse, responded, tip_response
from holdfast.dynamics.tree.elimination import Tips, contradictions, factorised, left_over, right_hand_side, solve
from holdfast.dynamics.tree.forest_motion import Carrier, ClosureMotion, ForestMotion, Limb, forest_motion, still_world
from holdfast.dynamics.tree.order import AddFree, CloseFrame, MeasureLeaves
from holdfast.dynamics.tree.outward import ForestFactors
from holdfast.dynamics.tree.plan import EliminationPlan, plan_of
from holdfast.dynamics.tree.right_hand_sides import Outward
from holdfast.model.arm import Arm
from holdfast.model.forest import GROUND, Closure, Forest
from holdfast.model.joint import Joint
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each
from holdfast.spatial.spatial_vector import shift_twist


class LimbArm(NamedTuple):
    """A limb by itself.

    Attributes:
        closure: the closure that it ends.
        joints: its bodies.
        is_b: whether its last body is the closure's body b.
        on: the body on which it stands; `GROUND` for the world.
        base: pose of its base in the frame of that body.
        arm: its joints and links; the tip is the contact point. Limbs that differ only where they stand are equal.
    """

    closure: int
    joints: tuple[int, ...]
    is_b: bool
    on: int
    base: Pose
    arm: Arm


class LimbMotion(NamedTuple):
    """A limb at one instant: its arm, the closure that it ends, and its tip response."""

    limb: LimbArm
    arm: ArmMotion
    closure: ClosureMotion
    tip: TipResponse


class LimbedMotion(NamedTuple):
    """A forest at one instant, with limbs.

    Attributes:
        motion: the forest's motion, with None for the bodies of limbs.
        limbs: by closure, the limbs.
    """

    motion: ForestMotion
    limbs: Mapping[int, LimbMotion]


class LimbedSolution(NamedTuple):
    """Accelerations and forces of a forest with limbs, in world axes; names as in `ForestSolution`.

    Attributes:
        qdd: per body, (m,) joint accelerations; of a free body, (6,) the true acceleration of its frame's origin.
        wrenches: per closure, (6,).
        multipliers: per coupling.
        rank, weakest: as in `ForestSolution`.
        left: per closure, and then per coupling, what accelerations leave of its rows, relative to their terms.
        pivots: articulated inertias of the joints outside limbs, > 0 if the mass matrix is regular.
    """

    qdd: list[Array]
    wrenches: list[Array]
    multipliers: list[Scalar]
    rank: Scalar
    weakest: Scalar
    left: list[Scalar]
    pivots: Array


def limb_arms(forest: Forest) -> list[LimbArm]:
    """Return the limbs among the leaves of a forest's plan."""
    topology, found = forest.topology, []
    needed = Counter([*topology.parents, *(k for ends in topology.ends for k in ends)])
    needed.update(k for bodies in topology.coupled for k in bodies)
    for steps in plan_of(topology).steps:
        for leaf in (one for step in steps if isinstance(step, MeasureLeaves) for one in step.leaves):
            single = [forest.bodies[k].joint.of_kind.freedoms == 1 for k in leaf.joints]
            bare = [needed[k] == 1 for k in leaf.joints]  # by the next body, or by the closure
            closure = forest.closures[leaf.closure]
            moves = leaf.is_b and closure.grasp.of_kind.slides  # the contact point would move on the limb
            if leaf.joints and all(single) and all(bare) and not moves:
                base = forest.bodies[leaf.joints[0]].joint.placement
                on, arm = topology.parents[leaf.joints[0]], _arm(forest, leaf.joints, closure, leaf.is_b)
                found.append(LimbArm(leaf.closure, leaf.joints, leaf.is_b, on, base, arm))
    return found


def _arm(forest: Forest, bodies: Sequence[int], closure: Closure, is_b: bool) -> Arm:
    tip = Pose.translation(*closure.grasp.frame.p) if is_b else closure.tip
    joints, links, place = [], [], Pose.identity()
    for k in bodies:
        joint, link = forest.bodies[k].joint, forest.bodies[k].link
        assert joint.kind != "free"
        joints.append(Joint(joint.kind, joint.axis, place, pitch=joint.pitch, armature=joint.armature))
        links.append(replace(link, name=""))
        place = forest.bodies[bodies[len(links)]].joint.placement if len(links) < len(bodies) else place
    return Arm(joints, links, tip=tip)


def limbed_motion(
    forest: Forest, arms: Sequence[LimbArm], q: Array, qd: Array, torque: Array, wrenches: Array | None = None
) -> LimbedMotion:
    """Return the motion of a forest with limbs, O(bodies + closures).

    Args:
        forest: the forest.
        arms: its limbs; see `limb_arms`.
        q: (n_q,) positions.
        qd: (n_v,) rates.
        torque: (n_v,) torques without those of dampers; for a free body a wrench about its frame's origin.
        wrenches: (bodies, 6) external wrenches about the frames' origins, world axes; None for none.
    """
    loads = np.zeros((len(forest.bodies), 6)) if wrenches is None else wrenches
    motion = forest_motion(forest, q, qd, torque, loads, within={k for one in arms for k in one.joints})
    carriers = [*(None if body is None else body.at for body in motion.bodies), still_world(forest.gravity)]
    given, offsets = [], []
    for one in arms:
        at = carriers[one.on]
        assert at is not None
        pushed = None if wrenches is None else wrenches[list(one.joints)]
        offsets.append(at.frame.R @ one.base.p - at.centre)
        given.append(_inputs(one, at, offsets[-1], *_joints_of(forest, one, q, qd, torque), pushed))
    limbs, on_bodies, closures = {}, {}, [*motion.closures]
    for one, l, (arm, tip) in zip(arms, offsets, each(_in_motion, given), strict=True):
        closure = forest.closures[one.closure]
        other = closure.a if one.is_b else closure.b
        at = carriers[GROUND if other is None else other]
        assert at is not None
        closed = _as_body_b(closure, arm, at) if one.is_b else _as_body_a(closure, arm, at)
        limbs[one.closure] = LimbMotion(one, arm, closed, tip)
        on_bodies[one.closure] = Limb(one.on, l, tip)
        closures[one.closure] = closed
    return LimbedMotion(motion._replace(closures=closures, limbs=on_bodies), limbs)


def _inputs(
    one: LimbArm, at: Carrier, l: Array, q: Array, qd: Array, torque: Array, wrenches: Array | None
) -> ArmInputs:
    columns = None
    if one.on != GROUND:
        columns = array([shift_twist(l, column) for column in np.eye(6)]).T
    base = Pose.unchecked(at.frame.R @ one.base.R, at.point + l)
    return ArmInputs(one.arm.standing_at(base), q, qd, torque, at.twist_at(l), at.zeta_at(l), wrenches, columns)


def _joints_of(forest: Forest, one: LimbArm, q: Array, qd: Array, torque: Array) -> tuple[Array, Array, Array]:
    at_q, at_v = ([of[k].start for k in one.joints] for of in (forest.positions, forest.velocities))
    return q[at_q], qd[at_v], torque[at_v]


def _in_motion(given: ArmInputs) -> tuple[ArmMotion, TipResponse]:
    arm = arm_motion(given)
    return arm, tip_response(arm, "auto")


def _as_body_a(closure: Closure, arm: ArmMotion, other: Carrier) -> ClosureMotion:
    """Return the closure that a limb ends as body a, without its free acceleration, which is in its response."""
    c = contact(closure.grasp, other.frame, other.twist_at(-other.centre), arm.at.tip, arm.tip_twist)
    l = c.offset - other.centre
    return ClosureMotion(_anywhere(c), arm.at.tip, np.zeros(3), l, c.g, np.zeros(6), other.zeta_at(l))


def _as_body_b(closure: Closure, arm: ArmMotion, other: Carrier) -> ClosureMotion:
    """Return the closure that a limb ends as body b, likewise."""
    end, reach = arm.at.tip, other.frame.R @ closure.tip.p
    to_origin, l = -(end.R @ closure.grasp.frame.p), reach - other.centre
    tip = Pose.unchecked(other.frame.R @ closure.tip.R, other.frame.p + reach)
    frame, twist = Pose.unchecked(end.R, end.p + to_origin), shift_twist(to_origin, arm.tip_twist)
    c = contact(closure.grasp, frame, twist, tip, other.twist_at(l))
    return ClosureMotion(_anywhere(c), tip, l, np.zeros(3), c.g, other.zeta_at(l), np.zeros(6))


def _anywhere(c: Contact) -> Contact:
    """Return a contact whose grasp stands nowhere in particular, so that those of equal kind share their code."""
    return replace(c, grasp=c.grasp.standing_at(Pose.identity()))


def solved_with_limbs(limbed: LimbedMotion, plan: EliminationPlan) -> LimbedSolution:
    """Return the accelerations and forces of a forest, after taking back what rounding left of its closures.

    Nothing need be taken back if all loops consist of limbs and free bodies, as in a chain; see `elimination.solved`.

    Args:
        limbed: its motion.
        plan: the order.
    """
    motion, limbs = limbed
    factors, (found,) = factorised(motion, plan)
    both = _accelerations(found, limbs, [(m.arm, m.tip) for m in limbs.values()])
    if not _all_in_limbs(plan, limbs):
        both = both.plus(_of_what_is_left(limbed, factors, both))
    free = {k: body for k, body in enumerate(motion.bodies) if body is not None and body.floats}
    gravity = motion.forest.gravity
    return LimbedSolution(
        [
            free[k].true_acceleration(both.beta[k], gravity) if k in free else both.qdd[k]
            for k in range(len(motion.bodies))
        ],
        [both.wrenches[i] for i in range(len(motion.closures))],
        [both.multipliers[i] for i in range(len(motion.couplings))],
        factors.rank,
        factors.weakest,
        contradictions(motion, both.qdd, both.beta, both.tips),
        concatenate([np.zeros(0), *(one.factors.pivots for one in factors.settled.values() if not one.motion.floats)]),
    )


def _all_in_limbs(plan: EliminationPlan, limbs: Container[int]) -> bool:
    """Return whether every closure ends a limb, and no joint is in a loop besides."""
    steps = [step for steps in plan.steps for step in steps]
    leaves = [leaf for step in steps if isinstance(step, MeasureLeaves) for leaf in step.leaves]
    simple = all(isinstance(step, AddFree | MeasureLeaves | CloseFrame) for step in steps)
    return simple and all(leaf.closure in limbs for leaf in leaves)


def _of_what_is_left(limbed: LimbedMotion, factors: ForestFactors, first: _Accelerations) -> _Accelerations:
    """Return the solution at rest for what accelerations leave of the rows."""
    return _at_rest_with(limbed, factors, *left_over(limbed.motion, first.qdd, first.beta, first.tips))


def _at_rest_with(
    limbed: LimbedMotion, factors: ForestFactors, gaps: list[Array], coupled: list[Scalar]
) -> _Accelerations:
    """Return the solution of the forest at rest with other right-hand sides of its rows."""
    motion, limbs = limbed
    rest = motion.at_rest_with(gaps, coupled)
    of_limbs = {i: (-gaps[i] if m.limb.is_b else gaps[i]) @ m.closure.K for i, m in limbs.items()}
    (again,) = solve(factors, [right_hand_side(rest)._replace(limbs=(), gaps=of_limbs)])
    still = each(_at_rest, [m.arm for m in limbs.values()], [m.tip for m in limbs.values()])
    return _accelerations(again, limbs, still)


def changes_with_limbs(
    limbed: LimbedMotion, plan: EliminationPlan, sides: Sequence[tuple[list[Array], list[Scalar]]]
) -> tuple[Scalar, list[Array]]:
    """Return the rank, and the smallest changes of rates in the kinetic metric with given effects on the rows.

    Args:
        limbed: the forest's motion, of which only the configuration matters.
        plan: the order.
        sides: per change, its effect on the rows of closures, (rows,) each, and of couplings.

    Returns:
        The rank of the rows, and per change (n_v,) in the coordinates of qd.
    """
    motion, found = limbed.motion, []
    factors, _ = factorised(motion, plan)
    for gaps, coupled in sides:
        moved = _at_rest_with(limbed, factors, gaps, coupled)
        rates = [moved.qdd[k] if body is None else body.of_frame(moved.qdd[k]) for k, body in enumerate(motion.bodies)]
        found.append(concatenate(rates))
    return factors.rank, found


class _Accelerations(NamedTuple):
    """Accelerations and forces by body, closure and coupling, and accelerations of limbs' tips; see `left_over`."""

    qdd: Mapping[int, Array]
    beta: Mapping[int, Array]
    wrenches: Mapping[int, Array]
    multipliers: Mapping[int, Scalar]
    tips: Tips

    def plus(self, other: _Accelerations) -> _Accelerations:
        def summed(own: Mapping[Any, Any], more: Mapping[Any, Any]) -> dict[Any, Any]:
            return {key: x + more[key] for key, x in own.items()}

        return _Accelerations(*map(summed, self, other))


def _accelerations(
    found: Outward, limbs: Mapping[int, LimbMotion], loaded: Sequence[tuple[ArmMotion, TipResponse]]
) -> _Accelerations:
    """Return a solution with the joints of limbs, whose motions and tip responses are those of its loads."""
    forces = [-found.wrenches[i] if m.limb.is_b else found.wrenches[i] for i, m in limbs.items()]
    bases = [None if m.limb.on == GROUND else found.beta[m.limb.on] for m in limbs.values()]
    moved = each(_moved, [arm for arm, _ in loaded], [tip for _, tip in loaded], forces, bases)
    qdd, tips = dict(found.qdd), {}
    for (i, m), (rates, tip) in zip(limbs.items(), moved, strict=True):
        qdd |= {k: rates[j : j + 1] for j, k in enumerate(m.limb.joints)}
        tips[i, m.limb.is_b] = tip
    return _Accelerations(qdd, found.beta, found.wrenches, found.multipliers, tips)


def _moved(arm: ArmMotion, tip: TipResponse, f: Array, beta: Array | None) -> tuple[Array, Array]:
    """Return the joint accelerations of a limb, and that of its tip."""
    qdd, _ = responded(tip, f, beta)
    base = None if beta is None or arm.base_columns is None else arm.base_columns @ beta
    return qdd, tip_acceleration(arm, qdd, base)


def _at_rest(arm: ArmMotion, tip: TipResponse) -> tuple[ArmMotion, TipResponse]:
    still = at_rest(arm)
    assert tip.for_load is not None
    return still, tip.for_load(still)
