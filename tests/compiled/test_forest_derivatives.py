"""Derivatives of forests and of chains with branches as machine code: the reference, dual numbers, laws, refusals."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from benchmarks.random_forest_derivatives import compiled_outcome

import holdfast as hf
from holdfast.compiled.forest import CompiledForest
from holdfast.dynamics import Status, forest_dynamics_jacobian, forest_dynamics_vjp
from holdfast.dynamics.tree.mechanism_terms import chain_arguments
from holdfast.errors import SingularChainError, StateError
from tests.compiled.test_mechanism import arguments
from tests.dynamics.tree.problems import gap, slider_crank
from tests.longer import mostly_long, mostly_slow
from tests.systems.branched import branched_problems
from tests.systems.humanoid import humanoid
from tests.systems.random_forests import random_forest

FORCES = ("grasp_wrench", "coupling_force")


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long(range(10), {3}))
def test_against_dual_numbers(seed):
    """Gradients and rates of all results, against dual numbers over equations without elimination."""
    found = compiled_outcome(random_forest(seed), timed=False)
    assert found.unique is None or found.error <= 1e-9, found


@pytest.mark.parametrize(("seed", "times"), mostly_slow([(10, 1.75), (3, 1.9), (9, 2.2), (4, 1.5)], [(10, 1.75)]))
def test_cost_of_a_gradient(seed, times):
    """With a gradient by q, qd and tau, forward dynamics takes less than twice its operations; a tree little more."""
    assert ratio(random_forest(seed).forest) <= times


@pytest.mark.slow
def test_cost_of_a_humanoid():
    """With limbs, whose part in the virtual power is in the axes of their links."""
    assert ratio(humanoid().forest) <= 1.75


def ratio(forest) -> float:
    """Return the operations of a gradient over those of forward dynamics."""
    forward = CompiledForest(forest).forward_dynamics
    gradient = forward.derived("vjp", ("qdd", "closure_wrench"), ("q", "qd", "tau"))
    return gradient.schedule().operation_count / forward.function.schedule().operation_count


@pytest.mark.parametrize(
    "name", ["palletiser", *mostly_slow(["grippers"], ()), *mostly_long(["pot and lid", "on a shoulder"], ())]
)
def test_chains(name):
    """Gradients, rates and Jacobians of the reference, by everything; where forces are a choice, at fixed frames."""
    p, rng = branched_problems()[name], np.random.default_rng(3)
    forward: Any = hf.compile(p.chain).forward_dynamics
    given = arguments(p) | {"tau": p.tau}
    unique = forward(**given).status is Status.OK
    results = [x for x in forward.function.terms.outputs if unique or x not in FORCES]
    fixed = [x for x in chain_arguments(p.chain) if x not in ("q", "qd") and not x.endswith(("pose", "twist"))]
    by = [*chain_arguments(p.chain)] if unique else fixed
    bars = {x: rng.normal(size=forward.function.terms.outputs[x]) for x in results}
    found = forward.vjp(**given, by=by, **bars)
    wanted = hf.forward_dynamics.vjp(p.chain, p.state, p.tau, by=by, **bars)
    assert all(gap(found[x], wanted[x]) <= 1e-10 for x in by)
    along = {x: rng.normal(size=wanted[x].shape) for x in by}
    rates = forward.jvp(**given, along=along, of=results)
    wanted = hf.forward_dynamics.jvp(p.chain, p.state, p.tau, along=along)
    assert all(gap(rates[x], wanted[x]) <= 1e-10 for x in results)
    J = forward.jacobian(**given, of=["qdd"], by=["tau", "object_wrench"])
    wanted = hf.forward_dynamics.jacobian(p.chain, p.state, p.tau, of=["qdd"], by=["tau", "object_wrench"])
    assert all(gap(J["qdd", x], wanted["qdd", x]) <= 1e-10 for x in ("tau", "object_wrench"))
    assert gap(J.result.qdd, found.result.qdd) == 0.0


@pytest.fixture(scope="module")
def problem():
    """A small forest with unique forces."""
    return random_forest(10)


@pytest.fixture(scope="module")
def forward(problem):
    return hf.compile(problem.forest).forward_dynamics


@pytest.mark.slow
def test_same_bits(problem, forward):
    """Single, batch, threads, bound, overwritten, pickled: the same bits; a Jacobian is its rates along units."""
    p, rng = problem, np.random.default_rng(4)
    bar, qd = rng.normal(size=len(p.qd)), np.array([p.qd, 0.9 * p.qd, 1.1 * p.qd])
    single = forward.vjp(p.q, p.qd, p.tau, qdd=bar)
    batch, threads = (forward.vjp(p.q, qd, p.tau, qdd=bar, threads=n) for n in (1, 2))
    again = pickle.loads(pickle.dumps(hf.compile(p.forest))).forward_dynamics_vjp(p.q, qd, p.tau, qdd=bar)
    bound = forward.bind("vjp", of=["qdd"], q=p.q.copy(), qd=p.qd.copy(), tau=p.tau.copy())
    bound.given["qdd"][...] = bar
    assert bound() is Status.OK
    before = single.q.copy()
    assert forward.vjp(p.q, qd[1], p.tau, qdd=bar, out=single) is single
    for name in ("q", "qd", "tau"):
        assert (batch[name] == threads[name]).all() and (batch[name] == again[name]).all()
        assert (batch[name][1] == single[name]).all() and (bound.found[name] == batch[name][0]).all()
    assert (batch.q[0] == before).all() and gap(single.result.qdd, batch.result.qdd[1]) == 0.0
    J, rates = (
        forward.jacobian(p.q, qd, p.tau, of=["qdd"], by=["q"]),
        forward.jvp(p.q, qd[1], p.tau, along={"q": bar}, of=["qdd"]),
    )
    assert gap(J["qdd", "q"][1] @ bar, rates.qdd) <= 1e-12
    assert gap(bar @ J["qdd", "q"][1], single.q) <= 1e-12
    several = forward.jvp(p.q, qd[1], p.tau, along={"q": np.array([bar, 2.0 * bar])}, of=["qdd"])
    assert gap(several.qdd[1], 2.0 * rates.qdd) <= 1e-13


@pytest.mark.slow
def test_symmetric_by_torques(problem, forward):
    """d qdd / d tau is symmetric, and its rank is the mobility."""
    J = forward.jacobian(problem.q, problem.qd, problem.tau, of=["qdd"], by=["tau"])
    X = J["qdd", "tau"]
    assert gap(X, X.T) <= 1e-12
    assert np.linalg.matrix_rank(X, 1e-9) == J.result.mobility


@pytest.mark.slow
def test_frames_within_limbs():
    """By placements of joints and frames of closures, which are within limbs, as the reference."""
    p = random_forest(10)
    forward, bars = hf.compile(p.forest).forward_dynamics, np.ones((len(p.forest.closures), 6))
    by = ["joint_pose", "tip_pose", "grasp_pose"]
    found = forward.vjp(p.q, p.qd, p.tau, by=by, closure_wrench=bars)
    wanted = forest_dynamics_vjp(p.forest, p.q, p.qd, p.tau, by=by, check=False, closure_wrench=bars)
    assert all(gap(found[x], wanted[x]) <= 1e-10 for x in by)


def test_refusals(problem, forward):
    """Unknown names, no cotangents and wrong shapes are refused by name."""
    p = problem
    with pytest.raises(StateError, match="expected some of qdd, closure_wrench, coupling_force"):
        forward.vjp(p.q, p.qd, p.tau)
    with pytest.raises(StateError, match="no 'masses'"):
        forward.vjp(p.q, p.qd, p.tau, qdd=p.qd, by=["masses"])
    with pytest.raises(StateError, match="qdd: expected shape"):
        forward.vjp(p.q, p.qd, p.tau, qdd=p.qd[1:])
    with pytest.raises(StateError, match="along: expected"):
        forward.jvp(p.q, p.qd, p.tau)
    with pytest.raises(StateError, match="no 'acceleration'"):
        forward.jacobian(p.q, p.qd, p.tau, of=["acceleration"])
    with pytest.raises(StateError, match="expected vjp or jvp, got 'jacobian'"):
        forward.bind("jacobian")
    with pytest.raises(StateError, match="out: expected earlier derivatives"):
        forward.vjp(p.q, p.qd, p.tau, qdd=p.qd, out=forward(p.q, p.qd, p.tau))


@pytest.mark.parametrize("name", mostly_slow(branched_problems(), ("palletiser",)))
def test_along_the_motion(name):
    """Along a motion, which keeps closures, accelerations change as in a run, also where forces are not unique."""
    p = branched_problems()[name]
    h = 5e-4
    run = hf.simulate(p.chain, p.state, lambda t, state, memory: (p.tau, memory), 2 * h, h)
    state = run.state(1)
    forward: Any = hf.compile(p.chain).forward_dynamics
    along = {"q": run.qd[1], "qd": run.qdd[1]}
    if p.chain.free_objects:
        along |= {"object_pose": run.object_twist[1], "object_twist": run.object_acceleration[1]}
    if p.chain.floats:
        along |= {"floating_pose": run.base_twist[1], "floating_twist": run.base_acceleration[1]}
    given = arguments(p._replace(state=state)) | {"tau": p.tau}
    found = forward.jvp(**given, along=along, of=["qdd"])
    wanted = hf.forward_dynamics.jvp(p.chain, state, p.tau, along=along)
    size = max(1.0, float(np.abs(wanted.qdd).max()))
    assert gap(found.qdd, wanted.qdd) <= 1e-9 * size
    assert gap(found.qdd, (run.qdd[2] - run.qdd[0]) / (2 * h)) <= 1e-4 * size


def test_singular_and_not_unique():
    """Where there is no answer, an error or NaN; derivatives of forces that are a choice likewise, not of others."""
    forest = slider_crank()
    forward, none = hf.compile(forest).forward_dynamics, np.zeros(forest.velocity_count)
    q, moving, bar = np.zeros(forest.position_count), np.array([1.0, *none[1:]]), np.ones(forest.velocity_count)
    with pytest.raises(SingularChainError):
        forward.vjp(q, moving, none, qdd=bar)
    found = forward.vjp(q, np.array([none, moving]), none, qdd=bar, by=["tau"])
    assert [*found.result.status] == [Status.INDETERMINATE_FORCES, Status.SINGULAR]
    assert np.isfinite(found.tau[0]).all() and np.isnan(found.tau[1]).all()
    J = forest_dynamics_jacobian(forest, q, none, none, of=["qdd"], by=["tau"], check=False)
    assert gap(found.tau[0], bar @ J["qdd", "tau"]) <= 1e-12
    wrenches = np.ones((len(forest.closures), 6))
    for ask in (
        lambda **x: forward.vjp(q, none, none, closure_wrench=wrenches, **x),
        lambda **x: forward.jvp(q, none, none, along={"tau": bar}),
        lambda **x: forward.jacobian(q, none, none),
    ):
        with pytest.raises(StateError, match=r"closure_wrench: the forces are not unique here.*those of qdd"):
            ask()
    rates = forward.jvp(q, np.array([none, none]), none, along={"tau": bar})
    assert np.isnan(rates.closure_wrench).all() and np.isfinite(rates.qdd).all()
