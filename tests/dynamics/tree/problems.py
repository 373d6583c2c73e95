"""Random forests with passive joints, and small ones whose answers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import holdfast as hf
from holdfast.dynamics.tree.forest_inverse import driven
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody, JointCoupling
from tests.systems.random_forests import ForestProblem, random_forest

LINK = hf.Link(1.0, [0.3, 0.0, 0.0], np.eye(3) * 0.02)


def gap(found, wanted) -> float:
    """Return max|x - e| / max(1, max|e|)."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return float(np.abs(found - wanted).max(initial=0.0)) / max(1.0, float(np.abs(wanted).max(initial=0.0)))


def with_joints(p: ForestProblem, change) -> ForestProblem:
    """Return a problem whose joints, but for those of free bodies, are changed by a function."""
    bodies = [
        b if b.joint.of_kind.floats else replace(b, joint=replace(b.joint, **change(k)))
        for k, b in enumerate(p.forest.bodies)
    ]
    return p._replace(forest=Forest(bodies, p.forest.closures, p.forest.couplings, p.forest.gravity))


def underactuated(seed: int, share: float = 0.3) -> ForestProblem:
    """Return a random forest in which some joints have no drive, with torques at the others."""
    random = np.random.default_rng(seed)
    p = with_joints(random_forest(seed), lambda k: {"actuated": bool(random.random() > share)})
    return p._replace(tau=np.where(driven(p.forest), p.tau, 0.0))


def undamped(seed: int) -> ForestProblem:
    """Return a random forest without dampers, torques and wrenches."""
    p = with_joints(random_forest(seed), lambda k: {"damping": 0.0})
    return p._replace(tau=0.0 * p.tau, wrenches=0.0 * p.wrenches)


def with_offsets(p: ForestProblem) -> ForestProblem:
    """Return a problem whose couplings have the offsets of its posture, as far as their joints have such."""
    forest, couplings = p.forest, []
    for coupling in p.forest.couplings:
        terms = [
            (c * p.q[forest.positions[k].start + i], forest.bodies[k].joint.of_kind.pose) for k, i, c in coupling.terms
        ]
        offset = None if any(pose for _, pose in terms) else sum(x for x, _ in terms)
        couplings.append(JointCoupling(coupling.terms, offset))
    return p._replace(forest=Forest(forest.bodies, forest.closures, couplings, forest.gravity))


def slider_crank() -> Forest:
    """Return two bars of 1 m, pinned at the far end 2 m away: at q = 0 stretched, and unable to move."""
    bodies = [
        ForestBody(LINK, BodyJoint()),
        ForestBody(LINK, BodyJoint(placement=hf.Pose(np.eye(3), [1.0, 0.0, 0.0])), 0),
    ]
    pin = Closure(None, 1, hf.Grasp("ball", hf.Pose(np.eye(3), [1.0, 0.0, 0.0])), hf.Pose(np.eye(3), [2.0, 0.0, 0.0]))
    return Forest(bodies, [pin])


def parallelogram(length: float = 0.5) -> Forest:
    """Return crank, rocker and coupler in the plane of x and y, with equal cranks 1 m apart; flat at q = 0."""
    named = [hf.Link(1.0, [0.1, 0.0, 0.0], np.eye(3) * 0.02, name) for name in ("crank", "rocker", "coupler")]
    at = [hf.Pose(np.eye(3), [x, 0.0, 0.0]) for x in (0.0, 1.0, length)]
    bodies = [ForestBody(link, BodyJoint(placement=p)) for link, p in zip(named, at, strict=True)]
    bodies[2] = replace(bodies[2], parent=0)
    hinge = hf.Grasp("ball", hf.Pose(np.eye(3), [length, 0.0, 0.0]))
    return Forest(bodies, [Closure(2, 1, hinge, hf.Pose(np.eye(3), [1.0, 0.0, 0.0]))])
