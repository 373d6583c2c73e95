"""Rank of the grasp constraint, here and nearby."""

import numpy as np
import pytest

from holdfast import SingularChainError, State, Status
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.rank import (
    constraint_rank,
    generic_constraint_rank,
    regularity,
    status_at,
    velocities_are_motions,
)
from tests.dynamics.problems import CASES, motion_of, relative_gap, stored
from tests.dynamics.rescaled import rescaled
from tests.systems import (
    one_straight_arm_of_three,
    planar_parallelogram,
    planar_three_arms,
    two_collinear_stretched_6r,
)
from tests.systems.as_chain import as_chain


@pytest.mark.parametrize("name", CASES)
def test_stored_ranks(name):
    """The filter's kept pivots are the rank of [J, -A, H^T] by singular values, and the stored one."""
    p = stored(name)
    s = Stacked(motion_of(p))
    matrix = np.hstack([s.J, -s.A, s.HT])
    assert constraint_rank(p.chain, p.state) == np.linalg.matrix_rank(matrix, tol=1e-9)
    assert constraint_rank(p.chain, p.state) == CASES[name]["tags"]["constraint_rank"]


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("mass", [1e-3, 1e3])
@pytest.mark.parametrize("name", ["planar_3arm_6_7_6_omega_singular", "stewart_6_RRP_ball", "rigid_12arm"])
def test_rank_has_no_unit(name, length, mass):
    """Millimetres and grams do not change the rank."""
    other, _ = rescaled(stored(name), length, mass)
    assert constraint_rank(other.chain, other.state) == CASES[name]["tags"]["constraint_rank"]


@pytest.mark.parametrize("length", [1e-3, 1e3])
@pytest.mark.parametrize(
    ("case", "generic"),
    [(planar_parallelogram(0.0), 9), (planar_three_arms(1), 12), (two_collinear_stretched_6r(0), 12)],
    ids=["parallelogram", "planar", "collinear"],
)
def test_generic_rank_has_no_unit(case, generic, length):
    """A chain a thousand times larger or smaller has the same rank nearby."""
    p = as_chain(case)
    assert generic_constraint_rank(p.chain, p.state) == generic
    other, _ = rescaled(p, length)
    assert generic_constraint_rank(other.chain, other.state) == generic


def test_velocities_do_not_enter():
    """The rank is the configuration's: it is the same at rest and in motion."""
    p = stored("planar_2arm_6_6_omega_singular")
    fast = State(p.state.q, 50 * p.state.qd, p.state.object_pose, 50 * p.state.object_twist)
    assert constraint_rank(p.chain, fast) == constraint_rank(p.chain, p.state) == 9


@pytest.mark.parametrize(("opposed", "seed"), [(True, 0), (True, 2), (False, 0), (False, 1)])
def test_collinear_arms(opposed, seed):
    """Stretched along one line: rank 11 of 12, singular, whether or not neighbours show rank 12."""
    p = as_chain(two_collinear_stretched_6r(seed, opposed=opposed))
    assert constraint_rank(p.chain, p.state) == 11
    found = regularity(p.chain, p.state, 11)
    assert found.kind == "singular"
    assert found.why
    if opposed:  # locked: an allowed velocity goes nowhere
        assert not velocities_are_motions(p.chain, p.state)
    with pytest.raises(SingularChainError, match=r"rank 11 of 12 here, .*: a singular configuration.*diagnose"):
        status_at(p.chain, p.state, 11)


@pytest.mark.parametrize("angle", [0.5, 1e-2, 0.0])
def test_parallelogram(angle):
    """Rank 9 of 12 in general: indeterminate; flat it drops to 8: singular."""
    p = as_chain(planar_parallelogram(angle))
    rank = constraint_rank(p.chain, p.state)
    assert rank == (8 if angle == 0.0 else 9)
    assert generic_constraint_rank(p.chain, p.state) == 9
    if angle == 0.0:
        with pytest.raises(SingularChainError, match="rank 8 of 12 here, but 9 nearby"):
            status_at(p.chain, p.state, rank)
    else:
        assert velocities_are_motions(p.chain, p.state)
        assert status_at(p.chain, p.state, rank) is Status.INDETERMINATE_FORCES


@pytest.mark.parametrize("tilted", [False, True])
def test_planar_arms(tilted):
    """Constantly low rank: indeterminate everywhere, and every allowed velocity is a motion."""
    p = as_chain(planar_three_arms(2, tilted=tilted))
    assert generic_constraint_rank(p.chain, p.state) == constraint_rank(p.chain, p.state) == 12
    assert regularity(p.chain, p.state, 12).kind == "indeterminate"


def test_straight_arms_are_no_singularity():
    """Three straight arms on different lines: full rank all the same."""
    p = as_chain(one_straight_arm_of_three(0.0, which=(0, 1, 2)))
    assert constraint_rank(p.chain, p.state) == 18
    assert status_at(p.chain, p.state, 18) is Status.OK


def test_known_generic_rank_is_trusted():
    """Given the generic rank no neighbour is looked at: equal is indeterminate, lower singular."""
    p = as_chain(two_collinear_stretched_6r(0))
    assert regularity(p.chain, p.state, 11, generic=11).kind == "indeterminate"
    found = regularity(p.chain, p.state, 11, generic=12)
    assert (found.kind, found.generic_rank) == ("singular", 12)
    with pytest.raises(SingularChainError, match="but 12 in general"):
        status_at(p.chain, p.state, 11, 12)
    assert regularity(p.chain, p.state, 12).kind == "regular"


def test_weakest_direction_grows_with_the_bend():
    """Near a singularity the smallest singular value goes with the angle: no jump, no early status_at."""
    sizes = []
    for angle in (1e-3, 1e-4, 1e-5):
        p = as_chain(planar_parallelogram(angle))
        s = Stacked(motion_of(p))
        sizes.append(np.linalg.svd(np.hstack([s.J, -s.A]), compute_uv=False)[8])
        assert constraint_rank(p.chain, p.state) == 9
    assert relative_gap(np.array(sizes[1:]), 0.1 * np.array(sizes[:-1])) < 1e-2
