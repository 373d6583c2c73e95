"""Diagnosis of forests: ranks part by part, and postures that are singular beside their neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.dynamics import forest_close, forest_diagnose, forest_dynamics, forest_dynamics_vjp
from holdfast.errors import SingularChainError, StateError
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody
from holdfast.model.grasp import Grasp
from holdfast.model.link import Link
from tests.dynamics.tree.problems import parallelogram, slider_crank
from tests.systems.random_forests import random_forest


@pytest.mark.parametrize("seed", [0, 3, 5, 6, 7, 9, 11, 13])
def test_rank(seed):
    """The ranks of the parts add up to that of forward dynamics."""
    p = random_forest(seed)
    found, wanted = forest_diagnose(p.forest, p.q), forest_dynamics(*p[1:])
    assert (found.rank, found.mobility) == (wanted.rank, wanted.mobility)
    assert found.rows == p.forest.constraint_row_count
    assert found.status == ("regular" if found.rank == found.rows else "indeterminate")


@pytest.mark.long
def test_bodies_without_names():
    """They are listed by their indices."""
    p = random_forest(4)
    found = forest_diagnose(p.forest, p.q).report()
    assert "closures 0 .. 3 and couplings 0, 1 (bodies 0 .. 11 on the ground): 5 forces of closures" in found


def test_parallelogram():
    """A planar loop carries no load across its plane; flat, it has one motion more than nearby, by its links' names."""
    forest = parallelogram()
    found = forest_diagnose(forest, [0.4, 0.4, -0.4])
    assert (found.status, found.rank, found.generic_rank, found.mobility) == ("indeterminate", 2, 2, 1)
    flat = forest_diagnose(forest, np.zeros(3))
    assert (flat.status, flat.rank, flat.generic_rank, flat.mobility) == ("singular", 1, 2, 2)
    assert flat.condition == np.inf
    assert "closure 0 (crank, rocker, coupler on the ground): 1 motion more than nearby" in str(flat)


def test_stretched_bars():
    """Two bars stretched between two pins: the rate that their rows allow begins no motion."""
    found = forest_diagnose(slider_crank(), [0.0, 0.0])
    assert (found.status, found.rank, found.generic_rank) == ("singular", 1, 1)
    assert "some velocities that its closures allow begin no motion" in found.report()


def test_the_part_is_named():
    """Of two loops, the flat one is singular, and the other is not."""
    one, two = parallelogram(), parallelogram()
    bodies = [*one.bodies, *two.bodies[:2], type(two.bodies[2])(two.bodies[2].link, two.bodies[2].joint, 3)]
    c = two.closures[0]
    forest = Forest(bodies, [*one.closures, Closure(5, 4, c.grasp, c.tip)])
    found = forest_diagnose(forest, [0.4, 0.4, -0.4, 0.0, 0.0, 0.0])
    assert [part.status for part in found.parts] == ["indeterminate", "singular"]
    assert [part.closures for part in found.parts] == [(0,), (1,)]
    assert (found.rank, found.generic_rank) == (3, 4)


def test_derivatives_of_a_singular_posture():
    """They are refused, with the part; so is a diagnosis of an open state."""
    forest = parallelogram()
    with pytest.raises(SingularChainError, match=r"closure 0 .*1 motion more than nearby"):
        forest_dynamics_vjp(forest, np.zeros(3), np.zeros(3), np.zeros(3), qdd=np.ones(3))
    with pytest.raises(StateError, match="closure 0: position gap"):
        forest_diagnose(forest, [0.4, 0.0, 0.0])


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "spherical"])
def test_closures_beyond_all_numbers(kind):
    """No rank is read from numbers that are none, and no velocities; pytest makes errors of warnings."""
    far = [1.0, 0.0, 0.0, 0.0, 1e308, 1e308, 1e308]
    body = ForestBody(Link(1.0, inertia=np.eye(3)), BodyJoint(kind))
    forest = Forest([body], [Closure(None, 0, Grasp("ball", far), far)])
    q = np.eye(4)[0] if kind == "spherical" else np.zeros(1)
    with pytest.raises(StateError, match="overflow of float64"):
        forest_diagnose(forest, q)
    if kind != "prismatic":  # which has no lever
        with pytest.raises(StateError, match="overflow of float64"):
            forest_close(forest, q)
