"""Forward and inverse dynamics: stored answers, what is refused and checked, and how the result is laid out."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, Grasp, Inputs, Joint, Link, State, forward_dynamics, inverse_dynamics
from holdfast.dynamics import Status, state_from_joints
from holdfast.errors import ModelError, SingularChainError, StateError
from tests.model.parts import BOX, arm
from tests.systems import planar_parallelogram
from tests.systems.as_chain import as_chain
from tests.systems.problems import CASES, random_problem, relative_gap, stored


@pytest.mark.parametrize("route", ["recursive", "mass_matrix"])
@pytest.mark.parametrize("name", CASES)
def test_stored_answers(name, route):
    """All 42 stored answers by either route: accelerations, forces, contact rates, status."""
    p, expected, tags = stored(name), CASES[name]["expected"], CASES[name]["tags"]
    result = p.solved(route=route)
    assert relative_gap(result.qdd, np.concatenate(expected["qdd"])) < 1e-11
    assert relative_gap(result.object_acceleration, np.array(expected["alpha_C"])) < 1e-11
    assert relative_gap(result.contact_acceleration, np.concatenate(expected["W_dot"])) < 1e-11
    if tags["f_unique"]:
        assert relative_gap(result.grasp_wrench, np.array(expected["f"])) < 1e-11
    assert result.status is (Status.OK if tags["f_unique"] else Status.INDETERMINATE_FORCES)
    assert (result.rank, result.mobility) == (tags["constraint_rank"], tags["mobility"])
    assert 1 <= result.condition < 1e6


def test_one_arms_part():
    """result['arm'] gives that arm's slices; an unknown name is answered with a suggestion."""
    p = stored("mixed_4arm_all_types")
    result = p.solved()
    part = result["arm4"]
    np.testing.assert_array_equal(part.qdd, result.qdd[-8:])
    np.testing.assert_array_equal(part.grasp_wrench, result.grasp_wrench[3])
    np.testing.assert_array_equal(part.base_wrench, result.base_wrench[3])
    np.testing.assert_array_equal(part.contact_acceleration, result.contact_acceleration[-2:])
    assert result["arm1"].contact_acceleration.shape == (0,)
    with pytest.raises(KeyError, match=r"no arm 'amr1'\. Did you mean 'arm1'\?"):
        result["amr1"]


@pytest.mark.parametrize(
    ("tau", "message"),
    [
        (np.zeros(13), r"tau: expected shape \(14,\), got shape \(13,\)"),
        (np.zeros((1, 14)), r"tau: expected shape \(14,\), got shape \(1, 14\)"),
        (np.full(14, np.nan), r"tau: expected finite numbers"),
        ("abc", r"tau: expected numbers of shape \(14,\), got 'abc'"),
    ],
)
def test_torques(tau, message):
    """Torques of the wrong shape or not finite are refused."""
    p = stored("rigid_2arm_7R_gravity")
    with pytest.raises(StateError, match=message):
        forward_dynamics(p.chain, p.state, tau)


def test_state_of_another_chain():
    """A state of the wrong length is refused with both lengths."""
    p, other = stored("rigid_2arm_7R_gravity"), stored("rigid_2arm_mixed_67")
    with pytest.raises(StateError, match=r"expected 14 joint positions \(arm1: 7, arm2: 7\), got 13"):
        forward_dynamics(p.chain, other.state, p.tau)
    with pytest.raises(StateError, match=r"inputs: base_twists: expected shape \(2, 6\)"):
        replace(p, inputs=Inputs(base_twists=np.zeros(6))).solved()


def test_overflow():
    """Numbers that overflow are refused; no NaN comes out."""
    p = stored("rigid_2arm_7R_gravity")
    with pytest.raises(StateError, match="overflow float64"):
        forward_dynamics(p.chain, State(p.state.q, 1e200 * p.state.qd, p.state.object_pose), p.tau, check=False)


