"""How derivatives of machine code are called: batches and their bits, parts, statuses, `out`, bound forms, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiled import arrays
from holdfast.dynamics import Status
from holdfast.questions.arrays import STATE_AND_TORQUES
from tests.compiled import problems
from tests.compiled.problems import chain_named, forces, numbers, one
from tests.compiler.programs import same_bits
from tests.derivatives.blocks import (
    NAMES,
    Reference,
    as_direction,
    assert_compiled_is_reference,
    compiled,
    given,
    names_for,
    random_cotangents,
    random_directions,
    shapes,
    size_of,
    state_of,
)
from tests.derivatives.chains import random_chain
from tests.derivatives.functions import problem
from tests.longer import mostly_long
from tests.oracles.chain_derivatives import OUTPUTS
from tests.systems import two_collinear_stretched_6r
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import relative_gap

LAW = 1e-11
BITS = ("two", "interleaved", "rows first", "all kinds", "nobody holds")
FEW = ("q", "qd", "tau", "object_pose")


@pytest.mark.long
@pytest.mark.parametrize("name", BITS)
def test_bits_of_everything(name):
    """A system alone, in a batch of any size and on two threads: the same bits, of all arguments."""
    require_bits(name, NAMES)


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(BITS, ("two",)))
def test_bits(name):
    """The same, of some."""
    require_bits(name, FEW)


def require_bits(name: str, names: tuple[str, ...]) -> None:
    """Compare products by the named arguments, and a matrix, of a batch, parts of it and systems alone."""
    chain, count, random = chain_named(name), 21, np.random.default_rng(1)
    many, fast = numbers(chain, count) | forces(chain, count), problems.compiled(name)
    p = Problem(chain, state_of(one(many, 0)), many["tau"][0], hf.Inputs())
    cotangents = {of: random.normal(size=(count, *shape)) for of, shape in shapes(p).items()}
    directions = {by: as_direction(p, by, random.normal(size=(count, size_of(p, by)))) for by in names}
    of, few = ("qdd", "object_acceleration"), ("q", "tau")

    def pulled(which, **more):
        found = fast.forward_dynamics_vjp(**one(many | cotangents, which), by=names, **more)
        return [np.asarray(getattr(found, name)) for name in names]

    def pushed(which, **more):
        along = {by: x[which] for by, x in directions.items()}
        found = fast.forward_dynamics_jvp(**one(many, which), along=along, **more)
        return [np.asarray(getattr(found, name)) for name in OUTPUTS]

    def matrix(which, **more):
        found = fast.forward_dynamics_jacobian(**one(many, which), of=of, by=few, **more)
        return [np.asarray(found[result, name]) for result in of for name in few]

    for way in (pulled, pushed, matrix):
        whole, tail, threads = way(slice(None)), way(slice(0, 13)), way(slice(None), threads=2)
        for k, x in enumerate(whole):
            assert same_bits(x, threads[k]) and same_bits(x[:13], tail[k])
        for i in (0, 7, 20):
            alone = way(i)
            assert all(same_bits(x[i], y) for x, y in zip(whole, alone, strict=True)), (way.__name__, i)


@pytest.mark.slow
def test_results_past_the_caches():
    """Many large matrices go past the caches: the bits of few, not-a-number for one system alone, rows apart."""
    chain, fast = chain_named("two"), problems.compiled("two")
    few, count = numbers(chain, 7), 1400
    many = {name: np.resize(x, (count, *x.shape[1:])) for name, x in few.items()}
    many["tau"] = many["tau"].copy()
    many["tau"][1393, 2] = np.nan
    asked = {"of": ("qdd",), "by": ("tau",)}
    expected, out = fast.forward_dynamics_jacobian(**few, **asked), None
    for threads in (1, 2):
        found = out = fast.forward_dynamics_jacobian(**many, **asked, threads=threads, out=out)
        for x, y in ((found["qdd", "tau"], expected["qdd", "tau"]), (found.result.qdd, expected.result.qdd)):
            good = np.delete(np.arange(count), 1393)
            assert same_bits(x[good], np.resize(y, x.shape)[good]) and np.isnan(x[1393]).all()
    assert found["qdd", "tau"].strides[0] * count > 2**20 and chain.joint_count**2 >= 64


@pytest.mark.slow
def test_some_of_it():
    """Fewer gradients and directions are the same numbers; names that are none are refused by name."""
    p, random = random_chain(100), np.random.default_rng(0)
    fast, cotangents = compiled(p), random_cotangents(random_chain(100), random)
    whole = fast.forward_dynamics_vjp(**given(p), **cotangents, by=NAMES)
    for by in ("grasp_pose", "link_inertia"):
        few = fast.forward_dynamics_vjp(**given(p), **cotangents, by=(by,))
        assert relative_gap(getattr(few, by), getattr(whole, by)) < LAW
    apart = [
        fast.forward_dynamics_vjp(**given(p), **{of: cotangent}, by=("q",)).q
        for of, cotangent in cotangents.items()
        if cotangent.size
    ]
    assert relative_gap(sum(apart), whole.q) < LAW
    for of in ("rank", "status", "condition", "force"):
        with pytest.raises(hf.HoldfastError, match=of):
            fast.forward_dynamics_jacobian(**given(p), of=("qdd", of), by=("q",))
    with pytest.raises(hf.HoldfastError, match="object_weight"):
        fast.forward_dynamics_vjp(**given(p), **cotangents, by=("q", "object_weight"))
    with pytest.raises(hf.HoldfastError, match="object_weight"):
        fast.forward_dynamics_jvp(**given(p), along={"object_weight": np.ones(3)})


@pytest.mark.slow
def test_singular_and_invalid_systems():
    """Each of them has not-a-number for itself alone; the others have the bits of a clean batch."""
    p = as_chain(two_collinear_stretched_6r(1))
    fast, count, random = hf.compile(p.chain, generic_rank=12), 9, np.random.default_rng(0)
    own = {name: problems.given_by(p)[name] for name in problems.STATE}
    many = {name: np.repeat(x[None], count, axis=0) for name, x in own.items()}
    singular, invalid = np.arange(count) % 3 == 0, np.arange(count) == 4
    many["q"][~singular] += random.uniform(-0.5, 0.5, ((~singular).sum(), 12))
    clean = {name: x.copy() for name, x in many.items()}
    clean["q"][singular] += random.uniform(-0.5, 0.5, (singular.sum(), 12))
    many["tau"][invalid, 0] = np.nan
    by, cotangents = ("q", "tau", "object_pose", "object_mass"), {"qdd": random.normal(size=(count, 12))}
    along = {"q": random.normal(size=(count, 12)), "object_mass": random.normal(size=count)}
    bad = singular | invalid
    statuses = np.where(singular, Status.SINGULAR, np.where(invalid, Status.INVALID, Status.OK))
    for solve, asked, names in (
        (fast.forward_dynamics_vjp, {**cotangents, "by": by}, by),
        (fast.forward_dynamics_jvp, {"along": along}, OUTPUTS),
        (fast.forward_dynamics_jacobian, {"of": ("qdd",), "by": by}, [("qdd", name) for name in by]),
    ):
        found, good = (solve(**x, **asked) for x in (many, clean))
        assert found.result.status.tolist() == statuses.tolist()
        for name in names:
            assert np.isnan(found[name][bad]).all() and same_bits(found[name][~bad], good[name][~bad]), name
    with pytest.raises(hf.errors.SingularChainError):
        fast.forward_dynamics_vjp(**one(many, 0), qdd=cotangents["qdd"][0], by=by)
    with pytest.raises(hf.errors.StateError, match="tau: expected finite numbers"):
        fast.forward_dynamics_vjp(**one(many, 4), qdd=cotangents["qdd"][4], by=by)


def one_arm() -> tuple[Problem, dict[str, np.ndarray]]:
    """Return a small chain's problem and numbers."""
    p = random_chain(100)
    return p, given(p)


