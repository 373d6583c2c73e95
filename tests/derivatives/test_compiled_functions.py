"""Machine code of derivatives of functions that solve nothing: the reference, differences, duality, and bits."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiled import CompiledChain
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiled.structure import optional_parameters
from holdfast.compiler.composition import Composition
from holdfast.compiler.interpret import interpret_schedule
from holdfast.questions.case import OF_INPUTS, OF_STATE
from holdfast.questions.question import QUESTIONS
from tests.derivatives.chains import random_chain
from tests.derivatives.functions import CASES, FIVE_POINTS, STEP, FunctionCase, function_at, function_case
from tests.longer import mostly_long, mostly_slow
from tests.questions.every import differentiable, flat, taken_by
from tests.systems.problems import random_problem, relative_gap

SAME, DUAL = 1e-12, 1e-13
FEW = [case for case in CASES if case[1] not in ("springs", "trunk", "bushing")]
ONE_OF_EACH = [
    *((name, "limits" if QUESTIONS[name].unlimited else "plain") for name in differentiable()),
    ("inverse_dynamics", "bushing"),
    ("inverse_dynamics", "floating"),
]
BITS = [
    *mostly_slow(ONE_OF_EACH[:-2], [("potential_energy", "plain")]),
    *mostly_long(ONE_OF_EACH[-2:-1], ()),
    *mostly_slow(ONE_OF_EACH[-1:], ()),
]


def alone(chain: hf.ClosedChain, parameters: tuple[str, ...] = ()) -> CompiledChain:
    """Return a compiled chain without forward dynamics, whose machine code these tests do not wait for."""
    return CompiledChain(chain, optional_parameters(parameters, "compile"), None)


def fast_of(of: FunctionCase) -> Any:
    """Return the function as machine code with every parameter."""
    return getattr(alone(of.p.chain, ("link_inertia", "link_wrench")), of.name)


def some(name: str) -> tuple[str, ...]:
    """Return a few arguments of a question."""
    by = QUESTIONS[name].by
    return by if len(by) < 3 else (by[0], by[-1])


def inputs_of(of: FunctionCase) -> tuple[np.ndarray, ...]:
    """Return what machine code takes by place."""
    return tuple(array_of(of, name) for name in of.question.inputs)


def array_of(of: FunctionCase, name: str) -> Any:
    """Return an array of a problem; None if nothing is given."""
    found, p = {"tau": of.p.tau, "object_pose": of.p.state.object_pose, "floating_pose": of.p.state.base_pose}, of.p
    if name in OF_STATE:
        return getattr(p.state, OF_STATE[name])
    if name in OF_INPUTS:
        return getattr(p.inputs.shaped(p.chain), OF_INPUTS[name])
    return {**found, **of.own}[name]


def parameters_of(of: FunctionCase, fast: Any) -> dict[str, np.ndarray]:
    """Return what machine code takes by name, except what the chain says."""
    names = [name for name in taken_by(fast) if name in OF_INPUTS]
    found = {name: array_of(of, name) for name in (*names, *of.question.by_name(of.p.chain))}
    return {name: x for name, x in found.items() if x is not None}


def called(of: FunctionCase, fast: Any, kind: str, **options: Any) -> Any:
    """Return what machine code finds."""
    return getattr(fast, kind)(*inputs_of(of), **parameters_of(of, fast), **options)


def random_case(seed: int, trunk: str | None) -> FunctionCase:
    """Return inverse dynamics of a random chain, accelerations and wrenches at random."""
    return function_at("inverse_dynamics", random_chain(seed, trunk, any_kind=False), np.random.default_rng(seed))


def require_reference(of: FunctionCase) -> None:
    """Compare all derivatives by all arguments with the reference, and rates with gradients."""
    fast, random = fast_of(of), np.random.default_rng(1)
    cotangents, along = {name: random.normal(size=x.shape) for name, x in of.values().items()}, of.directions(random)
    back, ahead = called(of, fast, "vjp", by=of.by, **cotangents), called(of, fast, "jvp", along=along)
    expected, rates = of.called("vjp", by=of.by, **cotangents), of.called("jvp", along=along)
    assert_alike(back.result, expected.result)
    for name in of.by:
        assert back[name].shape == expected[name].shape
        assert relative_gap(back[name], expected[name], floor=1.0) < SAME, name
    for name in of.results:
        assert relative_gap(ahead[name], rates[name]) < SAME
    parts = [float(np.sum(back[name] * x)) for name, x in along.items()]
    expected = sum(float(np.sum(cotangent * ahead[name])) for name, cotangent in cotangents.items())
    assert sum(parts) == pytest.approx(expected, abs=DUAL * np.abs(parts).sum())


def assert_alike(found: Any, expected: Any) -> None:
    """Compare results, which may be tuples of arrays, and infinite."""
    if isinstance(expected, dict):
        assert list(found) == list(expected)
        found, expected = tuple(found.values()), tuple(expected.values())
    if isinstance(expected, tuple):
        assert type(found) is type(expected)
        for x, y in zip(found, expected, strict=True):
            assert_alike(x, y)
    else:
        finite = np.isfinite(expected)
        assert np.array_equal(finite, np.isfinite(found))
        x, y = (np.where(finite, value, 0.0) for value in (found, expected))
        assert relative_gap(x, y) < SAME


def require_matrix(of: FunctionCase, by: tuple[str, ...]) -> None:
    """Compare a Jacobian with the reference."""
    matrix, expected = called(of, fast_of(of), "jacobian", by=by), of.called("jacobian", by=by)
    for result in of.results:
        for name in by:
            assert matrix[result, name].shape == expected[result, name].shape
            assert relative_gap(matrix[result, name], expected[result, name], floor=1.0) < SAME, (result, name)


@pytest.mark.parametrize(("name", "kind"), mostly_slow(CASES, CASES[:1]))
def test_derivatives_by_everything_are_those_of_the_reference(name, kind):
    require_reference(function_case(name, kind))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), mostly_long(CASES, FEW))
def test_jacobians_by_everything_are_those_of_the_reference(name, kind):
    of = function_case(name, kind)
    require_matrix(of, of.by)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "trunk"), mostly_long([(1, None), (2, None), (3, "fixed"), (4, "fixed")], [(1, None), (3, "fixed")])
)
def test_random_chains_and_trunks(seed, trunk):
    of = random_case(seed, trunk)
    require_reference(of)
    require_matrix(of, ("q", "qd", "qdd", "grasp_wrench", "gravity"))


@pytest.mark.slow
def test_an_anchor_and_as_many_arms_as_joints():
    """Arguments of arms and of joints have equally many rows then, and are told apart."""
    p = random_problem(2, joints=(1, 2), moving_base=True)
    anchor = hf.Anchor(hf.Pose.translation(0.0, 0.0, 1.0))
    chain = hf.ClosedChain({"anchor": anchor, **p.chain.arms}, p.chain.held_object, p.chain.grasps)
    random = np.random.default_rng(4)
    own = {"qdd": random.normal(size=3), "grasp_wrench": random.normal(size=(3, 6)) * [[0.0], [1.0], [1.0]]}
    of = FunctionCase("inverse_dynamics", replace(p, chain=chain, inputs=hf.Inputs()), own)
    require_matrix(of, ("q", "qdd", "grasp_wrench", "base_pose", "link_mass"))


@pytest.mark.slow
def test_rates_are_five_point_differences():
    """Of machine code by machine code: torques of states that follow each other."""
    of = function_case("inverse_dynamics", "plain")
    fast, random = alone(of.p.chain), np.random.default_rng(3)
    given = dict(zip(of.question.inputs, inputs_of(of), strict=True))
    along = {name: random.normal(size=x.shape) * (x != 0.0) for name, x in given.items()}
    found = fast.inverse_dynamics.jvp(*given.values(), along=along)
    points = [fast.inverse_dynamics(*(x + k * STEP * along[name] for name, x in given.items())) for k in FIVE_POINTS]
    differences = sum(w * tau for w, tau in zip(FIVE_POINTS.values(), points, strict=True)) / STEP
    assert relative_gap(found.tau, differences) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), BITS)
def test_bits(name, kind):
    """One system, a batch of any size, its tail, and threads."""
    of, random, count = function_case(name, kind), np.random.default_rng(4), 21
    fast, result, by = fast_of(of), of.results[0], some(name)
    named, inputs = parameters_of(of, fast), of.question.inputs
    by = (*by, "object_pose") if kind == "bushing" else by
    far = 0.0 if kind == "floating" else 0.1  # other accelerations would need a drive of the base
    many = [np.array(x + far * random.normal(size=(count, *x.shape)) * (x != 0.0)) for x in inputs_of(of)]
    if "object_pose" in inputs:
        many[inputs.index("object_pose")] = of.p.state.object_pose  # of unit length, and shared
    cotangent = random.normal(size=(count, *of.values()[result].shape))
    directions = of.directions(random)
    along = {x: random.normal(size=(count, *directions[x].shape)) for x in by}

    def one(x: np.ndarray, k: Any, ndim: int) -> np.ndarray:
        return x[k] if x.ndim > ndim else x

    def at(k: Any, threads: int = 1) -> list[np.ndarray]:
        given = [one(x, k, y.ndim) for x, y in zip(many, inputs_of(of), strict=True)]
        options = {**named, "threads": threads}
        back = fast.vjp(*given, by=by, **{result: cotangent[k]}, **options)
        ahead = fast.jvp(*given, along={x: d[k] for x, d in along.items()}, **options)
        matrix = fast.jacobian(*given, by=by, **options)
        return [*(back[x] for x in by), ahead[result], *(matrix[result, x] for x in by), *flat(back.result).values()]

    whole = at(slice(None))
    for x, *others in zip(whole, at(slice(None), 2), at(slice(0, 5)), strict=True):
        assert all(np.array_equal(x[: len(other)], other) for other in others)
    for k in (0, 7, count - 1):
        assert all(np.array_equal(x[k], single) for x, single in zip(whole, at(k), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "case"), ONE_OF_EACH)
@pytest.mark.parametrize("kind", mostly_long(["vjp", "jvp", "jacobian"], ("vjp",)))
def test_interpreter(name, case, kind):
    """The schedules of derivatives read number by number give the bits of the machine code."""
    of, random = function_case(name, case), np.random.default_rng(6)
    fast, by = fast_of(of), some(name)
    cotangents = {result: random.normal(size=x.shape) for result, x in of.values().items()}
    own, named = dict(zip(of.question.inputs, inputs_of(of), strict=True)), parameters_of(of, fast)
    along = {x: random.normal(size=of.directions(random)[x].shape) for x in by}
    options: dict[str, Any] = {"vjp": {"by": by, **cotangents}, "jvp": {"along": along}, "jacobian": {"by": by}}[kind]
    answer = getattr(fast, kind)(*inputs_of(of), **options, **named)
    made = fast.derived(kind, answer.request.results, answer.request.arguments)
    with_given = {f"{WITH}{x}": {**cotangents, **along}[x] for x in answer.request.given}
    found = interpret_schedule(made.computation.schedule(), {**made.calls.own, **own, **named, **with_given})
    for x in answer.results.layout.shapes:
        assert np.array_equal(found[x], answer.results.array(x)), x


@pytest.mark.parametrize("name", mostly_slow(differentiable(), ["grasp_margins", "potential_energy"]))
@pytest.mark.parametrize("kind", ["vjp", "jvp", "jacobian"])
def test_bound_calls(name, kind):
    """Bits of the calls with arrays, at one state and another; inputs and parameters are changed in place."""
    of, random, by = function_case(name, "limits"), np.random.default_rng(7), some(name)
    fast, values = getattr(alone(of.p.chain), name), of.values()
    own = {x: np.array(y) for x, y in zip(of.question.inputs, inputs_of(of), strict=True)}
    along = {x: y for x, y in of.directions(random).items() if x in by}
    cotangents = {result: random.normal(size=x.shape) for result, x in values.items()}
    given = {"vjp": cotangents, "jvp": along, "jacobian": {}}[kind]
    bound, answer = fast.bind(kind, of=of.results, by=by, **own), fast.bind(**own)
    changed = own["object_pose"][4:] if "object_pose" in own else own["q"]
    assert all(bound.arrays[x] is y for x, y in own.items())
    for x, y in given.items():
        bound.given[x][...] = y
    for far in (0.0, 0.1):
        changed += far
        bound()
        options = {"vjp": {"by": by, **given}, "jvp": {"along": given}, "jacobian": {"by": by}}[kind]
        expected = getattr(fast, kind)(*own.values(), **options)
        for found in (bound.result, answer()):
            assert all(np.array_equal(x, flat(expected.result)[key]) for key, x in flat(found).items())
        pairs = [(result, x) for result in of.results for x in by]
        names = {"vjp": by, "jvp": of.results, "jacobian": pairs}[kind]
        assert all(np.array_equal(bound.found[x], expected[x]) for x in names)


def test_bound_calls_refuse_what_they_do_not_know():
    of = function_case("potential_energy", "limits")
    fast = alone(of.p.chain).potential_energy
    with pytest.raises(
        hf.errors.StateError, match=r"potential_energy\.bind: expected vjp, jvp or jacobian, got 'grad'"
    ):
        fast.bind("grad", by=["q"])
    with pytest.raises(hf.errors.StateError, match=r"potential_energy\.vjp: no 'qd'"):
        fast.bind("vjp", by=["qd"])
    bound = fast.bind("vjp", by=["q"], q=np.array(of.p.state.q))
    with pytest.raises(hf.errors.StateError, match="q: expected numbers of one system, got a batch of 2"):
        bound.set(q=np.zeros((2, of.p.chain.joint_count)))
    with pytest.raises(hf.errors.StateError, match="no parameter 'tau'"):
        bound.set(tau=1.0)
    with pytest.raises(AttributeError, match=r"no derivative 'qd'\. Did you mean 'q'"):
        _ = bound.found.qd
    gravity = np.array([0.0, 1.0, 2.0])
    bound.set(gravity=gravity, object_pose=of.p.state.object_pose)
    bound.given["potential_energy"][...] = 1.0
    bound()
    expected = fast.vjp(of.p.state.q, of.p.state.object_pose, by=["q"], gravity=gravity)
    assert np.array_equal(bound.found.q, expected.q)


def test_directions_at_once_and_shared_cotangents():
    of = function_case("kinetic_energy", "plain")
    fast, d = fast_of(of), np.random.default_rng(5).normal(size=(3, of.p.chain.joint_count))
    several = called(of, fast, "jvp", along={"qd": d})["kinetic_energy"]
    momentum = called(of, fast, "vjp", by=["qd"]).qd  # the cotangent is 1
    assert several == pytest.approx(d @ momentum, rel=1e-13)
    tripled = called(of, fast, "vjp", by=["qd"], kinetic_energy=[3.0, 0.0]).qd
    np.testing.assert_allclose(tripled, [3.0 * momentum, 0.0 * momentum], rtol=1e-14)


def test_invalid_systems():
    """A batch has NaN where a system is invalid; one system raises an error that names the number."""
    of = function_case("potential_energy", "plain")
    fast, q = alone(of.p.chain), np.tile(of.p.state.q, (3, 1))
    q[1, 0] = np.nan
    found = fast.potential_energy.vjp(q, of.p.state.object_pose, by=["q"])
    assert np.isnan(found.q[1]).all() and np.isfinite(found.q[[0, 2]]).all()
    with pytest.raises(hf.errors.StateError, match=r"^q: expected finite numbers, got nan"):
        fast.potential_energy.vjp(q[1], of.p.state.object_pose, by=["q"])
    with pytest.raises(hf.errors.StateError, match=r"^potential_energy: expected finite numbers, got inf"):
        fast.potential_energy.vjp(q[0], of.p.state.object_pose, by=["q"], potential_energy=np.inf)


@pytest.mark.slow
def test_names_and_shapes_that_do_not_fit_are_refused():
    of = function_case("inverse_dynamics", "plain")
    fast, n = alone(of.p.chain), of.p.chain.joint_count
    given: Any = inputs_of(of)
    with pytest.raises(hf.errors.StateError, match=r"inverse_dynamics\.vjp: no 'tau'"):
        fast.inverse_dynamics.vjp(*given, by=["tau"], tau=np.ones(n))
    with pytest.raises(hf.errors.StateError, match=r"inverse_dynamics\.jacobian: no 'qdd'"):
        fast.inverse_dynamics.jacobian(*given, of=["qdd"])
    with pytest.raises(hf.errors.StateError, match=r"inverse_dynamics\.jvp: expected some of"):
        fast.inverse_dynamics.jvp(*given, along={})
    with pytest.raises(hf.errors.StateError, match=r"inverse_dynamics\.jvp: along: expected"):
        fast.inverse_dynamics.jvp(*given, along=3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(hf.errors.StateError, match=r"^tau: expected shape"):
        fast.inverse_dynamics.vjp(*given, by=["q"], tau=np.ones(n + 1))
    with pytest.raises(hf.errors.StateError, match="no parameter 'object_mass'"):
        fast.inverse_dynamics.vjp(*given, by=["q"], tau=np.ones(n), object_mass=1.0)
    with pytest.raises(hf.errors.StateError, match="holds nothing, expected zeros"):
        fast.inverse_dynamics.vjp(*given[:3], grasp_wrench=np.ones_like(given[3]), tau=np.ones(n))


@pytest.mark.slow
@pytest.mark.parametrize("kind", mostly_slow(["bushing", "floating"], ["floating"]))
def test_motions_that_are_not_possible(kind):
    """One system is refused with the reference's message; in a batch its results are not-a-number."""
    of = function_case("inverse_dynamics", kind)
    fast, given = fast_of(of), dict(zip(of.question.inputs, inputs_of(of), strict=True))
    named, lifted = parameters_of(of, fast), np.array(given["grasp_wrench"])
    if kind == "bushing":
        lifted[of.p.chain.names.index(of.p.chain.bushings[0])] += 1.0
        changed = {"grasp_wrench": lifted}
        refused = of._replace(own={**of.own, **changed})
    else:
        changed = {"floating_acceleration": of.own["floating_acceleration"] + 1e-3}
        refused = of._replace(own={**of.own, **changed})
    with pytest.raises(hf.errors.StateError) as expected:
        refused.called()
    tau = of.called()
    for call in (fast, partial(fast.vjp, by=["q"], tau=np.ones_like(tau))):
        with pytest.raises(hf.errors.StateError) as got:
            call(**{**given, **named, **changed})
        assert str(got.value) == str(expected.value)
        ((name, off),) = changed.items()
        many = call(**{**given, **named, name: np.array([{**given, **named}[name], off])})
        for x in (many,) if call is fast else (many.q, many.result):
            assert np.isnan(x[1]).all() and np.isfinite(x[0]).all()
    assert relative_gap(fast(**given, **named), tau) < SAME


