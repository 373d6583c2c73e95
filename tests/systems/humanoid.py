"""A humanoid of 29 joints as a forest: feet on the ground and a box in its hands, or further legs and arms."""

from __future__ import annotations

import numpy as np

import holdfast as hf
from holdfast.dynamics.tree.forest_motion import forest_motion
from holdfast.dynamics.tree.forest_rows import forest_rows
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody
from tests.systems.random_forests import ForestProblem

X, Y, Z = np.eye(3)
LEG = ((Z, (0.0, 0.0, -0.1)), (X, (0, 0, 0)), (Y, (0, 0, 0)), (Y, (0, 0, -0.4)), (Y, (0, 0, -0.4)), (X, (0, 0, 0)))
SOLE = hf.Pose.translation(0, 0, -0.1)


def humanoid(legs: int = 2, arms: int = 2, seed: int = 0) -> ForestProblem:
    """Return a floating pelvis with legs of 6 joints, a torso of 3 and Pandas on it; all closures are rigid.

    Args:
        legs: number of legs, whose soles are fixed to the ground.
        arms: number of arms, which hold one box.
        seed: of masses, posture, rates and torques.
    """
    random, bodies = np.random.default_rng(seed), []

    def add(parent: int | None, joint: BodyJoint, link: hf.Link) -> int:
        bodies.append(ForestBody(link, joint, parent))
        return len(bodies) - 1

    def link(mass: float) -> hf.Link:
        return hf.Link(mass, random.uniform(-0.1, 0.1, 3), mass * 0.02 * np.diag([1.0, 1.2, 0.8]))

    def turning(axis: np.ndarray, place: hf.Pose) -> BodyJoint:
        return BodyJoint("revolute", place, axis, armature=0.01)

    pelvis, box = add(None, BodyJoint("free"), link(10.0)), add(None, BodyJoint("free"), link(3.0))
    feet, hands, panda = [], [], hf.robots.panda()
    of_leg = [link(2.0) for _ in LEG]
    for i in range(legs):
        k = pelvis
        for j, (axis, p) in enumerate(LEG):
            beside = (0.0, 0.2 * i - 0.1, 0.0) if j == 0 else (0.0, 0.0, 0.0)
            k = add(k, turning(axis, hf.Pose.translation(*np.add(p, beside))), of_leg[j])
        feet.append(k)
    torso = pelvis
    for axis in (Z, Y, X):
        torso = add(torso, turning(axis, hf.Pose.translation(0, 0, 0.1)), link(5.0))
    for i in range(arms):
        k, side = torso, 1 - 2 * (i % 2)
        turned = (-1.2 * side + 0.03 * i, 0.1 + 0.02 * i, 0.3 * (i // 2) + 0.05 * i + 0.1)  # no numbers in common
        shoulder = hf.Pose.from_rpy(*turned, xyz=(0.01 + 0.02 * i, 0.2 * side + 0.01 * i, 0.3 + 0.015 * i))
        for j, (joint, of_panda) in enumerate(zip(panda.joints, panda.links, strict=True)):
            place = shoulder @ joint.placement if j == 0 else joint.placement
            k = add(k, turning(joint.axis, place), of_panda)
        hands.append(k)
    free = [k for k, body in enumerate(bodies) if body.parent is None]
    q = [
        np.array([1.0, 0, 0, 0, *random.uniform(-1.0, 1.0, 3)]) if k in free else random.uniform(-0.6, 0.6, 1)
        for k in range(len(bodies))
    ]
    poses = Forest(bodies).poses(np.concatenate(q))
    closures = [Closure(None, k, hf.Grasp("rigid", SOLE), poses[k] @ SOLE) for k in feet]
    grasps = [hf.Grasp("rigid", poses[box].inverse() @ poses[k] @ panda.tip) for k in hands]
    closures += [Closure(k, box, grasp, panda.tip) for k, grasp in zip(hands, grasps, strict=True)]
    forest, at = Forest(bodies, closures), np.concatenate(q)
    rates, tau = random.normal(size=(2, forest.velocity_count))
    motion = forest_motion(forest, at, 0.0 * rates, 0.0 * tau, np.zeros((len(bodies), 6)))
    G = forest_rows(motion).G
    rates -= np.linalg.pinv(G) @ (G @ rates)
    pairs = zip(motion.bodies, forest.velocities, strict=True)
    qd = np.concatenate([body.of_frame(rates[part]) for body, part in pairs])
    return ForestProblem("humanoid", forest, at, qd, tau, np.zeros((len(bodies), 6)))
