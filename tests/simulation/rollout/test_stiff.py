"""Rollouts of chains that settle faster than explicit steps follow: each system decides for itself, as `simulate`."""

import numpy as np
import pytest

from holdfast import ControlLaw, compile_rollout, simulate
from tests.compiler.programs import same_bits
from tests.simulation.gantries import squeezed
from tests.simulation.rollout.problems import arrays

DAMPING = 1000.0  # N s/m of every slide: 600 1/s
LAW = ControlLaw(lambda t, state, memory, given: (np.array([0.0, 0.0, 30.0 + t, 0.0, 0.0, 30.0 - t]), memory))


@pytest.fixture(scope="module")
def damped():
    """Return a damped gantry, where it is, and its rollout."""
    chain, state = squeezed(("ball", "ball"), damping=DAMPING)
    return chain, state, compile_rollout(chain, LAW, scheme="midpoint")


def test_as_simulate(damped):
    """Steps of 20 ms are implicit, steps of 1 ms are not, side by side."""
    chain, state, rollout = damped
    systems = rollout.start(**{name: np.array([x, x]) for name, x in arrays(state).items()})
    rollout.step(systems, np.array([2e-2, 1e-3]), steps=10)
    assert systems.running.all()
    for row, (step, implicit) in enumerate([(2e-2, True), (1e-3, False)]):
        run = simulate(chain, state, LAW, 10 * step, step, scheme="midpoint")
        assert [one.kind for one in run.occurrences] == ["stiff"] * implicit
        found = systems.state(row)
        assert found.q == pytest.approx(run.q[-1], abs=1e-12)
        assert found.qd == pytest.approx(run.qd[-1], abs=1e-12)


def test_systems_do_not_depend_on_each_other(damped):
    """The bits of a system that takes implicit steps are the same alone, among others, and on two threads."""
    _, state, rollout = damped
    given = {name: np.array([x, x, x]) for name, x in arrays(state).items()}
    given["qd"][1] *= 1.0 + 1e-3
    steps = np.array([2e-2, 2e-2, 1e-3])
    some, threaded = rollout.start(**given), rollout.start(**given)
    rollout.step(some, steps, steps=3)
    rollout.step(threaded, steps, steps=3, threads=2)
    assert all(same_bits(x, threaded.arrays[name]) for name, x in some.arrays.items())
    for row, step in enumerate(steps):
        alone = rollout.start(**{name: x[row] for name, x in given.items()})
        rollout.step(alone, step, steps=3)
        assert same_bits(alone.q[0], some.q[row]) and same_bits(alone.grasp_wrench[0], some.grasp_wrench[row])
