"""Derivatives of the functions that solve nothing, such as inverse dynamics and energies: differences, and laws."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast import dynamics
from holdfast.questions.question import QUESTIONS
from tests.derivatives.blocks import names_for, random_directions
from tests.derivatives.functions import CASES, FunctionCase, function_case, open_grasp, problem
from tests.longer import mostly_long, mostly_slow
from tests.questions.every import differentiable, flat
from tests.systems.problems import relative_gap

TRUNCATED, EXACT = 1e-8, 1e-12
GRASPS = ("rigid", "hinge", "softfinger", "universal", "slider", "cylinder", "screw", "planar", "two slides")
OF_FORCES = [(name, "limits") for name in differentiable() if QUESTIONS[name].unlimited]
ALL = pytest.mark.parametrize(
    ("name", "kind"), mostly_slow(CASES, [case for case in CASES if case[1] not in ("springs", "bushing", "floating")])
)

FEW = pytest.mark.parametrize(
    ("name", "kind"), mostly_long(CASES, [case for case in CASES if case[1] not in ("springs", "bushing", "floating")])
)


def size_of_terms(of: FunctionCase, result: str) -> float:
    """Return the largest finite entry of a result, which differences lose digits of."""
    values = of.values()[result]
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


@pytest.mark.parametrize("each", [pytest.param(True, marks=pytest.mark.slow), False], ids=["each", "together"])
@ALL
def test_rates_are_five_point_differences(name, kind, each):
    """Along each argument; and along all of them at once, whose rate is the sum."""
    of, random = function_case(name, kind), np.random.default_rng(7)
    directions = of.directions(random)
    for along in [{by: x} for by, x in directions.items()] if each else [directions]:
        expected, got = of.differences(along), of.called("jvp", along=along)
        for result in of.results:
            floor = 1e-2 * size_of_terms(of, result)
            assert relative_gap(got[result], expected[result], floor=floor) < TRUNCATED, ([*along], result)


@ALL
def test_a_gradient_along_a_direction_is_a_cotangent_along_the_rates(name, kind):
    of, random = function_case(name, kind), np.random.default_rng(8)
    along = of.directions(random)
    cotangents = {result: random.normal(size=value.shape) for result, value in of.values().items()}
    pulled, pushed = of.called("vjp", by=of.by, **cotangents), of.called("jvp", along=along)
    parts = [float(np.sum(pulled[by] * x)) for by, x in along.items()]
    expected = sum(float(np.sum(cotangent * pushed[result])) for result, cotangent in cotangents.items())
    assert sum(parts) == pytest.approx(expected, abs=1e-13 * np.abs(parts).sum())


@ALL
def test_functions_return_what_their_questions_compute(name, kind):
    of = function_case(name, kind)
    assert same(of.called(), of.question.shown(of.p.chain)(of.values()))


@pytest.mark.slow
@FEW
def test_derivatives_come_with_what_the_function_returns(name, kind):
    of = function_case(name, kind)
    cotangents = {result: np.zeros(value.shape) for result, value in of.values().items()}
    nothing = {by: 0.0 * x for by, x in of.directions(np.random.default_rng(0)).items()}
    for found in (of.called("vjp", by=of.by, **cotangents), of.called("jvp", along=nothing)):
        assert same(found.result, of.called())
        assert not any(np.any(x) for x in found.parts.values())


def same(found: Any, expected: Any) -> bool:
    """Return whether two answers have the same form and numbers."""
    x, y = flat(found), flat(expected)
    return [*x] == [*y] and all(np.array_equal(x[name], y[name]) for name in y)


@pytest.mark.parametrize(
    ("name", "kind"), mostly_slow([*((name, "floating") for name in differentiable()), *OF_FORCES], OF_FORCES)
)
def test_the_jacobian_holds_the_rates_of_all_directions(name, kind):
    of, random = function_case(name, kind), np.random.default_rng(9)
    along = of.directions(random)
    matrix = of.called("jacobian", by=of.by)
    several = of.called("jvp", along={by: np.stack([x, 0.5 * x, 0.0 * x]) for by, x in along.items()})
    for result, value in of.values().items():
        expected = sum(np.tensordot(matrix[result, by], x, np.ndim(x)) for by, x in along.items())
        assert several[result].shape == (3, *value.shape)
        assert relative_gap(several[result][0], expected) < EXACT
        assert relative_gap(several[result][1], 0.5 * expected) < EXACT
        assert not several[result][2].any()


@pytest.mark.parametrize("kind", ["plain", "springs", "trunk", "floating"])
def test_inverse_after_forward_dynamics_returns_the_change_of_torques(kind):
    """tau = inverse(theta, qdd(theta, tau), f(theta, tau)) for all theta: its total derivative is tau's own."""
    p, random = problem(kind), np.random.default_rng(10)
    along = random_directions(p, random, names_for(p))
    there = hf.forward_dynamics_jvp(p.chain, p.state, p.tau, inputs=p.inputs, along=along)
    results = ("qdd", "grasp_wrench", *(["floating_acceleration"] if p.chain.floats else []))
    back = hf.inverse_dynamics.jvp(
        p.chain,
        p.state,
        there.result.qdd,
        there.result.grasp_wrench,
        p.inputs,
        there.result.base_acceleration,
        along={name: x for name, x in along.items() if name != "tau"} | {name: there[name] for name in results},
    )
    # terms that cancel are larger than what is left of them
    assert relative_gap(back.tau, along["tau"], floor=np.abs(there.grasp_wrench).max()) < 1e-10


