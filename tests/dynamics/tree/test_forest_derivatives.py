"""Derivatives of the forward dynamics of forests: dual numbers, differences along motions, and laws."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.random_forest_derivatives import allowed, costs, outcome

from holdfast.dynamics import (
    Status,
    forest_close,
    forest_dynamics,
    forest_dynamics_jacobian,
    forest_dynamics_jvp,
    forest_dynamics_vjp,
)
from holdfast.dynamics.tree.varied_forest import displaced
from holdfast.errors import StateError
from tests.dynamics.tree.problems import gap
from tests.longer import mostly_long, mostly_slow
from tests.systems.random_forests import random_forest


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long(range(100), {3}))
def test_against_dual_numbers(seed):
    """All derivatives by all arguments, against dual numbers over equations without elimination; transposes agree."""
    found = outcome(random_forest(seed))
    assert found.unique is None or (found.error <= 1e-9 and found.adjoint <= 1e-12), found


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "times"), mostly_slow([(3, 2.0), (5, 2.0), (9, 2.2)], [(3, 2.0)]))
def test_cost_of_a_gradient(seed, times):
    """With a gradient by q, qd and tau, forward dynamics takes twice its operations; a tree with one closure, 2.2."""
    forward, gradient = costs(random_forest(seed))
    assert gradient <= times * forward


@pytest.mark.parametrize("seed", mostly_slow([2, 4, 9], [9]))
def test_smallest_forces_along_a_motion(seed):
    """Where forces are not unique, their rates are those of the smallest, by differences along closed states."""
    p = random_forest(seed)
    assert forest_dynamics(*p[1:]).status is Status.INDETERMINATE_FORCES
    tau_rate, qdd = np.random.default_rng(0).normal(size=len(p.tau)), forest_dynamics(*p[1:]).qdd

    def at(h: float):
        state = forest_close(p.forest, displaced(p.forest, p.q, h * p.qd), p.qd + h * qdd)
        return forest_dynamics(p.forest, state.q, state.qd, p.tau + h * tau_rate, p.wrenches)

    h = 2e-5
    rates = forest_dynamics_jvp(*p[1:], along={"q": p.qd, "qd": qdd, "tau": tau_rate}, check=False)
    for name in ("closure_wrench", "coupling_force", "qdd"):
        wanted = (
            8 * (getattr(at(h), name) - getattr(at(-h), name)) - (getattr(at(2 * h), name) - getattr(at(-2 * h), name))
        ) / (12 * h)
        assert gap(rates[name], wanted) < 2e-6, name


@pytest.mark.slow
def test_products_and_matrix():
    """Several directions at once, a gradient and a rate are the Jacobian times a vector, from either side."""
    p, random = random_forest(3), np.random.default_rng(0)
    J = forest_dynamics_jacobian(*p[1:], of=("acceleration",), by=("q", "link_com"))
    directions = {"q": random.normal(size=(2, len(p.qd))), "link_com": random.normal(size=(2, len(p.forest.bodies), 3))}
    rates = forest_dynamics_jvp(*p[1:], along=directions).acceleration
    for k in range(2):
        wanted = J["acceleration", "q"] @ directions["q"][k]
        wanted = wanted + np.einsum("abkc,kc->ab", J["acceleration", "link_com"], directions["link_com"][k])
        assert gap(rates[k], wanted) < 1e-12
    bar = random.normal(size=rates[0].shape)
    found = forest_dynamics_vjp(*p[1:], by=("q",), acceleration=bar)
    assert gap(found.q, np.einsum("ab,abj->j", bar, J["acceleration", "q"])) < 1e-12
    assert found.result.rank == J.result.rank


def test_symmetric_by_torques():
    """d qdd / d tau is symmetric and has the mobility as its rank."""
    p = random_forest(5)
    found = forest_dynamics_jacobian(*p[1:], of=("qdd",), by=("tau",))
    X = found["qdd", "tau"]
    assert gap(X, X.T) < 1e-12
    assert np.linalg.matrix_rank(X, 1e-9) == found.result.mobility


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda p: forest_dynamics_vjp(*p, by=("mass",), qdd=np.zeros(len(p[2]))), "no 'mass'"),
        (lambda p: forest_dynamics_vjp(*p, qddd=np.zeros(3)), "no 'qddd'"),
        (lambda p: forest_dynamics_vjp(*p, qdd=np.zeros(3)), "qdd: expected shape"),
        (lambda p: forest_dynamics_jvp(*p, along={"q": np.zeros(3)}), "q: expected shape"),
        (lambda p: forest_dynamics_jacobian(*p, of=("forces",)), "no 'forces'"),
    ],
)
def test_refusals(ask, message):
    """Names and shapes that do not fit are refused, with what is known."""
    with pytest.raises(StateError, match=message):
        ask(random_forest(3)[1:])


def test_rates_that_closures_allow():
    """The oracle's directions satisfy closures and couplings."""
    p = random_forest(1)
    rates = allowed(p, np.random.default_rng(0).normal(size=len(p.qd)))
    assert gap(forest_close(p.forest, p.q, rates).qd, rates) < 1e-12
