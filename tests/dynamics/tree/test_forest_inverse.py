"""Inverse dynamics of forests: forward dynamics gives the accelerations back, loads are least, refusals say why."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import Status, forest_dynamics, forest_inverse_dynamics
from holdfast.dynamics.tree.forest_inverse import driven
from holdfast.errors import StateError
from holdfast.model.closure import Closure
from holdfast.model.forest import BodyJoint, Forest, ForestBody, JointCoupling
from tests.dynamics.tree.problems import LINK, gap, parallelogram, underactuated
from tests.longer import mostly_long, mostly_slow


@pytest.mark.parametrize("seed", [*mostly_slow(range(40), range(10)), *mostly_long(range(40, 100), ())])
def test_forward_dynamics_gives_it_back(seed):
    """Random forests of ten families, a third of whose joints have no drive: the same accelerations, and forces."""
    p = underactuated(seed)
    wanted = forest_dynamics(*p[1:])
    found = forest_inverse_dynamics(p.forest, p.q, p.qd, wanted.qdd, p.wrenches)
    assert not found.tau[~driven(p.forest)].any()
    again = forest_dynamics(p.forest, p.q, p.qd, found.tau, p.wrenches)
    # with objects of tonnes, forward dynamics itself is off by 2e-12 beside fifty digits
    assert gap(again.qdd, wanted.qdd) < (1e-11 if "heavy" in p.name else 1e-12)
    if wanted.status is Status.OK:
        assert gap(again.closure_wrench, found.closure_wrench) < 1e-10
        assert gap(again.coupling_force, found.coupling_force) < 1e-10


def test_two_hands_share_a_weight():
    """Two rails lift a plate between them by equal forces, and squeeze it not at all."""
    slide = {"kind": "prismatic", "axis": [0.0, 0.0, 1.0]}
    bodies = [ForestBody(LINK, BodyJoint(**slide, placement=hf.Pose(np.eye(3), [x, 0.0, 0.0]))) for x in (-1.0, 1.0)]
    bodies.append(ForestBody(hf.Link(4.0, np.zeros(3), np.eye(3)), BodyJoint("free")))
    ends = [hf.Pose(np.eye(3), [x, 0.0, 0.0]) for x in (-1.0, 1.0)]
    forest = Forest(bodies, [Closure(k, 2, hf.Grasp("rigid", end)) for k, end in enumerate(ends)])
    found = forest_inverse_dynamics(forest, [0.0, 0.0, 1, 0, 0, 0, 0, 0, 0], np.zeros(8), np.zeros(8))
    assert found.tau == pytest.approx([3 * 9.81, 3 * 9.81, *np.zeros(6)])
    assert found.closure_wrench[:, 5] == pytest.approx([2 * 9.81, 2 * 9.81])
    assert np.abs(found.closure_wrench[:, 3:5]).max() < 1e-13


def test_mimic_joint_without_a_drive():
    """A coupled finger without a drive is carried by the coupling, to whose other joint its load goes."""
    tilted = BodyJoint(axis=[0.0, 1.0, 0.0])
    bodies = [ForestBody(LINK, tilted), ForestBody(LINK, BodyJoint(axis=[0.0, 1.0, 0.0], actuated=False))]
    forest = Forest(bodies, (), [JointCoupling([(0, 0, 1.0), (1, 0, 1.0)])])
    found = forest_inverse_dynamics(forest, [0.0, 0.0], np.zeros(2), np.zeros(2))
    assert found.tau == pytest.approx([0.0, 0.0], abs=1e-14)  # of equal weights on both sides of a balance
    assert found.coupling_force == pytest.approx([-9.81 * 0.3])


def test_what_nothing_can_carry():
    """A body that nobody holds cannot be kept from falling; the message names it, and the weight."""
    forest = Forest([ForestBody(hf.Link(2.0, np.zeros(3), np.eye(3), "box"), BodyJoint("free"))])
    with pytest.raises(StateError, match=r"no wrench can carry body 0 'box'.*19\.62"):
        forest_inverse_dynamics(forest, [1, 0, 0, 0, 0, 0, 0], np.zeros(6), np.zeros(6))
    falling = forest_inverse_dynamics(forest, [1, 0, 0, 0, 0, 0, 0], np.zeros(6), [0, 0, 0, 0, 0, -9.81])
    assert not falling.tau.any()


def test_accelerations_that_open_a_closure():
    """They are refused, with the closure and by how much."""
    with pytest.raises(StateError, match=r"qdd: the accelerations do not satisfy the forest: closure 0"):
        forest_inverse_dynamics(parallelogram(), [0.4, 0.4, -0.4], np.zeros(3), [1.0, 0.0, 0.0])
    found = forest_inverse_dynamics(parallelogram(), [0.4, 0.4, -0.4], np.zeros(3), [1.0, 1.0, -1.0])
    assert np.isfinite(found.tau).all()