@pytest.mark.parametrize("kind", ["plain", "springs", "trunk", "floating"])
def test_energy_changes_by_the_power(kind):
    p = problem(kind)
    still = hf.Inputs(object_wrench=p.inputs.object_wrench, trunk_link_wrenches=p.inputs.trunk_link_wrenches)
    chain, state = p.chain, dynamics.project_velocity(p.chain, p.state)
    result = hf.forward_dynamics(chain, state, p.tau, inputs=still)
    motion = {"q": state.qd, "object_pose": state.object_twist}
    faster = {"qd": result.qdd, "object_twist": result.object_acceleration}
    if chain.floats:
        motion |= {"floating_pose": state.base_twist}
        faster |= {"floating_twist": result.base_acceleration}
    rate = dynamics.kinetic_energy.jvp(chain, state, still, along=motion | faster)["kinetic_energy"]
    rate = rate + dynamics.potential_energy.jvp(chain, state, along=motion)["potential_energy"]
    power = dynamics.power(chain, state, p.tau, result, still)
    assert float(rate) == pytest.approx(sum(power), abs=1e-11 * np.abs(power).sum())


@pytest.mark.parametrize("kind", ["plain", "trunk", "floating"])
def test_positions_open_as_fast_as_velocities_say(kind):
    """Of a closed chain in any motion, for rows that positions and velocities both have."""
    p, random = problem(kind), np.random.default_rng(11)
    chain = p.chain
    loose = {"qd": p.state.qd + random.normal(size=chain.joint_count)}
    state = replace(p.state, **loose, object_twist=random.normal(size=6))
    motion = {"q": state.qd, "object_pose": state.object_twist}
    motion |= {"floating_pose": state.base_twist} if chain.floats else {}
    still = replace(p.inputs, base_twists=None, trunk_base_twist=None)
    found = dynamics.closure.jvp(chain, state, still, along=motion)
    now = np.concatenate([gap.velocity for gap in dynamics.closure(chain, state, still).values()])
    assert np.abs(now).max() > 0.1
    assert relative_gap(found.position, now) < 1e-9


@pytest.mark.parametrize("kind", GRASPS)
def test_closure_of_every_kind_of_grasp(kind):
    """Open grasps, far from closed ones: angles are large, threads have turned."""
    of, random = open_grasp(kind), np.random.default_rng(12)
    assert max(np.abs(x).max() for x in of.values().values()) > 0.3
    for by, along in of.directions(random).items():
        expected, got = of.differences({by: along}), of.called("jvp", along={by: along})
        for result in of.results:
            assert relative_gap(got[result], expected[result], floor=1.0) < TRUNCATED, (by, result)


def test_what_torques_do_not_depend_on_has_a_gradient_of_nothing():
    of = function_case("inverse_dynamics", "plain")
    found = of.called("vjp", by=["object_mass", "grasp_pose", "object_wrench"], tau=np.ones(of.p.chain.joint_count))
    assert not any(np.any(found[name]) for name in found.parts)


def test_names_and_shapes_that_do_not_fit_are_refused():
    of = function_case("inverse_dynamics", "plain")
    n = of.p.chain.joint_count
    with pytest.raises(hf.errors.StateError, match=r"inverse_dynamics\.vjp: no 'tau'"):
        of.called("vjp", by=["tau"], tau=np.ones(n))
    with pytest.raises(hf.errors.StateError, match="expected some of"):
        of.called("vjp", by=[], tau=np.ones(n))
    with pytest.raises(hf.errors.StateError, match="expected some of"):
        of.called("vjp", by=3, tau=np.ones(n))
    with pytest.raises(hf.errors.StateError, match="tau: expected finite numbers, got an overflow"):
        of.called("jvp", along={"q": 1e308 * np.ones(n)})
    with pytest.raises(hf.HoldfastError, match=r"inverse_dynamics\.jvp: expected along too"):
        of.called("jvp")
    with pytest.raises(hf.errors.StateError, match="tau"):
        of.called("vjp", tau=np.ones(n + 1))
    with pytest.raises(hf.errors.StateError, match="expected shape"):
        of.called("jvp", along={"q": np.ones(n + 1)})
    with pytest.raises(hf.errors.StateError, match=r"kinetic_energy\.jacobian: no 'gravity'"):
        function_case("kinetic_energy", "plain").called("jacobian", by=["gravity"])