@pytest.mark.slow
def test_directions_at_once():
    """Many directions of one system are each alone to the bit; results left out are not there."""
    p, own = one_arm()
    fast, random = compiled(p), np.random.default_rng(0)
    along = {by: as_direction(p, by, random.normal(size=(5, size_of(p, by)))) for by in FEW}
    every = fast.forward_dynamics_jvp(**own, along=along, of=("qdd", "grasp_wrench"))
    for k in range(5):
        alone = fast.forward_dynamics_jvp(
            **own, along={by: x[k] for by, x in along.items()}, of=("qdd", "grasp_wrench")
        )
        for of in ("qdd", "grasp_wrench"):
            assert same_bits(every[of][k], alone[of])
    with pytest.raises(AttributeError, match="base_wrench"):
        _ = every.base_wrench
    whole = fast.forward_dynamics_jvp(**own, along=along)
    expected = Reference(p).forward_dynamics_jvp(along=along)
    for of in OUTPUTS:
        assert relative_gap(whole[of], expected[of]) < LAW
    with pytest.raises(hf.errors.StateError):
        fast.forward_dynamics_jvp(**own, along={"q": np.ones((2, 3)), "tau": np.ones((4, 3))})


@pytest.mark.slow
def test_out():
    """Earlier derivatives are written over, in the same memory; those of other names are refused."""
    p, own = one_arm()
    fast, random = compiled(p), np.random.default_rng(0)
    cotangents = [{"qdd": random.normal(size=p.chain.joint_count)} for _ in range(2)]
    first, second = (fast.forward_dynamics_vjp(**own, **cotangent, by=FEW) for cotangent in cotangents)
    memory = first.q
    again = fast.forward_dynamics_vjp(**own, **cotangents[1], by=FEW, out=first)
    assert again is first or again.q.base is memory.base or np.shares_memory(again.q, memory)
    for name in FEW:
        assert same_bits(again[name], second[name])
    with pytest.raises(hf.errors.StateError, match="out"):
        fast.forward_dynamics_vjp(**own, **cotangents[1], by=("q",), out=first)