def test_where_the_object_is_must_be_given_to_springs():
    of = function_case("inverse_dynamics", "springs")
    with pytest.raises(hf.errors.StateError, match=r"^object_pose: expected it, as springs between bodies or bushings"):
        alone(of.p.chain).inverse_dynamics(*inputs_of(of))


@pytest.mark.slow
def test_arms_of_one_type_share_their_code(monkeypatch):
    """The loops of derivatives are those of the function, over arms; a Jacobian's rows are one region for all arms."""
    p = random_problem(3, joints=(4, 4, 4), grasps=("rigid", "rigid", "rigid"))
    arm = next(iter(p.chain.arms.values()))
    arms = {name: replace(arm, base=other.base, name=name) for name, other in p.chain.arms.items()}
    chain, made, each = replace(p.chain, arms=arms), [], Composition.each
    n = chain.joint_count

    def noted(self: Composition, f: Any, items: list[tuple[Any, ...]]) -> list[Any]:
        made.append((self, {key for _, key in self._flat(f, items)}))
        return each(self, f, items)

    monkeypatch.setattr(Composition, "each", noted)
    monkeypatch.setenv("HOLDFAST_CACHE", "off")
    fast = alone(chain)
    given = (p.state.q, p.state.qd, np.ones(n), np.ones((3, 6)))
    fast.inverse_dynamics.vjp(*given, tau=np.ones(n))
    assert made and all(len(keys) == 1 for _, keys in made)
    assert {group.count for group in made[0][0].groups} == {3}
    made.clear()
    fast.inverse_dynamics.jacobian(*given)
    rows = [keys for _, keys in made[-3:]]
    assert rows[0] == rows[1] == rows[2]
