"""Derivatives of grasp margins and wrist wrenches: differences, laws, kinks, and what is refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import holdfast as hf
from holdfast import forces
from holdfast.model.grasp import WrenchLimits
from tests.derivatives.asked import NAMES, size_of
from tests.derivatives.moved import moved_problem
from tests.derivatives.products import random_directions
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem, relative_gap
from tests.systems.trunk_problems import random_on_trunk

FIVE_POINTS = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
STEP, TRUNCATED, EXACT = 1e-3, 1e-8, 1e-12
BY = {
    "grasp_margins": ("object_pose", "grasp_pose", "grasp_wrench"),
    "wrist_wrenches": ("q", "base_pose", "grasp_wrench"),
}


class Asked(NamedTuple):
    """A function at a problem.

    Attributes:
        name: its name.
        p: the problem.
        result: forward dynamics, whose grasp wrenches may be others.
    """

    name: str
    p: Problem
    result: hf.ForwardResult

    def called(self, suffix: str = "", **options: Any) -> Any:
        """Return what the function, or one of its derivatives, returns."""
        function: Callable[..., Any] = getattr(forces, self.name + suffix)
        own = self.result.grasp_wrench if self.name == "grasp_margins" else self.result
        return function(self.p.chain, self.p.state, own, **options)

    def directions(self, random: np.random.Generator) -> dict[str, np.ndarray]:
        """Return a direction of every argument."""
        found = random_directions(self.p, random, [name for name in BY[self.name] if name != "grasp_wrench"])
        return found | {"grasp_wrench": random.normal(size=self.result.grasp_wrench.shape)}

    def moved(self, along: Mapping[str, np.ndarray]) -> Asked:
        """Return the same, displaced."""
        wrench = self.result.grasp_wrench + along.get("grasp_wrench", 0.0)
        return Asked(self.name, displaced(self.p, along), replace(self.result, grasp_wrench=wrench))


def displaced(p: Problem, along: Mapping[str, np.ndarray]) -> Problem:
    """Return a problem with some of its arguments displaced, by name."""
    ends = np.cumsum([0, *(size_of(p, x) for x in NAMES)])
    at = {x: slice(a, b) for x, a, b in zip(NAMES, ends, ends[1:], strict=False)}
    flat = np.zeros(ends[-1])
    for name, x in along.items():
        if name in at:
            flat[at[name]] = np.ravel(x)
    return moved_problem(p, at, flat)


@cache
def problem() -> Problem:
    """Return arms that hold by a finger with friction, by a strong enough grip, without limit, and not at all."""
    p = random_problem(3, joints=(6, 4, 6, 2), grasps=("softfinger", "ball", "rigid", None))
    first, second, third = p.chain.grasps.items()
    grasps = {
        first[0]: replace(first[1], contact=hf.Friction(0.6, torsion_radius=0.02)),
        second[0]: replace(second[1], wrench_limits=WrenchLimits(force=20.0, moment=3.0)),
        third[0]: third[1],
    }
    return Problem(replace(p.chain, grasps=grasps), p.state, p.tau, p.inputs)


def asked(name: str) -> Asked:
    """Return a function at the problem, with its wrenches."""
    p = problem()
    return Asked(name, p, hf.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs))


def differences(of: Callable[[float], Any]) -> Any:
    """Return the derivative at 0 by five points; where the function is infinite it does not change."""
    far = [np.asarray(of(k * STEP)) for k in FIVE_POINTS]
    changes = [np.where(np.isinf(x), 0.0, x) for x in far]
    return sum(w * x for w, x in zip(FIVE_POINTS.values(), changes, strict=True)) / STEP


@pytest.mark.parametrize("name", BY)
def test_rates_are_five_point_differences(name):
    of, random = asked(name), np.random.default_rng(7)
    for by, along in of.directions(random).items():
        expected = differences(lambda h, by=by, x=along: of.moved({by: h * x}).called())
        got = of.called("_jvp", along={by: along})[name]
        value = of.called()
        assert np.any(expected), by
        assert relative_gap(got, expected, floor=1e-2 * np.abs(value[np.isfinite(value)]).max()) < TRUNCATED, by


@pytest.mark.parametrize("name", BY)
def test_a_gradient_along_a_direction_is_a_cotangent_along_the_rates(name):
    of, random = asked(name), np.random.default_rng(8)
    along, value = of.directions(random), of.called()
    bar = random.normal(size=value.shape)
    pulled, pushed = of.called("_vjp", by=BY[name], **{name: bar}), of.called("_jvp", along=along)
    parts = [float(np.sum(pulled[by] * x)) for by, x in along.items()]
    assert sum(parts) == pytest.approx(float(np.sum(bar * pushed[name])), abs=1e-13 * np.abs(parts).sum())
    assert np.array_equal(pulled.result, value)
    assert np.array_equal(pushed.result, value)


@pytest.mark.parametrize("name", BY)
def test_the_jacobian_holds_the_rates_of_all_directions(name):
    of, random = asked(name), np.random.default_rng(9)
    along = of.directions(random)
    matrix = of.called("_jacobian", by=BY[name])
    several = of.called("_jvp", along={by: np.stack([x, -2.0 * x]) for by, x in along.items()})[name]
    expected = sum(np.tensordot(matrix[name, by], x, np.ndim(x)) for by, x in along.items())
    assert relative_gap(several[0], expected) < EXACT
    assert relative_gap(several[1], -2.0 * expected) < EXACT


@pytest.mark.parametrize("name", BY)
def test_behind_forward_dynamics_gradients_are_those_of_torques_and_payload(name):
    """Gradients by the grasp wrenches are forward dynamics' cotangents: the whole against differences of the whole."""
    of, random = asked(name), np.random.default_rng(10)
    p, bar = of.p, random.normal(size=of.called().shape)
    by_wrench = of.called("_vjp", by=["grasp_wrench"], **{name: bar}).grasp_wrench
    by = ("tau", "object_mass")
    got = hf.forward_dynamics_vjp(p.chain, p.state, p.tau, inputs=p.inputs, by=by, grasp_wrench=by_wrench)

    def far(moved: Problem) -> float:
        result = hf.forward_dynamics(moved.chain, moved.state, moved.tau, inputs=moved.inputs)
        value = Asked(name, moved, result).called()
        return float(np.sum(bar * np.where(np.isinf(value), 0.0, value)))

    for argument, along in random_directions(p, random, by).items():
        expected = differences(lambda h, x=argument, d=along: far(displaced(p, {x: h * d})))
        assert float(np.sum(got[argument] * along)) == pytest.approx(float(expected), rel=1e-7)


