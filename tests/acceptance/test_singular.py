"""Singular configurations are refused, constantly low rank is solved, and neither is mistaken."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast import METHODS, SingularChainError, Status, forward_dynamics
from tests.acceptance.comparison import relative
from tests.oracles.arithmetic import arithmetic
from tests.oracles.maximal_kkt import KktSystem
from tests.systems import (
    one_straight_arm_of_three,
    planar_parallelogram,
    planar_three_arms,
    two_collinear_stretched_6r,
)
from tests.systems.as_chain import as_chain

OUT_OF_PLANE = (0, 1, 5)  # moments about x and y, force along z


def solved(case: dict, **options):
    """Return forward dynamics of a case."""
    p = as_chain(case)
    return forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs, **options)


def planar_answer(case: dict) -> np.ndarray:
    """Return qdd and alpha_C of a planar chain in 50 digits: one grasp is enough out of the plane."""
    numbers = arithmetic(50)
    with numbers.precision():
        system = KktSystem(case, numbers)
        extra = {part.start + i for part in system.f[1:] for i in OUT_OF_PLANE}
        keep = [i for i in range(system.size) if i not in extra]
        x = numbers.solve(system.matrix[np.ix_(keep, keep)], system.rhs[keep])
    wanted = [i for part in (*system.qdd, system.alpha) for i in range(part.start, part.stop)]
    return np.array([float(x[keep.index(i)]) for i in wanted])


@pytest.mark.parametrize("method", METHODS)
def test_flat_parallelogram_is_refused(method):
    """At the flat position the rank drops: every method refuses."""
    with pytest.raises(SingularChainError, match="rank 8 of 12 here, but 9 nearby"):
        solved(planar_parallelogram(0.0), method=method)


@pytest.mark.parametrize("angle", [0.5, 1e-1, 1e-2, 1e-3])
def test_parallelogram_near_flat_is_solved(angle):
    """Down to 1e-3 rad from flat it is solved, to 1e-8."""
    case = planar_parallelogram(angle)
    result = solved(case)
    assert result.status is Status.INDETERMINATE_FORCES
    assert relative(np.r_[result.qdd, result.object_acceleration], planar_answer(case)) <= 1e-8


@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_planar_three_arms_are_never_refused(seed, tilted):
    """Rank 12 of 18 everywhere: accelerations are right and f is said to be the smallest."""
    case = planar_three_arms(seed, tilted=tilted)
    result = solved(case)
    assert result.status is Status.INDETERMINATE_FORCES
    assert "smallest" in result.status.value
    assert result.rank == 12
    if not tilted:
        assert relative(np.r_[result.qdd, result.object_acceleration], planar_answer(case)) <= 1e-10


@pytest.mark.parametrize("opposed", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_collinear_stretched_arms_are_refused(seed, opposed):
    """Two 6R arms stretched along one line: refused, moving or at rest."""
    case = two_collinear_stretched_6r(seed, opposed)
    with pytest.raises(SingularChainError):
        solved(case)
    for arm in case["arms"]:
        arm["qd"] = [0.0] * 6
    case["object"] |= {"omega": [0.0] * 3, "v": [0.0] * 3}
    with pytest.raises(SingularChainError):
        solved(case)


@pytest.mark.parametrize("which", [(0,), (2,), (0, 1)])
def test_straight_arms_among_three_are_not_singular(which):
    """One or two straight arms of three leave the chain regular."""
    result = solved(one_straight_arm_of_three(0.0, which))
    assert result.status is Status.OK
    assert result.rank == 18
