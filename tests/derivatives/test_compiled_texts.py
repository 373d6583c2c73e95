"""Machine code of derivatives of functions that solve nothing: the reference, differences, duality, and bits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiled.function_derivatives import FunctionDerivatives
from holdfast.compiled.functions import ChainFunctions
from holdfast.compiled.structure import optional_parameters
from holdfast.compiler.composition import Composition
from tests.derivatives.chains import random_chain
from tests.derivatives.texts import FIVE_POINTS, STEP, Asked, asked, undriven
from tests.longer import mostly_slow
from tests.systems.problems import random_problem, relative_gap

ENERGIES = ("kinetic_energy", "potential_energy")
CASES = [
    ("kinetic_energy", "plain"),
    ("inverse_dynamics", "plain"),
    *((name, kind) for name in ENERGIES for kind in ("springs", "bushing", "trunk", "floating")),
    ("potential_energy", "plain"),
]
SAME, DUAL = 1e-11, 1e-13
SOME = {"kinetic_energy": ("q", "qd"), "inverse_dynamics": ("q", "qdd"), "potential_energy": ("q",)}


class Alone(ChainFunctions, FunctionDerivatives):
    """A compiled chain without forward dynamics, whose machine code these tests do not wait for."""

    def __init__(self, chain: hf.ClosedChain, parameters: tuple[str, ...] = ()) -> None:
        self.chain, self.options = chain, optional_parameters(parameters, "compile")


def fast_of(of: Asked) -> Alone:
    """Return the chain as machine code with every parameter."""
    return Alone(of.p.chain, ("link_inertia", "link_wrench"))


def inputs_of(of: Asked) -> tuple[np.ndarray, ...]:
    """Return what machine code takes by place."""
    s = of.p.state
    if of.name == "inverse_dynamics":
        return s.q, s.qd, of.own["qdd"], of.own["grasp_wrench"]
    return (s.q, s.object_pose) if of.name == "potential_energy" else (s.q, s.qd, s.object_pose, s.object_twist)


def parameters_of(of: Asked) -> dict[str, np.ndarray]:
    """Return what machine code takes by name."""
    given, state = of.p.inputs.shaped(of.p.chain), of.p.state
    found: dict[str, Any] = {"base_twist": given.base_twists, "trunk_base_twist": given.trunk_base_twist}
    found |= {"floating_pose": state.base_pose, "floating_twist": state.base_twist}
    if of.name == "inverse_dynamics":
        found |= {"base_acceleration": given.base_accelerations, "link_wrench": given.link_wrenches}
        found |= {"trunk_base_acceleration": given.trunk_base_acceleration}
        found |= {"trunk_link_wrench": given.trunk_link_wrenches}
    if of.name == "potential_energy":
        found = {"floating_pose": state.base_pose}
    if of.p.chain.floats:
        found |= {"trunk_base_twist": None}
    return {name: x for name, x in found.items() if x is not None}


def called(of: Asked, fast: Any, suffix: str, **options: Any) -> Any:
    """Return what machine code finds."""
    return getattr(fast, of.name + suffix)(*inputs_of(of), **parameters_of(of), **options)


def random_case(seed: int, trunk: str | None) -> Asked:
    """Return inverse dynamics of a random chain, accelerations and wrenches at random."""
    p, random = random_chain(seed, trunk, any_kind=False), np.random.default_rng(seed)
    held = np.array([name in p.chain.grasps for name in p.chain.arms])[:, None]
    own = {"qdd": random.normal(size=p.chain.joint_count), "grasp_wrench": held * random.normal(size=(len(held), 6))}
    return undriven(Asked("inverse_dynamics", p, own))


def require_reference(of: Asked) -> None:
    """Compare all derivatives by all arguments with the reference, and rates with gradients."""
    fast, random, result = fast_of(of), np.random.default_rng(1), of.results[0]
    bar, along = random.normal(size=of.values()[result].shape), of.directions(random)
    back, ahead = called(of, fast, "_vjp", by=of.by, **{result: bar}), called(of, fast, "_jvp", along=along)
    expected = of.called("_vjp", by=of.by, **{result: bar})
    assert relative_gap(np.asarray(back.result), np.asarray(expected.result)) < SAME
    for name in of.by:
        assert back[name].shape == expected[name].shape
        assert relative_gap(back[name], expected[name], floor=1.0) < SAME, name
    assert relative_gap(ahead[result], of.called("_jvp", along=along)[result]) < SAME
    parts = [float(np.sum(back[name] * x)) for name, x in along.items()]
    assert sum(parts) == pytest.approx(float(np.sum(bar * ahead[result])), abs=DUAL * np.abs(parts).sum())


def require_matrix(of: Asked, by: tuple[str, ...]) -> None:
    """Compare a Jacobian with the reference."""
    matrix, expected = called(of, fast_of(of), "_jacobian", by=by), of.called("_jacobian", by=by)
    for name in by:
        assert matrix[of.results[0], name].shape == expected[of.results[0], name].shape
        assert relative_gap(matrix[of.results[0], name], expected[of.results[0], name], floor=1.0) < SAME, name


@pytest.mark.parametrize(("name", "kind"), mostly_slow(CASES, CASES[:1]))
def test_derivatives_by_everything_are_those_of_the_reference(name, kind):
    require_reference(asked(name, kind))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_jacobians_by_everything_are_those_of_the_reference(name, kind):
    of = asked(name, kind)
    require_matrix(of, of.by)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "trunk"), [(1, None), (2, None), (3, "fixed"), (4, "fixed")])
def test_random_chains_and_trunks(seed, trunk):
    of = random_case(seed, trunk)
    require_reference(of)
    require_matrix(of, ("q", "qd", "qdd", "grasp_wrench", "gravity"))


@pytest.mark.slow
def test_rates_are_five_point_differences():
    """Of machine code by machine code: torques of states that follow each other."""
    of = asked("inverse_dynamics", "plain")
    fast, random = Alone(of.p.chain), np.random.default_rng(3)
    given = dict(zip(("q", "qd", "qdd", "grasp_wrench"), inputs_of(of), strict=True))
    along = {name: random.normal(size=x.shape) * (x != 0.0) for name, x in given.items()}
    found = fast.inverse_dynamics_jvp(*given.values(), along=along)
    points = [fast.inverse_dynamics(*(x + k * STEP * along[name] for name, x in given.items())) for k in FIVE_POINTS]
    differences = sum(w * tau for w, tau in zip(FIVE_POINTS.values(), points, strict=True)) / STEP
    assert relative_gap(found.tau, differences) < 1e-9


@pytest.mark.parametrize("name", mostly_slow(list(SOME), ["potential_energy"]))
def test_bits(name):
    """One system, a batch of any size, its tail, and threads."""
    of, random, count = asked(name, "plain"), np.random.default_rng(4), 21
    fast, result, by = Alone(of.p.chain), of.results[0], SOME[name]
    many = [np.array(x + 0.1 * random.normal(size=(count, *x.shape)) * (x != 0.0)) for x in inputs_of(of)]
    if name != "inverse_dynamics":
        many[-1 if name == "potential_energy" else 2] = of.p.state.object_pose  # of unit length, and shared
    bar = random.normal(size=(count, *of.values()[result].shape))
    own = dict(zip(("q", "qd", "qdd"), inputs_of(of), strict=False))
    along = {x: random.normal(size=(count, *own[x].shape)) for x in by}

    def one(x: np.ndarray, k: Any, ndim: int) -> np.ndarray:
        return x[k] if x.ndim > ndim else x

    def at(k: Any, threads: int = 1) -> list[np.ndarray]:
        given = [one(x, k, y.ndim) for x, y in zip(many, inputs_of(of), strict=True)]
        back = getattr(fast, f"{name}_vjp")(*given, by=by, **{result: bar[k]}, threads=threads)
        ahead = getattr(fast, f"{name}_jvp")(*given, along={x: d[k] for x, d in along.items()}, threads=threads)
        matrix = getattr(fast, f"{name}_jacobian")(*given, by=by, threads=threads)
        return [*(back[x] for x in by), ahead[result], *(matrix[result, x] for x in by), np.asarray(back.result)]

    whole = at(slice(None))
    for x, *others in zip(whole, at(slice(None), 2), at(slice(0, 5)), strict=True):
        assert all(np.array_equal(x[: len(other)], other) for other in others)
    for k in (0, 7, count - 1):
        assert all(np.array_equal(x[k], single) for x, single in zip(whole, at(k), strict=True))


def test_directions_at_once_and_shared_cotangents():
    of = asked("kinetic_energy", "plain")
    fast, d = Alone(of.p.chain), np.random.default_rng(5).normal(size=(3, of.p.chain.joint_count))
    several = called(of, fast, "_jvp", along={"qd": d})["kinetic_energy"]
    momentum = called(of, fast, "_vjp", by=["qd"]).qd  # the cotangent is 1
    assert several == pytest.approx(d @ momentum, rel=1e-13)
    tripled = called(of, fast, "_vjp", by=["qd"], kinetic_energy=[3.0, 0.0]).qd
    np.testing.assert_allclose(tripled, [3.0 * momentum, 0.0 * momentum], rtol=1e-14)


def test_invalid_systems():
    """A batch has NaN where a system is invalid; one system raises an error that names the number."""
    of = asked("potential_energy", "plain")
    fast, q = Alone(of.p.chain), np.tile(of.p.state.q, (3, 1))
    q[1, 0] = np.nan
    found = fast.potential_energy_vjp(q, of.p.state.object_pose, by=["q"])
    assert np.isnan(found.q[1]).all() and np.isfinite(found.q[[0, 2]]).all()
    with pytest.raises(hf.StateError, match=r"^q: expected finite numbers, got nan"):
        fast.potential_energy_vjp(q[1], of.p.state.object_pose, by=["q"])
    with pytest.raises(hf.StateError, match=r"^potential_energy: expected finite numbers, got inf"):
        fast.potential_energy_vjp(q[0], of.p.state.object_pose, by=["q"], potential_energy=np.inf)


def test_names_and_shapes_that_do_not_fit_are_refused():
    of = asked("inverse_dynamics", "plain")
    fast, n = Alone(of.p.chain), of.p.chain.joint_count
    given: Any = inputs_of(of)
    with pytest.raises(hf.StateError, match="inverse_dynamics_vjp: no 'tau'"):
        fast.inverse_dynamics_vjp(*given, by=["tau"], tau=np.ones(n))
    with pytest.raises(hf.StateError, match="inverse_dynamics_jacobian: no 'qdd'"):
        fast.inverse_dynamics_jacobian(*given, of=["qdd"])
    with pytest.raises(hf.StateError, match="inverse_dynamics_jvp: expected some of"):
        fast.inverse_dynamics_jvp(*given, along={})
    with pytest.raises(hf.StateError, match="inverse_dynamics_jvp: along: expected"):
        fast.inverse_dynamics_jvp(*given, along=3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(hf.StateError, match=r"^tau: expected shape"):
        fast.inverse_dynamics_vjp(*given, by=["q"], tau=np.ones(n + 1))
    with pytest.raises(hf.StateError, match="no parameter 'object_mass'"):
        fast.inverse_dynamics_vjp(*given, by=["q"], tau=np.ones(n), object_mass=1.0)
    with pytest.raises(hf.StateError, match="holds nothing, expected zeros"):
        fast.inverse_dynamics_vjp(*given[:3], grasp_wrench=np.ones_like(given[3]), tau=np.ones(n))


@pytest.mark.parametrize(("kind", "why"), [("springs", "springs between bodies"), ("floating", "floating base")])
def test_what_is_not_compiled_says_why(kind, why):
    of = asked("inverse_dynamics", kind)
    with pytest.raises(hf.MethodNotApplicable, match=f"'inverse_dynamics_jvp' of a chain with .*{why}.* runs as ref"):
        Alone(of.p.chain).inverse_dynamics_jvp(*inputs_of(of), along={"q": of.p.state.q})


@pytest.mark.slow
def test_arms_of_one_type_share_their_code(monkeypatch):
    """The loops of derivatives are those of the text, over arms; a Jacobian's rows are one region for all arms."""
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
    fast.inverse_dynamics_vjp(*given, tau=np.ones(n))
    assert made and all(len(keys) == 1 for _, keys in made)
    assert {group.count for group in made[0][0].groups} == {3}
    made.clear()
    fast.inverse_dynamics_jacobian(*given)
    rows = [keys for _, keys in made[-3:]]
    assert rows[0] == rows[1] == rows[2]