@pytest.mark.parametrize("held", [True, False])
def test_no_inertia(held):
    """A joint that moves nothing but massless links is named, whether its arm holds or not."""
    last = Link(0.0)
    lame = Arm([*arm(2).joints, Joint(axis=[0, 1, 0])], [*arm(2).links, last])
    grasps = {"lame": Grasp("rigid")} if held else {"good": Grasp("rigid")}
    chain = ClosedChain({"good": arm(3), "lame": lame}, BOX, grasps)
    state = state_from_joints(chain, np.zeros(6), np.zeros(6), check=False)
    with pytest.raises(ModelError, match=r"arm 'lame', joint 3: the inertia about its axis is .*, expected > 0; give"):
        forward_dynamics(chain, state, np.zeros(6))
    joints = [*lame.joints[:2], replace(lame.joints[2], armature=0.01)]
    mended = replace(chain, arms={"good": chain.arms["good"], "lame": replace(lame, joints=joints)})
    assert np.isfinite(forward_dynamics(mended, state, np.zeros(6)).qdd).all()


def test_singular_configurations():
    """They are refused (`tests/acceptance/test_precision.py`); a given generic rank is trusted."""
    p = as_chain(planar_parallelogram(0.3))
    assert p.solved(generic_rank=9).status is Status.INDETERMINATE_FORCES
    with pytest.raises(SingularChainError, match="rank 9 of 12 here, but 10 in general"):
        p.solved(generic_rank=10)


def test_inputs_by_default():
    """No inputs mean zero inputs."""
    p = stored("rigid_2arm_7R_gravity")
    given = Inputs(np.zeros(6), np.zeros((14, 6)), np.zeros((2, 6)), np.zeros((2, 6)))
    explicit, default = replace(p, inputs=given).solved(), forward_dynamics(p.chain, p.state, p.tau)
    np.testing.assert_allclose(explicit.qdd, default.qdd, rtol=1e-13)
    np.testing.assert_allclose(explicit.base_wrench, default.base_wrench, rtol=1e-13, atol=1e-13)


MIXED = {"grasps": ("rigid", None, "softfinger", "ball"), "joints": (6, 5, 7, 8), "moving_base": True}


@pytest.mark.parametrize("seed", range(5))
def test_torques_come_back(seed):
    """inverse(forward(tau)) = tau, damping, armature, wrenches, moving bases and free arms in."""
    p = random_problem(seed, **MIXED)
    result = p.solved()
    tau = inverse_dynamics(p.chain, p.state, result.qdd, result.grasp_wrench, p.inputs)
    assert relative_gap(tau, p.tau) < 1e-11


@pytest.mark.parametrize("name", CASES)
def test_stored_torques(name):
    """The stored accelerations and forces ask for the stored torques."""
    p, expected = stored(name), CASES[name]["expected"]
    tau = inverse_dynamics(p.chain, p.state, np.concatenate(expected["qdd"]), expected["f"], p.inputs)
    size = np.abs(np.concatenate(expected["f"])).max()
    assert np.abs(tau - p.tau).max() < 1e-10 * max(1.0, size)


def test_inverse_refuses():
    """Wrong shapes, and a wrench on an arm that holds nothing, are refused by name."""
    p = random_problem(0, **MIXED)
    n, none = p.chain.joint_count, np.zeros((4, 6))
    with pytest.raises(StateError, match=r"qdd: expected shape \(26,\), got shape \(25,\)"):
        inverse_dynamics(p.chain, p.state, np.zeros(n - 1), none)
    with pytest.raises(StateError, match=r"grasp_wrench: expected shape \(4, 6\)"):
        inverse_dynamics(p.chain, p.state, np.zeros(n), none[:3])
    loaded = none.copy()
    loaded[1, 4] = 1.0
    with pytest.raises(StateError, match=r"grasp_wrench: arm 'arm2' holds nothing, expected zeros"):
        inverse_dynamics(p.chain, p.state, np.zeros(n), loaded)
