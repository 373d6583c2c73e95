"""The front door: what it refuses, what it checks, and how its result is laid out."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import (
    Arm,
    ClosedChain,
    Grasp,
    Inputs,
    Joint,
    Link,
    ModelError,
    SingularChainError,
    State,
    StateError,
    Status,
    forward_dynamics,
    state_from_joints,
)
from tests.dynamics.problems import CASES, relative_gap, stored
from tests.model.parts import BOX, arm
from tests.systems import planar_parallelogram, two_collinear_stretched_6r
from tests.systems.as_chain import Problem, as_chain


def answer(p: Problem, **options):
    """Return forward dynamics of a problem."""
    return forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs, **options)


@pytest.mark.parametrize("route", ["recursive", "mass_matrix"])
@pytest.mark.parametrize("name", CASES)
def test_stored_answers(name, route):
    """All 42 stored answers by either route: accelerations, forces, contact rates, status."""
    p, expected, tags = stored(name), CASES[name]["expected"], CASES[name]["tags"]
    result = answer(p, route=route)
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
    result = answer(p)
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
        answer(replace(p, inputs=Inputs(base_twists=np.zeros(6))))


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
    """Flat parallelogram and arms stretched along one line are refused; a given generic rank is trusted."""
    stretched = [two_collinear_stretched_6r(1, opposed=opposed) for opposed in (True, False)]
    for case in (planar_parallelogram(0.0), *stretched):
        p = as_chain(case)
        with pytest.raises(SingularChainError, match="a singular configuration"):
            answer(p)
    p = as_chain(planar_parallelogram(0.3))
    assert answer(p, generic_rank=9).status is Status.INDETERMINATE_FORCES
    with pytest.raises(SingularChainError, match="rank 9 of 12 here, but 10 in general"):
        answer(p, generic_rank=10)


def test_towards_the_singularity():
    """The parallelogram's accelerations do not depend on the crank's angle, down to 1e-4 rad from flat."""
    steady = answer(as_chain(planar_parallelogram(0.5))).qdd
    for angle, tolerance in ((1e-2, 1e-10), (1e-3, 1e-8), (1e-4, 1e-5)):
        p = as_chain(planar_parallelogram(angle))
        assert relative_gap(answer(p, generic_rank=9).qdd, steady) < tolerance


def test_inputs_by_default():
    """No inputs mean zero inputs."""
    p = stored("rigid_2arm_7R_gravity")
    given = Inputs(np.zeros(6), np.zeros((14, 6)), np.zeros((2, 6)), np.zeros((2, 6)))
    explicit, default = answer(replace(p, inputs=given)), forward_dynamics(p.chain, p.state, p.tau)
    np.testing.assert_allclose(explicit.qdd, default.qdd, rtol=1e-13)
    np.testing.assert_allclose(explicit.base_wrench, default.base_wrench, rtol=1e-13, atol=1e-13)