@pytest.mark.slow
def test_out_by_the_builtin(monkeypatch):
    """From the second call with the same `out` on, the Python code is left out, for the bits of a new result."""
    p, _ = one_arm()
    chain, fast, random = p.chain, hf.compile(p.chain), np.random.default_rng(3)
    many = {x: numbers(chain, 3)[x] for x in problems.STATE}
    cotangents = {
        "qdd": random.normal(size=chain.joint_count),
        "grasp_wrench": random.normal(size=(len(chain.arms), 6)),
    }
    along = {"q": random.normal(size=chain.joint_count)}
    ways = [
        (fast.forward_dynamics_jacobian, {"of": ["qdd"], "by": ("tau",)}),
        (fast.forward_dynamics_vjp, cotangents | {"by": ("tau",)}),
        (fast.forward_dynamics_jvp, {"along": along}),
    ]
    for solve, asked in ways:
        expected = [solve(**one(many, i), **asked) for i in range(3)]
        out = solve(**one(many, 0), **asked)
        assert solve(**one(many, 1), **asked, out=out) is out
        with monkeypatch.context() as without:
            without.setattr(arrays, "floats", None)
            for i, found in enumerate(expected):
                assert solve(*one(many, i).values(), **asked, out=out) is out
                assert same_bits(out.result.memory, found.result.memory)
    state = one(many, 0)
    cotangents["by"] = ("tau",)
    out = fast.forward_dynamics_vjp(**state, **cotangents)
    fast.forward_dynamics_vjp(**state, **cotangents, out=out)
    turned = {"grasp_wrench": cotangents["grasp_wrench"].reshape(6, -1)}  # as many numbers
    for wrong, message in (
        (turned, "grasp_wrench: expected shape"),
        ({"tau": state["tau"][:-1]}, "tau: expected shape"),
        ({"threads": True}, "threads"),
        ({"tau": out.tau}, "memory of its own"),
    ):
        with pytest.raises(hf.errors.StateError, match=message):
            fast.forward_dynamics_vjp(**state | cotangents | wrong, out=out)
    message = r"forward_dynamics\.jacobian: expected some of"  # a text is no list of one name
    with pytest.raises(hf.errors.StateError, match=message):
        fast.forward_dynamics_jacobian(**state, of=["qdd"], by="tau")


@pytest.mark.slow
def test_bound_forms():
    """What is bound to its arrays is the call, to the bit; numbers written into them count at the next call."""
    p, own = one_arm()
    fast, random = compiled(p), np.random.default_rng(0)
    of = ("qdd", "grasp_wrench")
    vjp, jvp, matrix = (
        fast.forward_dynamics.bind(kind, of=of, by=FEW, **{name: np.array(x) for name, x in own.items()})
        for kind in ("vjp", "jvp", "jacobian")
    )
    for _ in range(2):
        own["tau"] = random.normal(size=p.chain.joint_count)
        cotangents = {name: random.normal(size=shapes(p)[name]) for name in of}
        along = random_directions(p, random, FEW)
        for bound, numbers_given in ((vjp, cotangents), (jvp, along), (matrix, {})):
            bound.arrays["tau"][...] = own["tau"]
            for name, x in numbers_given.items():
                bound.given[name][...] = x
            assert bound() is Status.OK
        pulled, pushed = (
            fast.forward_dynamics_vjp(**own, **cotangents, by=FEW),
            fast.forward_dynamics_jvp(**own, along=along, of=of),
        )
        jacobian = fast.forward_dynamics_jacobian(**own, of=of, by=FEW)
        assert all(same_bits(vjp.found[name], pulled[name]) for name in FEW)
        assert all(same_bits(jvp.found[name], pushed[name]) for name in of)
        assert all(same_bits(matrix.found[o, b], jacobian[o, b]) for o in of for b in FEW)
        assert same_bits(vjp.found.result.qdd, pulled.result.qdd)


