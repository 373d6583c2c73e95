"""Machine code of gaps, margins and wrists, and of their derivatives: every kind of grasp, every angle, anchors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.spatial import rotation
from tests.derivatives.functions import FunctionCase, function_at, open_grasp
from tests.derivatives.test_compiled_functions import alone, called, fast_of, require_matrix, require_reference
from tests.derivatives.test_functions import GRASPS
from tests.systems.anchored import pinned
from tests.systems.problems import random_problem, relative_gap


@pytest.mark.slow
@pytest.mark.parametrize("kind", GRASPS)
def test_open_grasps_of_every_kind(kind):
    """Residuals and their derivatives far from closed, against the reference and five-point differences."""
    of = open_grasp(kind)
    require_reference(of)
    require_matrix(of, of.by)
    fast, random = fast_of(of), np.random.default_rng(9)
    for by in ("q", "object_pose"):
        along = {by: random.normal(size=of.directions(random)[by].shape)}
        expected, got = of.differences(along), called(of, fast, "jvp", along=along)
        for result in of.results:
            assert relative_gap(got[result], expected[result], floor=1e-2) < 1e-8, (by, result)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.0, 1e-12, 0.9e-9, 1.1e-9, 1e-6, 1e-3, np.pi - 1e-3, np.pi - 1e-6])
def test_turned_tips(angle):
    """A rigid tip turned by any angle: the rotation vector is smooth at 0, and has large slopes near half a turn.

    At d from half a turn the axis is known to 1e-16 / d, and to turn it by d takes an angle of pi.
    """
    p = random_problem(4, joints=(6, 5), grasps=("rigid", "hinge"))
    axis = {"rigid": np.array([0.6, 0.0, 0.8]), "hinge": np.array([0.0, 0.0, 1.0])}
    arms = {
        name: arm.with_tip(hf.Pose(arm.tip.R @ rotation.exp(angle * axis[p.chain.grasps[name].kind]), arm.tip.p))
        for name, arm in p.chain.arms.items()
    }
    of = FunctionCase("closure", replace(p, chain=replace(p.chain, arms=arms)), {})
    fast, by = fast_of(of), ("q", "object_pose")
    found, expected = called(of, fast, "jacobian", by=by), of.called("jacobian", by=by)
    near = max(1.0, 1.0 / (np.pi - angle))
    for name in by:
        assert np.abs(found["position", name] - expected["position", name]).max() < 1e-12 * near**2, name
    along = {"q": np.random.default_rng(1).normal(size=p.chain.joint_count)}
    if angle < 3.0:
        ahead, differences = called(of, fast, "jvp", along=along), of.differences(along)
        assert np.abs(ahead.position - differences["position"]).max() < 1e-8


def test_half_a_turn():
    """There the rotation vector has no derivative; that for the chosen axis is finite, and the gap is half a turn."""
    p = random_problem(4, joints=(6,), grasps=("rigid",))
    ((name, arm),) = p.chain.arms.items()
    turned = arm.with_tip(hf.Pose(arm.tip.R @ np.diag([1.0, -1.0, -1.0]), arm.tip.p))
    fast, s = alone(replace(p.chain, arms={name: turned})), p.state
    found = fast.closure.vjp(s.q, s.qd, s.object_pose, s.object_twist, by=["q"], position=np.ones(6))
    assert np.isfinite(found.q).all()
    assert np.linalg.norm(found.result[name].position[:3]) == pytest.approx(np.pi, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["closure", "joint_margins", "wrist_wrenches"])
@pytest.mark.parametrize("first", [False, True])
def test_anchors(name, first):
    """An anchor after the arms or before them, and an arm that holds nothing, on bases that move."""
    p = pinned(random_problem(2, joints=(5, 6, 3), grasps=("hinge", "rigid", None), moving_base=True), ("ball",), 2)
    if first:
        anchor, arms = list(p.chain.arms)[-1], dict(p.chain.arms)
        order = [len(arms) - 1, *range(len(arms) - 1)]
        chain = replace(p.chain, arms={anchor: arms.pop(anchor), **arms})
        twists = p.inputs.shaped(p.chain).base_twists[order]
        p = replace(p, chain=chain, inputs=hf.Inputs(base_twists=twists))
        assert not next(iter(chain.arms.values())).joints
    of = function_at(name, p, np.random.default_rng(0))
    require_reference(of)
    require_matrix(of, of.by)


@pytest.mark.parametrize("force", [0.0, 5.0])
def test_margins_where_two_conditions_are_equal(force):
    """The derivative is that of the condition that the reference takes, and of a norm at 0 it is 0."""
    p = random_problem(4, joints=(6,), grasps=("ball",))
    ((name, grasp),) = p.chain.grasps.items()
    grasp = replace(grasp, frame=hf.Pose.identity(), contact=hf.Friction(1.0))
    chain, f = replace(p.chain, grasps={name: grasp}), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, force]])
    state = hf.State(p.state.q, p.state.qd, hf.Pose.identity(), np.zeros(6))
    expected = hf.forces.grasp_margins.vjp(chain, state, f, grasp_margins=[1.0])
    found = alone(chain).grasp_margins.vjp(state.object_pose, f, grasp_margins=[1.0])
    assert found.result == expected.result == [force]
    for by in ("object_pose", "grasp_wrench"):
        assert np.array_equal(found[by], expected[by])
    assert np.array_equal(found.grasp_wrench[0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
