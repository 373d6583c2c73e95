"""Derivatives of the elastic programme's central point: optimality, differences, and tangent against adjoint."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.forces.elastic_derivatives import central_point, numbers_of, rule_at, taken
from holdfast.forces.elastic_distribution import DISTRIBUTE, Programme, distributed, programme
from holdfast.forces.elastic_programme import Distributed, solve
from holdfast.questions.arrays import DISTRIBUTED, POSES
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import argument_shapes, function_jvp, function_vjp
from holdfast.spatial.differentiation import gradient
from holdfast.spatial.scalar import Array
from tests.forces.force_cases import force_cases
from tests.forces.test_elastic_distribution import case_of, fast
from tests.longer import mostly_long, mostly_slow

BARRIER, PRICE = 1e-5, 1e3
NAMES = [*force_cases()]
OVERLOADED = "hinge_soft_overloaded"
SOME = mostly_long(NAMES, ["two_soft_effort", "two_rigid_tight", "three_mixed_effort", OVERLOADED])
STEP = 1e-4  # of differences, relative to the programme's numbers
NINE_POINTS = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}


@cache
def made(name: str) -> Programme:
    """Return the programme of a stored question."""
    case = force_cases()[name]
    asked = case_of(case.chain, case.state, case.arguments[4], **case.call)
    return programme(chain_motion(case.chain, case.state, 0.0 * case.state.q, asked.inputs), asked.own)


@cache
def found(name: str) -> Distributed:
    """Return its central point."""
    return solve(made(name).blocks, made(name).e, PRICE, barrier=BARRIER)


def rounded(name: str) -> float:
    """Return what rounding leaves unknown of the slack that is smallest beside its cone's numbers.

    Where limits conflict, a force lies within 1e-8 of its cone's border: its distance is known to 1e-8 then, and so is
    the curvature of the barrier there, whatever the arithmetic does next.
    """
    cones = [s for own in found(name).last.points for s, _ in own.of_cones]
    return max([np.finfo(float).eps * s[0] / (s[0] - np.linalg.norm(s[1:])) for s in cones], default=0.0)


def numbers(name: str) -> list[Array]:
    """Return the programme's numbers."""
    return numbers_of(made(name).blocks, made(name).e, PRICE, BARRIER)


def flat(x: list[Array], v: float) -> Array:
    """Return arrays of all blocks and v."""
    return np.concatenate([*x, [v]])


def directions(name: str, random: np.random.Generator) -> list[Array]:
    """Return random rates of the programme's numbers, relative to their size; costs stay convex."""
    rates = [np.asarray(random.normal(size=x.shape) * (np.minimum(abs(x), 1.0) + 0.01)) for x in numbers(name)]
    blocks, e, *_ = taken(made(name).blocks, rates)
    turns = [0.1 * random.normal(size=block.P.shape) @ block.P for block in made(name).blocks]
    blocks = [block._replace(P=turn + turn.T) for block, turn in zip(blocks, turns, strict=True)]
    return numbers_of(blocks, e, PRICE * random.normal(), BARRIER * random.normal())


@pytest.mark.parametrize("name", NAMES)
def test_sixteen_iterations_reach_the_central_point(name):
    """s o z = mu [1, 0, ..] for every limit, and the gradient of the Lagrangian is zero."""
    at = found(name).last
    for block, own in zip(made(name).blocks, at.points, strict=True):
        np.testing.assert_allclose(own.s * own.z, BARRIER, rtol=1e-9)
        for s, z in own.of_cones:
            assert s @ z == pytest.approx(BARRIER, rel=1e-6)
            np.testing.assert_allclose(s[0] * z[1:] + z[0] * s[1:], 0.0, atol=1e-6 * BARRIER)
        slope = block.P @ own.x + block.c + block.pull(own.z, [z for _, z in own.of_cones]) + block.E.T @ at.nu
        np.testing.assert_allclose(slope, 0.0, atol=1e-12 * PRICE)
    assert at.v * at.z == pytest.approx(BARRIER, rel=1e-9)


@pytest.mark.parametrize("name", SOME)
def test_tangent_against_differences(name):
    """Rates by all numbers of the programme, its price and mu are differences of solutions."""
    rates = directions(name, np.random.default_rng(1))
    rule = rule_at(made(name).blocks, found(name), BARRIER)
    *dx, dv = rule.rates(*rates)
    expected = flat(dx, float(dv))

    def at(far: float) -> Array:
        moved = [x + far * d for x, d in zip(numbers(name), rates, strict=True)]
        blocks, e, price, mu = taken(made(name).blocks, moved)
        there = solve(blocks, e, price[()], 40, mu[()])
        return flat([*there.x, *there.multipliers], there.v)

    measured = sum(w * (at(k * STEP) - at(-k * STEP)) for k, w in NINE_POINTS.items()) / STEP
    assert np.abs(measured - expected).max() < 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize("name", NAMES)
