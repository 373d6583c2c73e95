"""Hybrid position / force control: an object held by two arms presses on a wall with the force that was asked."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, RestToRest, cooperative_law
from holdfast.errors import ModelError
from holdfast.world import HalfSpace, Touching, corners
from tests.control.two_pandas import two_pandas

PRESS = 20.0  # N
STIFFNESS, DAMPING = np.array([20.0, 20, 20, 400, 0, 400]), np.array([8.0, 8, 8, 100, 400, 100])  # free along y
PUSH = np.array([0.0, 0, 0, 0, PRESS, 0])


def beside_a_wall(gap: float, friction: float = 0.3) -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms whose box is at a distance from a wall, seen along y."""
    chain, state = two_pandas()
    wall = HalfSpace(normal=[0, -1, 0], offset=-(state.object_pose[5] + 0.1 + gap), friction=friction)
    return replace(chain, touching=Touching(corners(0.3, 0.2, 0.2), {"wall": wall})), state


def pressing(chain, state, push=PUSH, **path):
    """Return the law."""
    path = RestToRest(state.object_frame, **path)
    return cooperative_law(chain, ObjectImpedance(path, STIFFNESS, DAMPING, push=push), InternalForce(20.0))


def test_at_rest():
    """The wall bears 20 N to 1e-9, and nothing moves; a moment of the push reaches it, too."""
    chain, state = beside_a_wall(0.0)
    tau, _ = pressing(chain, state)(0.0, state, None)
    found = hf.forward_dynamics(chain, state, tau)
    np.testing.assert_allclose(found.touch_force.sum(axis=0), [0, -PRESS, 0], atol=1e-9)
    np.testing.assert_allclose(found.object_acceleration, 0.0, atol=1e-10)
    tilting = np.array([0.3, 0, 0.5, 0, PRESS, 0])
    found = hf.forward_dynamics(chain, state, pressing(chain, state, tilting)(0.0, state, None)[0])
    arms = np.array(list(corners(0.3, 0.2, 0.2).values()))
    moment = np.cross(arms, found.touch_force).sum(axis=0)
    np.testing.assert_allclose(moment, -tilting[:3], atol=1e-9)


def test_pushes_have_six_numbers():
    """Others are refused by name."""
    with pytest.raises(ModelError, match="push"):
        ObjectImpedance(RestToRest(hf.Pose.identity()), 1.0, 1.0, push=[1.0, 2.0])
