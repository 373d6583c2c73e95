"""Machine code of derivatives of functions that solve nothing: the reference, differences, duality, and bits."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from holdfast.compiled.closure_derivatives import ClosureDerivatives
from holdfast.compiled.compiled_derivatives import options_of
from holdfast.compiled.force_derivatives import ForceDerivatives
from holdfast.compiled.function_derivatives import FunctionDerivatives
from holdfast.compiled.functions import ChainFunctions

import holdfast as hf
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiled.structure import optional_parameters
from holdfast.compiler.composition import Composition
from holdfast.compiler.interpret import interpret_schedule
from tests.derivatives.chains import random_chain
from tests.derivatives.functions import FIVE_POINTS, STEP, FunctionCase, function_case, undriven
from tests.longer import mostly_slow
from tests.systems.problems import random_problem, relative_gap

ENERGIES = ("kinetic_energy", "potential_energy")
CASES = [
    ("kinetic_energy", "plain"),
    ("inverse_dynamics", "plain"),
    *(("inverse_dynamics", kind) for kind in ("springs", "bushing", "trunk", "floating")),
    *((name, kind) for name in ENERGIES for kind in ("springs", "bushing", "trunk", "floating")),
    ("potential_energy", "plain"),
    ("grasp_margins", "limits"),
    ("grasp_margins", "floating"),
    ("joint_margins", "limits"),
    ("joint_margins", "floating"),
    *(("closure", kind) for kind in ("plain", "bushing", "trunk", "floating")),
    *(("wrist_wrenches", kind) for kind in ("limits", "trunk", "floating")),
]
GIVEN = {  # what machine code takes by place
    "kinetic_energy": ("q", "qd", "object_pose", "object_twist"),
    "inverse_dynamics": ("q", "qd", "qdd", "grasp_wrench"),
    "potential_energy": ("q", "object_pose"),
    "closure": ("q", "qd", "object_pose", "object_twist"),
    "grasp_margins": ("object_pose", "grasp_wrench"),
    "joint_margins": ("q", "qd", "tau"),
    "wrist_wrenches": ("q", "grasp_wrench"),
}
OF_FORCES = ("grasp_margins", "joint_margins", "wrist_wrenches")
SAME, DUAL = 1e-12, 1e-13
SOME = {
    "kinetic_energy": ("q", "qd"),
    "inverse_dynamics": ("q", "qdd"),
    "potential_energy": ("q",),
    "closure": ("q", "object_twist"),
    "grasp_margins": ("object_pose", "grasp_wrench"),
    "joint_margins": ("q", "tau"),
    "wrist_wrenches": ("q", "grasp_wrench"),
}


ONE_OF_EACH = [
    *((name, "limits" if name in OF_FORCES else "plain") for name in SOME),
    ("inverse_dynamics", "bushing"),
    ("inverse_dynamics", "floating"),
]


class Alone(ChainFunctions, FunctionDerivatives, ClosureDerivatives, ForceDerivatives):
    """A compiled chain without forward dynamics, whose machine code these tests do not wait for."""

    def __init__(self, chain: hf.ClosedChain, parameters: tuple[str, ...] = ()) -> None:
        self.chain, self.options = chain, optional_parameters(parameters, "compile")


def fast_of(of: FunctionCase) -> Alone:
    """Return the chain as machine code with every parameter."""
    return Alone(of.p.chain, ("link_inertia", "link_wrench"))


def inputs_of(of: FunctionCase) -> tuple[np.ndarray, ...]:
    """Return what machine code takes by place."""
    found = {"tau": of.p.tau, **of.own}
    return tuple(found[name] if name in found else getattr(of.p.state, name) for name in GIVEN[of.name])


def parameters_of(of: FunctionCase) -> dict[str, np.ndarray]:
    """Return what machine code takes by name."""
    given, state = of.p.inputs.shaped(of.p.chain), of.p.state
    found: dict[str, Any] = {"base_twist": given.base_twists, "trunk_base_twist": given.trunk_base_twist}
    found |= {"floating_pose": state.base_pose, "floating_twist": state.base_twist}
    if of.name == "inverse_dynamics":
        found |= {"base_acceleration": given.base_accelerations, "link_wrench": given.link_wrenches}
        found |= {"trunk_base_acceleration": given.trunk_base_acceleration}
        found |= {"trunk_link_wrench": given.trunk_link_wrenches}
        found |= {"floating_acceleration": of.own.get("floating_acceleration")}
        if of.p.chain.springs or of.p.chain.bushings:
            found |= {"object_pose": state.object_pose, "object_twist": state.object_twist}
    if of.name in ("potential_energy", "wrist_wrenches"):
        found = {"floating_pose": state.base_pose}
    if of.name in ("grasp_margins", "joint_margins"):
        return {}
    if of.p.chain.floats:
        found |= {"trunk_base_twist": None}
    return {name: x for name, x in found.items() if x is not None}


def called(of: FunctionCase, fast: Any, suffix: str, **options: Any) -> Any:
    """Return what machine code finds."""
    return getattr(fast, of.name + suffix)(*inputs_of(of), **parameters_of(of), **options)


def arrays_of(result: Any) -> list[np.ndarray]:
    """Return the arrays of a result."""
    if isinstance(result, dict):
        return [x for part in result.values() for x in part]
    return list(result) if isinstance(result, tuple) else [np.asarray(result)]


def random_case(seed: int, trunk: str | None) -> FunctionCase:
    """Return inverse dynamics of a random chain, accelerations and wrenches at random."""
    p, random = random_chain(seed, trunk, any_kind=False), np.random.default_rng(seed)
    held = np.array([name in p.chain.grasps for name in p.chain.arms])[:, None]
    own = {"qdd": random.normal(size=p.chain.joint_count), "grasp_wrench": held * random.normal(size=(len(held), 6))}
    return undriven(FunctionCase("inverse_dynamics", p, own))


def require_reference(of: FunctionCase) -> None:
    """Compare all derivatives by all arguments with the reference, and rates with gradients."""
    fast, random = fast_of(of), np.random.default_rng(1)
    cotangents, along = {name: random.normal(size=x.shape) for name, x in of.values().items()}, of.directions(random)
    back, ahead = called(of, fast, "_vjp", by=of.by, **cotangents), called(of, fast, "_jvp", along=along)
    expected, rates = of.called("_vjp", by=of.by, **cotangents), of.called("_jvp", along=along)
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
    matrix, expected = called(of, fast_of(of), "_jacobian", by=by), of.called("_jacobian", by=by)
    for result in of.results:
        for name in by:
            assert matrix[result, name].shape == expected[result, name].shape
            assert relative_gap(matrix[result, name], expected[result, name], floor=1.0) < SAME, (result, name)


@pytest.mark.parametrize(("name", "kind"), mostly_slow(CASES, CASES[:1]))
def test_derivatives_by_everything_are_those_of_the_reference(name, kind):
    require_reference(function_case(name, kind))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_jacobians_by_everything_are_those_of_the_reference(name, kind):
    of = function_case(name, kind)
    require_matrix(of, of.by)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "trunk"), [(1, None), (2, None), (3, "fixed"), (4, "fixed")])
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
    fast, random = Alone(of.p.chain), np.random.default_rng(3)
    given = dict(zip(("q", "qd", "qdd", "grasp_wrench"), inputs_of(of), strict=True))
    along = {name: random.normal(size=x.shape) * (x != 0.0) for name, x in given.items()}
    found = fast.inverse_dynamics.jvp(*given.values(), along=along)
    points = [fast.inverse_dynamics(*(x + k * STEP * along[name] for name, x in given.items())) for k in FIVE_POINTS]
    differences = sum(w * tau for w, tau in zip(FIVE_POINTS.values(), points, strict=True)) / STEP
    assert relative_gap(found.tau, differences) < 1e-9


@pytest.mark.parametrize(("name", "kind"), mostly_slow(ONE_OF_EACH, [("potential_energy", "plain")]))
def test_bits(name, kind):
    """One system, a batch of any size, its tail, and threads."""
    of, random, count = function_case(name, kind), np.random.default_rng(4), 21
    fast, result, by, named = fast_of(of), of.results[0], SOME[name], parameters_of(of)
    by = (*by, "object_pose") if kind == "bushing" else by
    far = 0.0 if kind == "floating" else 0.1  # other accelerations would need a drive of the base
    many = [np.array(x + far * random.normal(size=(count, *x.shape)) * (x != 0.0)) for x in inputs_of(of)]
    if "object_pose" in GIVEN[name]:
        many[GIVEN[name].index("object_pose")] = of.p.state.object_pose  # of unit length, and shared
    cotangent = random.normal(size=(count, *of.values()[result].shape))
    directions = of.directions(random)
    along = {x: random.normal(size=(count, *directions[x].shape)) for x in by}

    def one(x: np.ndarray, k: Any, ndim: int) -> np.ndarray:
        return x[k] if x.ndim > ndim else x

    def at(k: Any, threads: int = 1) -> list[np.ndarray]:
        given = [one(x, k, y.ndim) for x, y in zip(many, inputs_of(of), strict=True)]
        options = {**named, "threads": threads}
        back = getattr(fast, f"{name}_vjp")(*given, by=by, **{result: cotangent[k]}, **options)
        ahead = getattr(fast, f"{name}_jvp")(*given, along={x: d[k] for x, d in along.items()}, **options)
        matrix = getattr(fast, f"{name}_jacobian")(*given, by=by, **options)
        return [*(back[x] for x in by), ahead[result], *(matrix[result, x] for x in by), *arrays_of(back.result)]

    whole = at(slice(None))
    for x, *others in zip(whole, at(slice(None), 2), at(slice(0, 5)), strict=True):
        assert all(np.array_equal(x[: len(other)], other) for other in others)
    for k in (0, 7, count - 1):
        assert all(np.array_equal(x[k], single) for x, single in zip(whole, at(k), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "case"), ONE_OF_EACH)
@pytest.mark.parametrize("kind", ["vjp", "jvp", "jacobian"])
def test_interpreter(name, case, kind):
    """The schedules of derivatives read number by number give the bits of the machine code."""
    of, random = function_case(name, case), np.random.default_rng(6)
    fast, by, named = fast_of(of), SOME[name], parameters_of(of)
    cotangents = {result: random.normal(size=x.shape) for result, x in of.values().items()}
    own = dict(zip(GIVEN[name], inputs_of(of), strict=True))
    shapes = of.directions(random)
    along = {x: random.normal(size=shapes[x].shape) for x in by}
    options: dict[str, Any] = {"vjp": {"by": by, **cotangents}, "jvp": {"along": along}, "jacobian": {"by": by}}[kind]
    getattr(fast, f"{name}_{kind}")(*inputs_of(of), **options, **named)
    (request, made), *others = vars(fast)["_codes"].items()
    assert not others
    with_given = {f"{WITH}{x}": {**cotangents, **along}[x] for x in request.given}
    computation = request.computation(of.p.chain)
    structure = computation.structure(of.p.chain, options_of(fast.options, request.arguments, True))
    expected = interpret_schedule(computation.schedule(structure), {**made._own, **own, **named, **with_given})
    found = made((*own.values(), *with_given.values()), named, 1)
    assert list(found) == list(expected)
    for x, numbers in expected.items():
        assert np.array_equal(found[x], numbers), x


@pytest.mark.parametrize("name", ["grasp_margins", "potential_energy"])
@pytest.mark.parametrize("kind", ["vjp", "jvp", "jacobian"])
def test_bound_calls(name, kind):
    """Bits of the calls with arrays, at one state and another; inputs and parameters are changed in place."""
    of, random, by = function_case(name, "limits"), np.random.default_rng(7), SOME[name]
    fast, own = Alone(of.p.chain), dict(zip(GIVEN[name], inputs_of(of), strict=True))
    (result,), along = of.results, {x: y for x, y in of.directions(random).items() if x in by}
    given = {"vjp": {result: random.normal(size=of.values()[result].shape)}, "jvp": along, "jacobian": {}}[kind]
    bound = fast.bind_derivatives_of(name, kind, by=by, **own)
    for x, y in given.items():
        bound.given[x][...] = y
    pose = [*of.p.state.object_pose[:4], 0.1, 0.2, 0.3]
    for there in (own, own | {"object_pose": np.array(pose)}):
        bound.arrays["object_pose"][...] = there["object_pose"]
        bound()
        options = {"vjp": {"by": by, **given}, "jvp": {"along": given}, "jacobian": {"by": by}}[kind]
        expected = getattr(fast, f"{name}_{kind}")(*there.values(), **options)
        assert np.array_equal(bound.found.results[next(iter(bound.found.results))], expected.result)
        names = {"vjp": by, "jvp": (result,), "jacobian": [(result, x) for x in by]}[kind]
        assert all(np.array_equal(bound.found[x], expected[x]) for x in names)


def test_bound_calls_refuse_what_they_do_not_know():
    of = function_case("potential_energy", "limits")
    fast = Alone(of.p.chain)
    with pytest.raises(hf.StateError, match=r"function: expected one of .*, got 'potential_energie'. Did you mean"):
        fast.bind_derivatives_of("potential_energie", "vjp", by=["q"])
    with pytest.raises(hf.StateError, match="kind: expected one of vjp, jvp, jacobian, got 'grad'"):
        fast.bind_derivatives_of("potential_energy", "grad", by=["q"])  # pyright: ignore[reportArgumentType]
    with pytest.raises(hf.StateError, match=r"potential_energy\.vjp: no 'qd'"):
        fast.bind_derivatives_of("potential_energy", "vjp", by=["qd"])
    bound = fast.bind_derivatives_of("potential_energy", "vjp", by=["q"], q=of.p.state.q)
    with pytest.raises(hf.StateError, match="q: expected numbers of one system, got a batch of 2"):
        bound.set(q=np.zeros((2, of.p.chain.joint_count)))
    with pytest.raises(hf.StateError, match="no parameter 'tau'"):
        bound.set(tau=1.0)
    with pytest.raises(AttributeError, match="no derivative 'qd'; there are q"):
        _ = bound.found.qd
    gravity = np.array([0.0, 1.0, 2.0])
    bound.set(gravity=gravity, object_pose=of.p.state.object_pose)
    bound.given["potential_energy"][...] = 1.0
    bound()
    expected = fast.potential_energy.vjp(of.p.state.q, of.p.state.object_pose, by=["q"], gravity=gravity)
    assert np.array_equal(bound.found.q, expected.q)


def test_directions_at_once_and_shared_cotangents():
    of = function_case("kinetic_energy", "plain")
    fast, d = Alone(of.p.chain), np.random.default_rng(5).normal(size=(3, of.p.chain.joint_count))
    several = called(of, fast, "_jvp", along={"qd": d})["kinetic_energy"]
    momentum = called(of, fast, "_vjp", by=["qd"]).qd  # the cotangent is 1
    assert several == pytest.approx(d @ momentum, rel=1e-13)
    tripled = called(of, fast, "_vjp", by=["qd"], kinetic_energy=[3.0, 0.0]).qd
    np.testing.assert_allclose(tripled, [3.0 * momentum, 0.0 * momentum], rtol=1e-14)


def test_invalid_systems():
    """A batch has NaN where a system is invalid; one system raises an error that names the number."""
    of = function_case("potential_energy", "plain")
    fast, q = Alone(of.p.chain), np.tile(of.p.state.q, (3, 1))
    q[1, 0] = np.nan
    found = fast.potential_energy.vjp(q, of.p.state.object_pose, by=["q"])
    assert np.isnan(found.q[1]).all() and np.isfinite(found.q[[0, 2]]).all()
    with pytest.raises(hf.StateError, match=r"^q: expected finite numbers, got nan"):
        fast.potential_energy.vjp(q[1], of.p.state.object_pose, by=["q"])
    with pytest.raises(hf.StateError, match=r"^potential_energy: expected finite numbers, got inf"):
        fast.potential_energy.vjp(q[0], of.p.state.object_pose, by=["q"], potential_energy=np.inf)


def test_names_and_shapes_that_do_not_fit_are_refused():
    of = function_case("inverse_dynamics", "plain")
    fast, n = Alone(of.p.chain), of.p.chain.joint_count
    given: Any = inputs_of(of)
    with pytest.raises(hf.StateError, match=r"inverse_dynamics\.vjp: no 'tau'"):
        fast.inverse_dynamics.vjp(*given, by=["tau"], tau=np.ones(n))
    with pytest.raises(hf.StateError, match=r"inverse_dynamics\.jacobian: no 'qdd'"):
        fast.inverse_dynamics.jacobian(*given, of=["qdd"])
    with pytest.raises(hf.StateError, match=r"inverse_dynamics\.jvp: expected some of"):
        fast.inverse_dynamics.jvp(*given, along={})
    with pytest.raises(hf.StateError, match=r"inverse_dynamics\.jvp: along: expected"):
        fast.inverse_dynamics.jvp(*given, along=3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(hf.StateError, match=r"^tau: expected shape"):
        fast.inverse_dynamics.vjp(*given, by=["q"], tau=np.ones(n + 1))
    with pytest.raises(hf.StateError, match="no parameter 'object_mass'"):
        fast.inverse_dynamics.vjp(*given, by=["q"], tau=np.ones(n), object_mass=1.0)
    with pytest.raises(hf.StateError, match="holds nothing, expected zeros"):
        fast.inverse_dynamics.vjp(*given[:3], grasp_wrench=np.ones_like(given[3]), tau=np.ones(n))


@pytest.mark.parametrize("kind", ["bushing", "floating"])
def test_motions_that_are_not_possible(kind):
    """One system is refused with the reference's message; in a batch its results are not-a-number."""
    of = function_case("inverse_dynamics", kind)
    fast, given = fast_of(of), dict(zip(GIVEN[of.name], inputs_of(of), strict=True))
    named, lifted = parameters_of(of), np.array(given["grasp_wrench"])
    if kind == "bushing":
        lifted[of.p.chain.names.index(of.p.chain.bushings[0])] += 1.0
        changed = {"grasp_wrench": lifted}
        refused = of._replace(own={**of.own, **changed})
    else:
        changed = {"floating_acceleration": of.own["floating_acceleration"] + 1e-3}
        refused = of._replace(own={**of.own, **changed})
    with pytest.raises(hf.StateError) as expected:
        refused.called()
    tau = of.called()
    for call in (fast.inverse_dynamics, partial(fast.inverse_dynamics.vjp, by=["q"], tau=np.ones_like(tau))):
        with pytest.raises(hf.StateError) as got:
            call(**{**given, **named, **changed})
        assert str(got.value) == str(expected.value)
        ((name, off),) = changed.items()
        many = call(**{**given, **named, name: np.array([{**given, **named}[name], off])})
        for x in (many,) if call == fast.inverse_dynamics else (many.q, many.result):
            assert np.isnan(x[1]).all() and np.isfinite(x[0]).all()
    assert relative_gap(fast.inverse_dynamics(**given, **named), tau) < SAME


def test_where_the_object_is_must_be_given_to_springs():
    of = function_case("inverse_dynamics", "springs")
    with pytest.raises(hf.StateError, match=r"^object_pose: expected it, as springs between bodies or bushings"):
        Alone(of.p.chain).inverse_dynamics(*inputs_of(of))


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
    fast = Alone(chain)
    given = (p.state.q, p.state.qd, np.ones(n), np.ones((3, 6)))
    fast.inverse_dynamics.vjp(*given, tau=np.ones(n))
    assert made and all(len(keys) == 1 for _, keys in made)
    assert {group.count for group in made[0][0].groups} == {3}
    made.clear()
    fast.inverse_dynamics.jacobian(*given)
    rows = [keys for _, keys in made[-3:]]
    assert rows[0] == rows[1] == rows[2]
