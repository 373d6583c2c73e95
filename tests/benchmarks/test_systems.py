"""The benchmark's systems are closed, consistent, and different in every state."""

import numpy as np
import pytest
from benchmarks.bench.systems import make_system

from holdfast import State, forward_dynamics
from holdfast.dynamics import closure

CLOSED = 1e-9
SIZES = ((3, 7), (64, 7), (2, 6), (2, 96))


@pytest.mark.parametrize(("arms", "joints"), SIZES)
def test_closed_with_consistent_velocities(arms, joints):
    """Every grasp of every state holds, in position and in velocity."""
    system = make_system(arms, joints, 3)
    assert system.name == f"{arms} x {joints}"
    assert system.q.shape == system.qd.shape == system.tau.shape == (3, arms * joints)
    for q, qd, pose, twist in zip(system.q, system.qd, system.object_pose, system.object_twist, strict=True):
        for gap in closure(system.chain, State(q, qd, pose, twist)).values():
            assert np.abs(gap.position).max() <= CLOSED
            assert np.abs(gap.velocity).max() <= CLOSED


def test_states_differ():
    """Nothing is the same in two states; the count is what was asked for, or the default."""
    system = make_system(2, 7)
    assert system.states == 32
    for array in system.arrays:
        assert len(np.unique(array, axis=0)) == 32
    assert make_system(64, 6, seed=1).states == 8


def test_well_conditioned():
    """The longest arms are no trap for anyone: full rank, and pivots of one size."""
    system = make_system(2, 96, 2)
    result = forward_dynamics(
        system.chain, State(system.q[1], system.qd[1], system.object_pose[1], system.object_twist[1]), system.tau[1]
    )
    assert result.rank == 12
    assert result.condition < 1e3


def test_repeated():
    """A batch takes the states in turn."""
    system = make_system(2, 6, 3)
    batch = system.repeated(7)
    assert batch.states == 7
    for few, many in zip(system.arrays, batch.arrays, strict=True):
        assert np.array_equal(many, few[[0, 1, 2, 0, 1, 2, 0]])


def test_reproducible():
    """The same seed gives the same numbers, another seed others."""
    one, same, other = make_system(2, 7, 2), make_system(2, 7, 2), make_system(2, 7, 2, seed=1)
    assert np.array_equal(one.q, same.q)
    assert not np.array_equal(one.q, other.q)