def test_names_of_trunks():
    """Arguments and results that are a trunk's are named as unknown where there is none, or another."""
    plain, fixed = random_chain(0), random_chain(0, "fixed")
    for p, name in ((plain, "trunk_link_wrench"), (fixed, "floating_pose")):
        with pytest.raises(hf.errors.StateError, match=f"no '{name}'"):
            hf.forward_dynamics_vjp(p.chain, p.state, p.tau, qdd=p.tau, by=[name])
    with pytest.raises(hf.errors.StateError, match="no 'floating_acceleration'"):
        hf.forward_dynamics_vjp(fixed.chain, fixed.state, fixed.tau, floating_acceleration=np.ones(6))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "springs", "bushing", "trunk", "floating"])
def test_every_argument_of_every_kind_of_chain(kind):
    """Gradients by everything: a batch, on threads too, has the bits of one call, and only a bad system has none."""
    p = problem(kind)
    fast, by = compiled(p), names_for(p)
    one = {name: np.asarray(x) for name, x in given(p).items()} | {"qdd": np.ones(p.chain.joint_count)}
    many = {name: np.repeat(x[None], 5, 0) for name, x in one.items()}
    many["q"][2, 0] = np.nan
    alone = fast.forward_dynamics_vjp(**one, by=by)
    for threads in (1, 2):
        found = fast.forward_dynamics_vjp(**many, by=by, threads=threads)
        assert [status is Status.OK for status in found.result.status] == [True, True, False, True, True]
        for name in by:
            assert np.isnan(found[name][2]).all()
            assert all(same_bits(found[name][k], alone[name]) for k in (0, 1, 3, 4)), name


@pytest.mark.slow
def test_a_floating_base_is_an_input():
    """Its pose and twist are asked for by name; a bound call has them among its arrays; bits are a batch's."""
    p = random_chain(200, "floating")
    fast, own, by = hf.compile(p.chain), given(p), ("q", "floating_pose", "floating_twist")
    acting = {name: np.array(own[name]) for name in ("base_twist", "base_acceleration", "object_wrench")}
    own = {name: own[name] for name in (*STATE_AND_TORQUES, "floating_pose", "floating_twist")}
    cotangent = np.linspace(-1.0, 1.0, 6)
    lacking = {name: x for name, x in own.items() if name != "floating_twist"}
    with pytest.raises(hf.errors.StateError, match="floating_twist: expected that of the trunk's floating base"):
        fast.forward_dynamics_vjp(**lacking, floating_acceleration=cotangent, by=by)
    found = fast.forward_dynamics_vjp(**own, **acting, floating_acceleration=cotangent, by=by)
    many = fast.forward_dynamics_vjp(
        **{name: np.stack([x] * 3) for name, x in own.items()},
        **acting,
        floating_acceleration=np.stack([cotangent] * 3),
        by=by,
    )
    bound = fast.forward_dynamics.bind("vjp", of=("floating_acceleration",), by=by, **acting)
    for name, x in own.items():
        bound.arrays[name][...] = x
    bound.given["floating_acceleration"][...] = cotangent
    assert bound() is Status.OK
    for name in by:
        assert same_bits(bound.found[name], found[name])
        assert same_bits(many[name][2], found[name])


@pytest.mark.slow
@pytest.mark.parametrize("kind", mostly_long(["springs", "bushing", "trunk", "floating"], ("springs",)))
def test_machine_code_of_force_elements(kind):
    """Springs on every kind of body, and bushings: products and the matrix are the reference's, by all arguments."""
    p = problem(kind)
    assert_compiled_is_reference(p, names_for(p), ("q", "object_pose", "tau"), 2, floor=1.0)


@pytest.mark.slow
def test_bits_of_springs_between_bodies():
    """One system, a batch, its tail and threads; without wrenches on links as an input."""
    p, random = problem("springs"), np.random.default_rng(3)
    fast, own = hf.compile(p.chain), {name: given(p)[name] for name in STATE_AND_TORQUES}
    q, cotangent = own.pop("q") + 0.1 * random.normal(size=(11, len(p.state.q))), np.ones(p.chain.joint_count)

    def at(which, threads=1):
        found = fast.forward_dynamics_vjp(q[which], **own, qdd=cotangent, by=("q", "object_pose"), threads=threads)
        return found.q, found.object_pose

    whole = at(slice(None))
    for x, tail, threaded, single in zip(whole, at(slice(0, 5)), at(slice(None), 2), at(7), strict=True):
        assert same_bits(x, threaded) and same_bits(x[:5], tail) and same_bits(x[7], single)
