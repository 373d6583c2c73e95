"""Two Pandas that hold a box between them, as tests of control need them."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from holdfast import ClosedChain, Friction, Grasp, HeldObject, Pose, State, close
from holdfast.robots import panda
from holdfast.spatial import rotation

ELBOW_UP = np.array([0.0, -0.6, 0.0, -2.3, 0.0, 3.3, 1.57])
LEFT = Pose(rotation.from_quaternion(np.array([0.5, -0.5, 0.5, -0.5])), np.array([-0.15, 0.0, 0.0]))
RIGHT = Pose(rotation.from_quaternion(np.array([0.5, -0.5, -0.5, 0.5])), np.array([0.15, 0.0, 0.0]))


@functools.cache
def two_pandas(left: str = "rigid", right: str = "rigid") -> tuple[ClosedChain, State]:
    """Return the chain with the given kinds of grasps, closed and at rest."""
    facing = Pose(rotation.from_euler_zyx(np.pi, 0.0, 0.0), np.array([0.55, 0.0, 0.0]))
    chain = ClosedChain(
        {"left": panda(Pose.translation(-0.55, 0.0, 0.0)), "right": panda(facing)},
        HeldObject.box(3.0, 0.3, 0.2, 0.2),
        {"left": Grasp(left, LEFT), "right": Grasp(right, RIGHT)},
    )
    guess = State(np.tile(ELBOW_UP, 2), np.zeros(14), Pose.translation(0.0, 0.0, 0.72).wxyz_xyz)
    return chain, close(chain, guess, hold_object=True)


def rubber_pandas(mu: float) -> tuple[ClosedChain, State]:
    """Return the two with soft fingers of rubber."""
    chain, state = two_pandas("softfinger", "softfinger")
    rubber = Friction(mu, torsion_radius=0.02)
    return replace(chain, grasps={name: replace(x, contact=rubber) for name, x in chain.grasps.items()}), state


def pushes(chain: ClosedChain, state: State, wrenches: np.ndarray) -> list[float]:
    """Return the force of each grasp along its contact's normal [N]."""
    normals = [state.object_frame.R @ grasp.frame.R[:, 2] for grasp in chain.grasps.values()]
    return [f @ n for f, n in zip(wrenches[:, 3:], normals, strict=True)]