def test_adjoint_against_tangent(name):
    """A gradient times a direction is a cotangent times the rates."""
    random = np.random.default_rng(2)
    rule, rates = rule_at(made(name).blocks, found(name), BARRIER), directions(name, random)
    bars = [random.normal(size=np.shape(x)) for x in (*found(name).x, *found(name).multipliers, found(name).v)]
    tangents, gradients = rule.rates(*rates), rule.gradient(*bars)
    left = [float(np.sum(a * b)) for a, b in zip(bars, tangents, strict=True)]
    right = [float(np.sum(a * b)) for a, b in zip(gradients, rates, strict=True)]
    assert sum(left) == pytest.approx(sum(right), abs=1e-11 * max(np.abs(left).max(), np.abs(right).max()))


def test_one_derivative_alone():
    """Numbers that vary have the rule's gradient, and a derivative within a derivative is refused."""
    name = "two_soft_effort"
    given, bar = numbers(name), [np.ones(x.shape) for x in (*found(name).x, *found(name).multipliers)]

    def summed(*varied: Array) -> float:
        blocks, e, price, mu = taken(made(name).blocks, varied)
        at = central_point(blocks, e, price[()], barrier=mu[()])
        return sum(x.sum() for x in (*at.x, *at.multipliers)) + at.v

    expected = rule_at(made(name).blocks, found(name), BARRIER).gradient(*bar, np.ones(()))
    for x, y in zip(gradient(summed, *given), expected, strict=True):
        np.testing.assert_allclose(x, y, atol=1e-12 * np.abs(y).max(initial=1.0))
    with pytest.raises(MethodNotApplicable, match="a derivative within another"):
        gradient(lambda *x: gradient(summed, *x)[0].sum(), *given)


def varied(case: VariedCase, along: dict[str, Array], far: float) -> VariedCase:
    """Return a case with arguments that are moved along a direction; poses turn and shift."""
    moved: dict[str, Array] = {}
    for name, rate in along.items():
        if name in POSES:
            of = name.removesuffix("_pose")
            R, p = case.numbers((f"{of}_R", f"{of}_p")).values()
            turns = Rotation.from_rotvec(far * rate[..., :3].reshape(-1, 3)).as_matrix().reshape(R.shape)
            moved |= {f"{of}_R": turns @ R, f"{of}_p": p + far * rate[..., 3:]}
        else:
            moved |= {name: x + far * rate for name, x in case.numbers((name,)).items()}
    return case.varied(moved)


@pytest.mark.parametrize("name", [pytest.param(x, marks=pytest.mark.slow) if x == OVERLOADED else x for x in SOME])
def test_distribution_against_differences(name):
    """Rates by state, acceleration, chain and run-time parameters are differences; gradients are their adjoint."""
    case, random = force_cases()[name], np.random.default_rng(3)
    of = case_of(case.chain, case.state, case.arguments[4], **(case.call | {"barrier": BARRIER}))
    along: dict[str, Array] = {}
    for by in DISTRIBUTE.arguments_at(case.chain):
        shape = argument_shapes(of)[by]
        size = 1.0 if by in POSES else np.minimum(np.abs(of.numbers((by,))[by]), 1.0)
        along[by] = np.asarray(random.normal(size=shape) * (size if by in DISTRIBUTED else 1.0))
    along |= {by: 0.01 * x for by, x in along.items() if by.startswith(("link", "object_m", "object_c", "object_i"))}
    for by in ("link_inertia", "object_inertia"):
        along[by] = along[by] + np.swapaxes(along[by], -1, -2)
    rates = function_jvp(DISTRIBUTE, of, 0.0, along).parts
    names = ("tau", "qdd", "grasp_wrench", "violation", "joint_price", "grasp_price")

    def at(far: float) -> dict[str, Array]:
        return dict(zip(DISTRIBUTE.names_at(case.chain), distributed(varied(of, along, far), 40), strict=True))

    far, within = {k: (at(k * STEP), at(-k * STEP)) for k in NINE_POINTS}, max(1e-7, 30.0 * rounded(name))
    for result in names:
        measured = sum(w * (far[k][0][result] - far[k][1][result]) for k, w in NINE_POINTS.items()) / STEP
        size = max(1.0, np.abs(rates[result]).max())
        np.testing.assert_allclose(measured, rates[result], rtol=0, atol=within * size, err_msg=result)

    bars = {result: random.normal(size=np.shape(rates[result])) for result in names}
    gradients = function_vjp(DISTRIBUTE, of, 0.0, tuple(along), bars).parts
    parts = [float(np.sum(gradients[by] * x)) for by, x in along.items()]
    forward = sum(float(np.sum(bar * rates[result])) for result, bar in bars.items())
    assert sum(parts) == pytest.approx(forward, abs=1e-9 * np.abs(parts).sum())


