"""Random chains some of whose grasps are bushings, stretched in every direction and coupled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast import Grasp, Inputs, Pose
from holdfast.dynamics import project_velocity
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem


def random_bushing(frame: Pose, random, *, damped: bool = True, turned: float = 0.3) -> Grasp:
    """Return a bushing of full matrices, its contact frame some tenths of a radian and centimetres off a frame."""
    A, B = random.normal(size=(2, 6, 6))
    stiffness = 40 * A @ A.T + np.diag([5.0, 5.0, 5.0, 100.0, 100.0, 100.0])
    off = Pose(rotation.exp(turned * random.normal(size=3)), 0.05 * random.normal(size=3))
    return Grasp("bushing", frame @ off, stiffness=stiffness, damping=0.5 * B @ B.T if damped else None)


def bushed(p: Problem, names: tuple[str, ...], seed: int = 0, **options) -> Problem:
    """Return a problem with random bushings in the place of some grasps, which their arms move against; velocities fit.

    Args:
        p: the problem.
        names: of the arms that get them.
        seed: of the bushings.
        **options: of `random_bushing`.
    """
    random = np.random.default_rng(seed)
    made = {name: random_bushing(p.chain.grasps[name].frame, random, **options) for name in names}
    chain, qd = replace(p.chain, grasps={**p.chain.grasps, **made}), np.array(p.state.qd)
    for name in names:
        qd[chain.joints[name]] += 0.5 * random.normal(size=chain.arms[name].joint_count)
    state = replace(p.state, qd=qd)
    return Problem(chain, project_velocity(chain, state, inputs=p.inputs), p.tau, p.inputs)


def random_bushed(seed: int, *, moving_base: bool = True) -> Problem:
    """Return three arms, one of which holds rigidly, one by a bushing, one by a ball, everything on."""
    p = random_problem(seed, joints=(7, 6, 8), grasps=("rigid", "rigid", "ball"), moving_base=moving_base)
    return bushed(p, ("arm2",), seed)


def still_bushed(seed: int, *, damped: bool) -> Problem:
    """Return two arms on bases at rest, one of which holds by a bushing, without loads; joints without damping."""
    options = {"moving_base": False, "extras": False, "gravity": (0, 0, -9.81), "joint_speed": 0.7}
    p = random_problem(seed, joints=(6, 7), grasps=("rigid", "rigid"), **options)
    return replace(bushed(p, ("arm2",), seed, damped=damped), inputs=Inputs())