def test_a_margin_that_nothing_limits_does_not_change():
    of = asked("grasp_margins")
    found = of.called("_jacobian", by=BY["grasp_margins"])
    assert list(np.isinf(found.result)) == [False, False, True]
    assert not any(found["grasp_margins", by][2].any() for by in BY["grasp_margins"])


def test_without_a_load_a_cone_opens_along_its_normal():
    """At f = 0 the length |B f| has the derivative 0, so what is left is what presses: 0 <= mu <= 1 normals."""
    of = asked("grasp_margins")
    still = of._replace(result=replace(of.result, grasp_wrench=np.zeros_like(of.result.grasp_wrench)))
    chain, (name, grasp) = of.p.chain, next(iter(of.p.chain.grasps.items()))
    found = still.called("_vjp", by=["grasp_wrench"], grasp_margins=[1.0, 0.0, 0.0]).grasp_wrench
    normal = (of.p.state.object_frame.R @ grasp.frame.R)[:, 2]
    row = found[chain.names.index(name), 3:]
    assert row @ normal in (pytest.approx(0.6), pytest.approx(1.0))
    assert np.allclose(row, (row @ normal) * normal, atol=1e-15)


@pytest.mark.parametrize("name", BY)
def test_what_does_not_fit_is_refused_in_words(name):
    of = asked(name)
    with pytest.raises(hf.StateError, match=f"{name}_vjp: no 'tau'"):
        of.called("_vjp", by=["tau"], **{name: np.zeros(of.called().shape)})
    with pytest.raises(hf.StateError, match=f"{name}: .*shape"):
        of.called("_vjp", **{name: np.zeros(17)})
    with pytest.raises(hf.StateError, match="expected shape"):
        of.called("_jvp", along={"grasp_wrench": np.zeros(5)})
    with pytest.raises(hf.StateError, match="overflow"):
        of.called("_jvp", along={"grasp_wrench": np.full((4, 6), 1.7e308)})
    with pytest.raises(hf.StateError, match=f"{name}_jacobian: no 'qdd'"):
        of.called("_jacobian", of=["qdd"])


@pytest.mark.parametrize("name", BY)
def test_a_trunk_is_refused_by_name(name):
    p = random_on_trunk(1, 2)
    of = Asked(name, p, hf.forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs))
    with pytest.raises(hf.MethodNotApplicable, match=f"{name}_jvp.*trunk"):
        of.called("_jvp", along={"grasp_wrench": np.zeros((len(p.chain.arms), 6))})
