"""Who does not hold moves alone: free arms, free fall."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import forward_dynamics, inverse_dynamics
from holdfast.dynamics import METHODS
from tests.laws.systems import mixed
from tests.laws.transformed import with_arms
from tests.systems.problems import random_problem, relative_gap

TOLERANCE = 1e-11
seeds = pytest.mark.parametrize("seed", range(4))


@seeds
def test_the_others_do_not_notice(seed):
    """Taking the free arm away changes nothing for the rest, beyond what BLAS rounds by where arrays lie."""
    p, result = mixed(seed)
    keep = [name for name in p.chain.names if name != "arm3"]
    rest = with_arms(p, keep).solved()
    assert relative_gap(rest.qdd, np.concatenate([result[name].qdd for name in keep])) < 1e-13
    assert relative_gap(rest.grasp_wrench, np.delete(result.grasp_wrench, 2, axis=0)) < 1e-13
    assert relative_gap(rest.object_acceleration, result.object_acceleration) < 1e-13
    assert (rest.rank, result.mobility - rest.mobility) == (result.rank, 4)
    by_itself = with_arms(p, ["arm3"]).solved()  # and it moves as if the others were not there
    for key, value in vars(by_itself["arm3"]).items():
        assert relative_gap(getattr(result["arm3"], key), value) < TOLERANCE
    np.testing.assert_array_equal(result["arm3"].grasp_wrench, np.zeros(6))


@seeds
@pytest.mark.parametrize("method", METHODS)
def test_nobody_holds(seed, method):
    """Zero grasps: every arm by itself, the object in free fall under its load, by every method."""
    p = mixed(seed)[0]
    p = replace(p, chain=replace(p.chain, grasps={}))
    result = p.solved(method=method)
    for name in p.chain.names:
        by_itself = with_arms(p, [name]).solved()
        assert relative_gap(result[name].qdd, by_itself.qdd) < TOLERANCE
        assert relative_gap(result[name].base_wrench, by_itself.base_wrench[0]) < TOLERANCE
    body, R, w = p.chain.held_object, p.state.object_frame.R, p.state.object_twist[:3]
    lever, I, load = R @ body.com, R @ body.inertia @ R.T, p.inputs.object_wrench
    alpha = result.object_acceleration
    centre = alpha[3:] + np.cross(alpha[:3], lever) + np.cross(w, np.cross(w, lever))
    np.testing.assert_allclose(body.mass * (centre - p.chain.gravity), load[3:], atol=1e-11)
    spin = I @ alpha[:3] + np.cross(w, I @ w)
    np.testing.assert_allclose(spin, load[:3] - np.cross(lever, load[3:]), atol=1e-11)
    assert (result.rank, result.mobility) == (0, p.chain.joint_count + 6)
    assert result.contact_acceleration.shape == (0,)


def test_plain_free_fall():
    """Unloaded and at rest in rotation, an object nobody holds falls with g, C and all."""
    p = random_problem(0, grasps=(None,), joints=(6,), extras=False, moving_base=False, gravity=(0.0, 0.0, -9.81))
    still = type(p.state)(p.state.q, 0 * p.state.qd, p.state.object_pose)
    tau = inverse_dynamics(p.chain, still, np.zeros(6), np.zeros((1, 6)))
    result = forward_dynamics(p.chain, still, tau)
    np.testing.assert_allclose(result.object_acceleration, [0, 0, 0, 0, 0, -9.81], atol=1e-14)
    np.testing.assert_allclose(result.qdd, 0, atol=1e-11)
    weight = 9.81 * sum(link.mass for link in p.chain.arms["arm1"].links)
    np.testing.assert_allclose(result.base_wrench[0, 3:], [0, 0, weight], atol=1e-10)
