"""Derivatives of margins and wrist wrenches: behind forward dynamics, at kinks, and what is refused.

Differences and duality are with those of all functions (`tests/derivatives/test_functions.py`).
"""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from tests.derivatives.blocks import flat_direction, random_directions
from tests.derivatives.functions import FIVE_POINTS, STEP, displaced, function_case
from tests.systems.as_chain import Problem

NAMES = ("grasp_margins", "wrist_wrenches")


@pytest.mark.parametrize("name", NAMES)
def test_behind_forward_dynamics_gradients_are_those_of_torques_and_payload(name):
    """Gradients by the grasp wrenches are forward dynamics' cotangents: the whole against differences of the whole."""
    of, random = function_case(name, "limits"), np.random.default_rng(10)
    p, bar = of.p, random.normal(size=of.called().shape)
    by_wrench = of.called("vjp", by=["grasp_wrench"], **{name: bar}).grasp_wrench
    by = ("tau", "object_mass")
    got = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, inputs=p.inputs, by=by, grasp_wrench=by_wrench)

    def far(moved: Problem) -> float:
        result = hf.forward_dynamics(moved.chain, moved.state, moved.tau, inputs=moved.inputs)
        value = of._replace(p=moved, own={"grasp_wrench": result.grasp_wrench}, result=result).called()
        return float(np.sum(bar * np.where(np.isinf(value), 0.0, value)))

    for argument, along in random_directions(p, random, by).items():
        flat = flat_direction(p, argument, along)
        expected = sum(w * far(displaced(p, {argument: k * STEP * flat})) for k, w in FIVE_POINTS.items()) / STEP
        assert float(np.sum(got[argument] * along)) == pytest.approx(float(expected), rel=1e-7)


def test_a_margin_that_nothing_limits_does_not_change():
    of = function_case("grasp_margins", "limits")
    found = of.called("jacobian", by=of.by)
    assert list(np.isinf(found.result)) == [False, False, True]
    assert not any(found["grasp_margins", by][2].any() for by in of.by)


def test_without_a_load_a_cone_opens_along_its_normal():
    """At f = 0 the length |B f| has the derivative 0, so what is left is what presses: 0 <= mu <= 1 normals."""
    of = function_case("grasp_margins", "limits")
    still = of._replace(own={"grasp_wrench": np.zeros_like(of.own["grasp_wrench"])})
    chain, (name, grasp) = of.p.chain, next(iter(of.p.chain.grasps.items()))
    found = still.called("vjp", by=["grasp_wrench"], grasp_margins=[1.0, 0.0, 0.0]).grasp_wrench
    normal = (of.p.state.object_frame.R @ grasp.frame.R)[:, 2]
    row = found[chain.names.index(name), 3:]
    assert row @ normal in (pytest.approx(0.6), pytest.approx(1.0))
    assert np.allclose(row, (row @ normal) * normal, atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_what_does_not_fit_is_refused_in_words(name):
    of = function_case(name, "limits")
    with pytest.raises(hf.errors.StateError, match=rf"{name}\.vjp: no 'tau'"):
        of.called("vjp", by=["tau"], **{name: np.zeros(of.called().shape)})
    with pytest.raises(hf.errors.StateError, match=f"{name}: .*shape"):
        of.called("vjp", **{name: np.zeros(17)})
    with pytest.raises(hf.errors.StateError, match="expected shape"):
        of.called("jvp", along={"grasp_wrench": np.zeros(5)})
    with pytest.raises(hf.errors.StateError, match="overflow"):
        of.called("jvp", along={"grasp_wrench": np.full((4, 6), 1.7e308)})
    with pytest.raises(hf.errors.StateError, match=rf"{name}\.jacobian: no 'qdd'"):
        of.called("jacobian", of=["qdd"])


def test_joints_without_limits_and_beside_the_nearer_one():
    of = function_case("joint_margins", "limits")
    chain, q = of.p.chain, of.p.state.q
    found = of.called("jacobian")
    ends = np.array([joint.position_limits for joint in chain.all_joints])
    unlimited = np.isinf(ends).all(axis=1)
    nearer = np.where(q - ends[:, 0] < ends[:, 1] - q, 1.0, -1.0)
    assert 0 < unlimited.sum() < len(q)
    assert np.array_equal(found["position", "q"], np.diag(np.where(unlimited, 0.0, nearer)))
    assert np.array_equal(np.isinf(found.result.position), unlimited)
    rated = np.isfinite([joint.rate_limit for joint in chain.all_joints])
    assert np.array_equal(found["rate", "qd"], -np.diag(rated * np.sign(of.p.state.qd)))
    assert np.array_equal(found["effort", "tau"], -np.diag(np.sign(of.p.tau)))
    with pytest.raises(hf.errors.StateError, match=r"joint_margins\.vjp: expected some of position, rate, effort"):
        of.called("vjp")