CURVED = ("two_rigid_effort", "three_soft_effort", "six_mixed_effort")  # cones are active
FLAT = ("cylinder_rigid_effort", "two_soft_wish", "one_contact")  # bounds alone, or nothing


@pytest.mark.parametrize("name", [*CURVED, *FLAT])
def test_none_without_a_barrier(name):
    """They are NaN: where cones are active, those of the last iterate are not those of the solution close to it."""
    at = solve(made(name).blocks, made(name).e, PRICE)
    rates = [*directions(name, np.random.default_rng(1))[:-1], np.zeros(())]
    assert all(np.isnan(x).all() for x in rule_at(made(name).blocks, at, 0.0).rates(*rates))
    near = solve(made(name).blocks, made(name).e, PRICE, 40, 1e-8)
    pair = [
        np.concatenate(rule_at(made(name).blocks, one, 1e-8).rates(*rates)[: len(made(name).blocks)])
        for one in (near, at)
    ]
    off = np.abs(pair[1] - pair[0]).max() / np.abs(pair[0]).max()
    assert off > 1e-3 if name in CURVED else off < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("name", mostly_slow(["two_soft_effort"], []))
def test_machine_code_refuses_without_a_barrier(name):
    """A call by name; in a bound call, which raises nothing, derivatives are NaN."""
    case, code = force_cases()[name], fast(name).distribute
    bars: dict[str, Any] = {"tau": np.ones(case.chain.joint_count)}
    pairs = [np.array([x, x]) for x in case.arguments]
    for given, barrier in ((case.arguments, 0.0), (pairs, 0.0), (pairs, np.array([BARRIER, 0.0]))):
        with pytest.raises(StateError, match=r"distribute\.vjp: barrier: expected one above 0, got 0.*barrier=1e-5"):
            code.vjp(*given, **(case.call | {"barrier": barrier}), by=["q"], **bars)
    with pytest.raises(StateError, match=r"distribute\.jvp: barrier"):
        code.jvp(*case.arguments, along={"q": np.ones(len(case.arguments[0]))})
    names = dict(zip(DISTRIBUTE.inputs, map(np.array, case.arguments), strict=True))
    bound: Any = code.bind("vjp", of=["tau"], by=["q"], **names, **case.call)
    bound.given["tau"][...] = 1.0
    bound()
    assert np.isnan(bound.found.q).all()
    bound.set(barrier=BARRIER)
    bound()
    expected = code.vjp(*case.arguments, **(case.call | {"barrier": BARRIER}), by=["q"], **bars).q
    np.testing.assert_array_equal(bound.found.q, expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(["two_soft_effort", "two_rigid_tight", "one_contact"], ["one_contact"]))
def test_machine_code(name):
    """Its derivatives are those of the text on floats, single and in a batch."""
    case, code, random = force_cases()[name], fast(name).distribute, np.random.default_rng(4)
    call: dict[str, Any] = case.call | {"barrier": BARRIER, "price": PRICE}
    of = case_of(case.chain, case.state, case.arguments[4], **call)
    by = ("q", "qd", "object_pose", "object_twist", "acceleration", "grasp_pose", "demanded_margin", "price", "barrier")
    shapes = {result: DISTRIBUTE.shape(case.chain, result) for result in ("tau", "grasp_wrench")}
    bars: dict[str, Any] = {result: random.normal(size=shape) for result, shape in shapes.items()}
    found, expected = (
        code.vjp(*case.arguments, **call, by=by, **bars), function_vjp(DISTRIBUTE, of, 0.0, by, bars)
    )  # fmt: skip
    for one in by:
        np.testing.assert_allclose(
            found[one], expected[one], rtol=0, atol=1e-7 * max(1.0, np.abs(expected[one]).max()), err_msg=one
        )
    along = {one: random.normal(size=argument_shapes(of)[one]) for one in ("q", "acceleration", "object_pose")}
    rates, expected = code.jvp(*case.arguments, **call, along=along), function_jvp(DISTRIBUTE, of, 0.0, along)
    np.testing.assert_allclose(rates.tau, expected.tau, atol=1e-8 * np.abs(expected.tau).max())
    matrix = code.jacobian(*case.arguments, **call, of=["tau"], by=["q"])["tau", "q"]
    gradients = code.vjp(*case.arguments, **call, by=["q"], tau=bars["tau"]).q
    np.testing.assert_allclose(bars["tau"] @ matrix, gradients, atol=1e-10 * np.abs(gradients).max())
    many = code.vjp(*(np.array([x] * 5) for x in case.arguments), **call, by=by, **bars)
    assert all(np.array_equal(many[one][k], found[one]) for one in by for k in range(5))
