"""Simulated and linearised forests: conserved energy, the order of the scheme, and differences of motions."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.dynamics import forest_balance, forest_close, forest_dynamics, forest_linearise, forest_simulate
from holdfast.dynamics.tree.varied_forest import displaced, displacement
from holdfast.errors import StateError
from tests.dynamics.tree.problems import gap, parallelogram, undamped
from tests.longer import mostly_slow
from tests.systems.random_forests import random_forest


@pytest.mark.parametrize("seed", mostly_slow([3, 4, 9], [3]))
def test_energy_to_the_order_of_the_scheme(seed):
    """Without dampers and torques the energy is constant; half the step, a sixteenth of the error."""
    p = undamped(seed)

    def energy(q, qd) -> float:
        found = forest_balance(p.forest, q, qd)
        return found.kinetic_energy + found.potential_energy

    errors = []
    for step in (2e-3, 1e-3):
        run = forest_simulate(p.forest, p.q, p.qd, duration=0.01, step=step)
        errors.append(abs(energy(run.q[-1], run.qd[-1]) - energy(p.q, p.qd)))
    assert errors[1] < 1e-7 * max(1.0, abs(energy(p.q, p.qd)))
    assert errors[1] < errors[0] / 10 or errors[0] < 1e-11


def test_torques_and_times():
    """A torque that holds the forest leaves it at rest; equal steps end at the given time."""
    forest, q = parallelogram(), np.array([0.4, 0.4, -0.4])
    run = forest_simulate(forest, q, np.zeros(3), lambda t, q, qd: [0.0, 0.0, 0.0], duration=0.1, step=0.03)
    assert run.t == pytest.approx([0.0, 0.025, 0.05, 0.075, 0.1])
    np.testing.assert_allclose(run.q, np.tile(q, (5, 1)), atol=1e-14)  # gravity is along the axes
    with pytest.raises(StateError, match="torque: expected shape"):
        forest_simulate(forest, q, np.zeros(3), lambda t, q, qd: [0.0], duration=0.1, step=0.03)
    with pytest.raises(StateError, match="step: expected at most 100000 steps"):
        forest_simulate(forest, q, np.zeros(3), duration=1e30, step=0.03)
    with pytest.raises(StateError, match="closure 0"):
        forest_simulate(forest, [0.4, 0.0, 0.0], np.zeros(3), duration=0.1, step=0.03)


@pytest.mark.parametrize("seed", mostly_slow([3, 5, 9], [3]))
def test_linearisation_is_the_change_of_motions(seed):
    """Along every independent coordinate, against differences of accelerations of states that are closed."""
    p = random_forest(seed)
    n, found = len(p.qd), forest_linearise(*p[1:])
    assert found.A.shape == (found.basis.shape[1],) * 2
    inverse, h = np.linalg.pinv(found.basis), 1e-5
    here = forest_dynamics(*p[1:])
    assert gap(found.basis @ found.rate, [*p.qd, *here.qdd]) < 1e-10  # a motion stays in the space of motions

    def rates(z, h) -> np.ndarray:
        x = h * found.basis @ z
        state = forest_close(p.forest, displaced(p.forest, p.q, x[:n]), p.qd + x[n:])
        return np.concatenate([state.qd, forest_dynamics(p.forest, state.q, state.qd, p.tau, p.wrenches).qdd])

    for k in range(0, found.A.shape[1], 5):
        unit = np.eye(found.A.shape[1])[k]
        wanted = (rates(unit, h) - rates(unit, -h)) / (2 * h)
        for body, at in zip(p.forest.bodies, p.forest.velocities, strict=True):
            if body.joint.of_kind.pose:  # a small turn is carried along by the angular velocity
                turn = slice(at.start, at.start + 3)
                wanted[turn] += np.cross(p.qd[turn], found.basis[turn, k])
        assert gap(found.A[:, k], inverse @ wanted) < 1e-6, k


def test_displacement():
    """The step from one posture to another takes it there."""
    p, random = random_forest(3), np.random.default_rng(0)
    step = 0.5 * random.normal(size=len(p.qd))
    there = displaced(p.forest, p.q, step)
    assert gap(displacement(p.forest, p.q, there), step) < 1e-12
