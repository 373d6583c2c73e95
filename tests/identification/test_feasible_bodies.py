"""The best feasible body: the optimality conditions of the cone problem, which need no solver, and ties."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.identification.feasible_bodies import best_feasible, is_feasible, pseudo_inertia
from holdfast.spatial.inertia import about_origin

GUESS = about_origin(2.0, np.zeros(3), np.diag([0.02, 0.03, 0.04])).parameters
UNITS = [pseudo_inertia(unit) for unit in np.eye(10)]


def far_off(rng: np.random.Generator) -> np.ndarray:
    """Return parameters with moments that no body has."""
    x = GUESS + rng.normal(size=10) * [0.1, *[0.05] * 3, *[0.03] * 6]
    x[9] = x[4] + x[7] + rng.uniform(0.005, 0.05)
    return x


@pytest.mark.parametrize("seed", range(8))
def test_the_conditions_of_the_least_residual(seed):
    """A multiplier Z >= 0 balances the slope of the residual, and Z J = 0: no feasible body fits better."""
    rng = np.random.default_rng(seed)
    x, steps = far_off(rng), rng.normal(size=(10, 10)) * 0.02
    assert not is_feasible(x)
    found = best_feasible(x, steps, 10, GUESS, np.zeros(0))
    assert is_feasible(found)
    slope = 2.0 * np.linalg.solve(steps @ steps.T, found - x)
    entries = [(i, j) for i in range(4) for j in range(i, 4)]
    basis = [np.eye(4)[[i]].T @ np.eye(4)[[j]] for i, j in entries]
    basis = [(B + B.T) / 2 for B in basis]
    traces = np.array([[np.trace(B @ unit) for B in basis] for unit in UNITS])
    Z = sum(z * B for z, B in zip(np.linalg.solve(traces, slope), basis, strict=True))
    J = pseudo_inertia(found)
    assert np.linalg.eigvalsh(Z)[0] > -1e-6 * np.linalg.norm(Z)
    assert np.linalg.norm(Z @ J) < 1e-6 * np.linalg.norm(Z) * np.linalg.norm(J)


def test_what_is_not_told_gives_way():
    """A mass that is told stays, however far the guess is, if some inertia that is not told makes it possible."""
    x = about_origin(5.0, np.array([0.3, 0.0, 0.0]), np.diag([0.02, 0.03, 0.04])).parameters
    x[4:] = [0.02, 0, 0, 0.03, 0, 0.04]  # about the origin: the mass centre is too far out for it
    assert not is_feasible(x)
    steps = np.diag([1e-3] * 4 + [0.03] * 6)
    found = best_feasible(x, steps, 4, GUESS, np.zeros(0))
    assert is_feasible(found)
    assert np.abs(found[:4] - x[:4]).max() < 1e-9
    c = np.array([0.3, 0.0, 0.0])  # the nearest: the guess's spread of mass about the new mass centre
    nearest = about_origin(5.0, c, np.diag([0.02, 0.03, 0.04])).parameters
    assert np.abs(found[4:] - nearest[4:]).max() < 1e-6


def test_a_body_without_extent():
    """On the bound itself: points in a plane come back, with other unknowns beside them."""
    x = np.r_[about_origin(1.0, np.array([0.1, 0, 0]), np.diag([0.01, 0.02, 0.03])).parameters, 0.4]
    guess = np.r_[GUESS, 0.0]
    found = best_feasible(x, 1e-6 * np.eye(11), 11, guess, np.ones(1))
    assert is_feasible(found[:10])
    assert np.abs(found - x).max() < 1e-9


@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
def test_a_guess_that_is_far_off(accuracy):
    """The fit of a body that is possible vanishes, from guesses ten times as heavy or light, wide or narrow."""
    rng = np.random.default_rng(7)
    for _ in range(60):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        a, b, c = rng.uniform(0.002, 0.02, 3)
        com, mass = 0.2 * rng.normal(size=3), 10 ** rng.uniform(-0.5, 1.0)
        truth = about_origin(mass, com, turn @ np.diag([b + c, a + c, a + b]) @ turn.T * mass).parameters
        r, m = 10 ** rng.uniform(-1, 1, 3) * 0.01, mass * 10 ** rng.uniform(-1, 1)
        guess = about_origin(m, np.zeros(3), m * np.diag([r[1] + r[2], r[0] + r[2], r[0] + r[1]])).parameters
        told = int(rng.integers(4, 10))
        axes = np.linalg.qr(rng.normal(size=(10, 10)))[0]
        steps = np.r_[mass, [0.1 * mass] * 3, [0.01 * mass] * 6][:, None] * axes
        steps[:, :told] *= accuracy
        x = truth + steps[:, told:] @ rng.normal(size=10 - told)  # what is not told is anything
        found = best_feasible(x, steps, told, guess, np.zeros(0))
        fit = np.linalg.solve(steps, found - x)[:told]
        assert is_feasible(found) and (fit**2).sum() < 1e-6
