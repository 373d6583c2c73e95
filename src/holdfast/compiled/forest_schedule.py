"""Forward dynamics of a forest and its derivatives on traced arrays, by running the reference's functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.recorded_loops import recorded_loops
from holdfast.compiled.result import INDETERMINATE, OK, SINGULAR
from holdfast.compiled.traced_chain import Given, constant_arm, constant_link, constant_pose, quaternion_length
from holdfast.compiler.constant import Constant, constants
from holdfast.dynamics.closed.tip_response import if_regular
from holdfast.dynamics.tree.forest_derivatives import ForestPoint, backward, forward
from holdfast.dynamics.tree.forest_dynamics import CONTRADICTION
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.limbed_solution import (
    LimbedAccelerations,
    LimbedSolution,
    solved_again,
    solved_with_limbs,
)
from holdfast.dynamics.tree.limbs import LimbArm, LimbedMotion, limb_arms, limbed_motion
from holdfast.dynamics.tree.outward import ForestFactors
from holdfast.dynamics.tree.plan import plan_of
from holdfast.dynamics.tree.varied_forest import ForestArguments, damping_torques, spring_torques
from holdfast.dynamics.tree.virtual_power import ForestUnknowns, unknowns_of
from holdfast.model.forest import Forest, ForestBody
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array, array, concatenate, maximum, where


class LimbedEquations(NamedTuple):
    """The equations of a forest with limbs, for other right-hand sides.

    Attributes:
        limbed: its motion.
        factors: its factors.
    """

    limbed: LimbedMotion
    factors: ForestFactors

    def unknowns(self, x: LimbedAccelerations) -> ForestUnknowns:
        """Return accelerations and forces in the layout of the equations."""
        motion = self.limbed.motion
        rates = [x.qdd[k] if b is None or not b.floats else x.beta[k] for k, b in enumerate(motion.bodies)]
        forces = [x.wrenches[i] for i in range(len(motion.closures))]
        return unknowns_of(motion, rates, forces, [x.multipliers[i] for i in range(len(motion.couplings))])

    def at_rest(self, _: ForestMotion, r: ForestUnknowns) -> ForestUnknowns:
        """Return the solution of K z = r by the factors at hand; see `solved_at_rest`."""
        sides = [-x for x in r.closures], [-x for x in r.couplings], r.rates
        return self.unknowns(solved_again(self.limbed, self.factors, *sides))


class TracedSolution(NamedTuple):
    """Forward dynamics of a forest on traced arrays.

    Attributes:
        given: its arguments, whose numbers are constants but for the traced arrays.
        limbed: its motion.
        found: the solution.
    """

    given: ForestArguments
    limbed: LimbedMotion
    found: LimbedSolution

    @property
    def point(self) -> ForestPoint:
        """The same for derivatives."""
        equations = LimbedEquations(self.limbed, self.found.factors)
        z = equations.unknowns(self.found.accelerations)
        return ForestPoint(self.given, self.limbed.motion, z, None, equations.at_rest)


def traced_solution(forest: Forest, given: Given, made: Forest | None = None) -> TracedSolution:
    """Return forward dynamics by running the reference's functions on traced arrays.

    Args:
        forest: the forest.
        given: traced arrays of its state, torques and wrenches.
        made: the forest with constants and traced numbers in place of its own; by default all are constants.
    """
    made, qd, tau = with_constants(forest) if made is None else made, given["qd"], given["tau"]
    wrenches = given.get("link_wrench")
    arms, q = with_constant_arms(forest), unit_positions(forest, given["q"])
    torque = tau - damping_torques(made, qd) - spring_torques(made, given["q"])
    limbed = limbed_motion(made, arms, q, qd, torque, wrenches)
    found = solved_with_limbs(limbed, plan_of(forest.topology))
    pushed = np.zeros((len(forest.bodies), 6)) if wrenches is None else wrenches
    return TracedSolution(ForestArguments(made, q, qd, tau, pushed, limbs=arms), limbed, found)


def forward_outputs(solved: TracedSolution) -> dict[str, Any]:
    """Return the outputs of forward dynamics."""
    forest, found = solved.given.forest, solved.found
    low = where(reduce(maximum, found.left, 0.0) > CONTRADICTION, float(SINGULAR), float(INDETERMINATE))
    qdd = concatenate(found.qdd)
    return {
        "qdd": if_regular(qdd, found.pivots) if len(found.pivots) else qdd,
        "closure_wrench": array(found.wrenches),
        "coupling_force": array(found.multipliers),
        "rank": found.rank,
        "status": where(found.rank < forest.constraint_row_count, low, float(OK)),
        "condition": 1.0 / found.weakest,
    }


def gradients(solved: TracedSolution, cotangents: Mapping[str, Array], by: Sequence[str]) -> dict[str, Array]:
    """Return the gradients of sum(cotangent . result) by arguments of the forest; see `backward`."""
    with recorded_loops():
        return backward(solved.point, cotangents, by)


def rates(solved: TracedSolution, along: Mapping[str, Array]) -> dict[str, Array]:
    """Return the rates of the forest's results along tangents of its arguments, (*shape, 1) each; see `forward`."""
    whole = solved.given._replace(limbs=())  # derivatives of derivatives of loops are no loops
    return forward(solved.point._replace(given=whole), along)


def with_constant_arms(forest: Forest) -> list[LimbArm]:
    """Return the limbs of a forest with their fixed numbers as `Constant`."""
    return [one._replace(arm=constant_arm(one.arm), base=constant_pose(one.base)) for one in limb_arms(forest)]


def with_constants(forest: Forest) -> Forest:
    """Return the forest with its fixed numbers as `Constant`, so that no BLAS computes their products."""
    closures = [
        changed(c, tip=constant_pose(c.tip), grasp=c.grasp.standing_at(constant_pose(c.grasp.frame)))
        for c in forest.closures
    ]
    bodies = tuple(map(_constant_body, forest.bodies))
    return changed(forest, bodies=bodies, closures=tuple(closures), gravity=constants(forest.gravity))


def _constant_body(body: ForestBody) -> ForestBody:
    joint = body.joint
    across = None if joint.across is None else constants(joint.across)
    numbers: dict[str, Any] = {
        name: Constant(getattr(joint, name)) for name in ("armature", "damping", "stiffness", "rest")
    }
    numbers |= {"axis": constants(joint.axis), "across": across, "rate_map": constants(joint.rate_map)}
    own = changed(joint, placement=constant_pose(joint.placement), **numbers)
    return changed(body, link=constant_link(body.link), joint=own)


def unit_positions(forest: Forest, q: Array) -> Array:
    """Return positions with unit quaternions, NaN where one is not of unit length within 1e-6."""
    parts = []
    for body, at in zip(forest.bodies, forest.positions, strict=True):
        own = q[at]
        if body.joint.of_kind.pose:
            own = concatenate([own[:4] / quaternion_length(own[:4]), own[4:]])
        parts.append(own)
    return concatenate(parts)
