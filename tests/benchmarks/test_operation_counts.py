"""`sequential` with a trunk is linear in arms, in their joints and in the trunk's, to the last operation."""

import numpy as np
import pytest
from benchmarks.bench.trunks import FLOATING, TORSO, make_trunk_system
from benchmarks.operation_counts import on_trunk

from holdfast.compiled.forward_schedule import forward_schedule
from holdfast.compiled.structure import Options, Structure
from tests.longer import mostly_long

CASES = (("rigid", False, 7), ("ball", True, 4))  # kind, whether the trunk floats, joints from which on it is linear
KINDS = ("rigid", "ball")  # the mobility as a matrix, and in factors


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "floating", "fewest"), mostly_long(CASES, CASES[:1]))
def test_linear_in_arms_and_their_joints(kind, floating, fewest):
    """Second differences are 0: of arms from two on the trunk on, of joints from where the recursion has them all."""
    by_arms = [on_trunk(l, 4, 7, kind, floating=floating) for l in (3, 4, 5, 6)]
    by_joints = [on_trunk(2, fewest + k, 7, kind, floating=floating) for k in range(4)]
    assert np.diff(by_arms, 2).tolist() == [0, 0]
    assert np.diff(by_joints, 2).tolist() == [0, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "floating", "least"),
    mostly_long(
        [(kind, *base) for kind in KINDS for base in ((False, 7), (True, 2))], [("rigid", True, 2), ("ball", False, 7)]
    ),
)
def test_linear_in_the_trunk(kind, floating, least):
    """From seven joints, or two on a floating base: what seven more of them cost is always the same.

    Factors of the mobility are compressed with every seventh joint, so single joints do not cost the same.
    """
    for first in (least, least + 3):
        counts = [on_trunk(2, 4, first + 7 * k, kind, floating=floating) for k in range(3)]
        assert np.diff(counts, 2).tolist() == [0]


@pytest.mark.slow
@pytest.mark.parametrize(("floating", "first"), mostly_long([(False, 6), (True, 3)], [(True, 3)]))
def test_every_joint_costs_the_same_below_all_arms(floating, first):
    """Where all arms stand on the last body, second differences are 0 from where joints are taken one by one."""
    counts = [on_trunk(2, 4, m, "ball", floating=floating, in_world=0) for m in range(first, first + 6)]
    assert np.diff(counts, 2).tolist() == [0, 0, 0, 0]


def test_a_trunk_over_the_arms_alone():
    """Two Pandas in machine code on a torso of three joints and on a floating base, over 7,404 for two in the world.

    (Two in the world have become cheaper since; what a trunk costs must not grow.)
    """
    for name, most in ((TORSO, 1.6), (FLOATING, 1.85)):
        schedule = forward_schedule(Structure(make_trunk_system(name, states=1).chain, Options()))
        assert schedule.operation_count < most * 7404, (name, schedule.operation_count)
