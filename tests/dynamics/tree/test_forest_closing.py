"""Closing of forests, and impulses: gaps vanish, changes are the smallest, and plastic impulses take energy."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import Status, forest_balance, forest_close, forest_dynamics, forest_impulse
from holdfast.dynamics.tree.forest_gaps import position_gaps, velocity_gaps
from holdfast.dynamics.tree.varied_forest import ForestArguments, displaced
from holdfast.errors import ClosureError, StateError
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody, JointCoupling
from tests.dynamics.tree.problems import LINK, gap, parallelogram, slider_crank, with_offsets
from tests.longer import mostly_slow
from tests.systems.random_forests import random_forest


def gaps(p, q, qd) -> tuple[float, float]:
    """Return the largest gaps in position and velocity."""
    motion = ForestArguments(p.forest, q, qd, 0.0 * qd, 0.0 * p.wrenches).motion({})
    return position_gaps(motion, q).largest, velocity_gaps(motion, qd).largest


@pytest.mark.parametrize("seed", mostly_slow(range(60), range(10)))
def test_closed_again(seed):
    """Random forests that were pulled apart by some centimetres are closed, over-constrained ones among them."""
    p, random = with_offsets(random_forest(seed)), np.random.default_rng(seed)
    n = p.forest.velocity_count
    found = forest_close(p.forest, displaced(p.forest, p.q, 0.01 * random.uniform(-1, 1, n)), random.normal(size=n))
    position, velocity = gaps(p, found.q, found.qd)
    assert position < 1e-10
    if seed != 21:  # in a singular posture, rates that nearly satisfy the closures are far from those that do
        assert velocity < 1e-8 * max(1.0, np.abs(found.qd).max())


def test_closed_stays():
    """A closed state is returned to the last bits."""
    p = random_forest(4)
    found = forest_close(p.forest, p.q, p.qd)
    assert gap(found.q, p.q) < 1e-12 and gap(found.qd, p.qd) < 1e-11


@pytest.mark.parametrize("seed", range(10))
def test_impulse_is_the_smallest_change(seed):
    """Of all rates that satisfy the closures the impulse leaves those that are nearest in kinetic energy.

    Hence the change of rates has no kinetic product with them, and the energy lost is that of the change (Carnot).
    """
    p, random = random_forest(seed), np.random.default_rng(seed)
    before = random.normal(size=p.forest.velocity_count)
    found = forest_impulse(p.forest, p.q, before)

    def energy(qd):
        return forest_balance(p.forest, p.q, qd).kinetic_energy

    lost = energy(before) - energy(found.qd)
    assert found.energy_change == pytest.approx(-lost)
    assert lost == pytest.approx(energy(before - found.qd), rel=1e-8) and lost > 0
    assert gaps(p, p.q, found.qd)[1] < 1e-9 * max(1.0, np.abs(found.qd).max())
    assert (found.status is Status.OK) == (forest_dynamics(*p[1:]).status is Status.OK)


def test_a_swinging_bar_is_caught():
    """A bar that turns about one end and hits a peg at a distance d gets the impulse I w / d."""
    pin = Closure(None, 0, hf.Grasp("ball", hf.Pose(np.eye(3), [0.5, 0, 0])), hf.Pose(np.eye(3), [0.5, 0, 0]))
    found = forest_impulse(Forest([ForestBody(LINK, BodyJoint())], [pin]), [0.0], [2.0])
    assert found.qd == pytest.approx([0.0], abs=1e-15)
    assert found.closure_impulse[0, 4] == pytest.approx(-0.11 * 2.0 / 0.5)
    assert found.energy_change == pytest.approx(-0.5 * 0.11 * 4.0)
    assert found.status is Status.INDETERMINATE_FORCES  # a peg's other directions are the bearing's, too


def test_offset_of_a_coupling():
    """A mimic joint with an offset is brought to where it belongs; one without keeps its sum."""
    bodies = [ForestBody(LINK, BodyJoint()), ForestBody(LINK, BodyJoint())]
    geared = [JointCoupling([(0, 0, 1.0), (1, 0, -2.0)], offset) for offset in (0.3, None)]
    first, second = (forest_close(Forest(bodies, (), [one]), [0.5, 0.4], [1.0, 0.0]) for one in geared)
    assert first.q[0] - 2.0 * first.q[1] == pytest.approx(0.3)
    assert second.q == pytest.approx([0.5, 0.4])
    assert first.qd[0] - 2.0 * first.qd[1] == pytest.approx(0.0, abs=1e-14)
    with pytest.raises(StateError, match=r"coupling 0: position gap -0\.6"):
        forest_dynamics(Forest(bodies, (), geared[:1]), [0.5, 0.4], [0.0, 0.0], [0.0, 0.0])


def test_too_far():
    """A pin that no posture reaches is refused with the gap that is left."""
    forest = slider_crank()
    far = Forest(forest.bodies, [Closure(None, 1, forest.closures[0].grasp, hf.Pose(np.eye(3), [3.0, 0.0, 0.0]))])
    with pytest.raises(ClosureError, match=r"cannot close the forest: gaps .* of 1 at closure 0"):
        forest_close(far, [0.3, -0.4])


def test_impulse_of_an_open_forest():
    """Impulses are of closures that are closed; another state is refused."""
    with pytest.raises(StateError, match="closure 0: position gap"):
        forest_impulse(parallelogram(), [0.4, 0.3, -0.4], np.zeros(3))
