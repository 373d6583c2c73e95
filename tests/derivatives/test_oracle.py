"""The oracle of derivatives, dual numbers over the dense equations, has the stored 126-digit answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Pose
from holdfast.spatial import rotation
from tests.derivatives.chains import TRUNKS, random_chain
from tests.derivatives.moved import moved_problem
from tests.derivatives.stored import OF, columns, gaps, names, stored
from tests.longer import mostly_long, mostly_slow
from tests.oracles.chain_derivatives import OUTPUTS, chain_derivatives
from tests.oracles.dual_dynamics import dynamics_derivatives, minimum_norm_derivatives
from tests.systems.as_chain import Problem
from tests.systems.problems import relative_gap

TOLERANCE = 1e-11
ON_DUAL_NUMBERS = 1e-11  # measured: 3e-13
USUAL = 5e-12  # measured: 1e-12, once 2.7e-12 with a heavy object, where the oracle is at 4e-14
ROUNDING = 1e-12  # of a group's largest entry: blocks that are zero
DIGITS = 40
UNIQUE = [name for name in names() if stored(name).unique]
NOT_UNIQUE = [name for name in names() if name not in UNIQUE]


def worst_gap(name: str, digits: int | None) -> float:
    """Return the worst gap of all blocks of a stored case."""
    case, worst = stored(name), 0.0
    found = chain_derivatives(case.problem, digits=digits)
    for of in OF:
        assert relative_gap(found.values[of], case.values[of]) < TOLERANCE
    for group in case.groups:
        by, which = columns(case.problem.chain, group)
        ours = {of: found.block(of, by)[:, which] for of in OF}
        off = dict(gaps(ours, {of: case.blocks[of, group] for of in OF}))
        assert max(off.values()) < TOLERANCE, (group, off)
        worst = max(worst, *off.values())
    return worst


@pytest.mark.parametrize("name", mostly_slow(UNIQUE, [*UNIQUE][::4]))
def test_stored_answers(name):
    """Every block of partial derivatives, in float64."""
    print(f"\n{name}: {worst_gap(name, None):.1e}")


@pytest.mark.parametrize("name", mostly_long(UNIQUE, ("rigid_1arm_6R", "mixed_hinge_soft_ball")))
def test_stored_answers_in_many_digits(name):
    """The same in forty digits: what is left is the rounding of the pose's quaternion."""
    print(f"\n{name}: {worst_gap(name, DIGITS):.1e}")


@pytest.mark.parametrize("name", mostly_slow(UNIQUE, [*UNIQUE][1::4]))
def test_along_the_manifold(name):
    """Partial derivatives times the tangent."""
    case = stored(name)
    found = chain_derivatives(case.problem, ("q", "object_pose", "qd", "object_twist"))
    ours = {of: found.matrices[of] @ case.tangent for of in OF}
    off = dict(gaps(ours, case.along))
    assert max(off.values()) < TOLERANCE, off


@pytest.mark.parametrize("name", NOT_UNIQUE)
def test_minimum_norm_forces(name):
    """Where forces are not unique: accelerations and the least forces, along the manifold."""
    case = stored(name)
    found = minimum_norm_derivatives(case.problem, case.tangent)
    for of in OF:
        assert relative_gap(found.values[of], case.values[of]) < TOLERANCE, of
    off = dict(gaps({of: found.matrices[of] for of in OF}, case.along))
    print(f"\n{name}: {max(off.values()):.1e}")
    assert max(off.values()) < TOLERANCE, off


def worst_of_dynamics(p: Problem) -> float:
    """Return how far the library's functions on dual numbers are from the oracle, values and every direction."""
    ours, dual = chain_derivatives(p), dynamics_derivatives(p)
    worst = max(relative_gap(ours.values[of], dual.values[of], 1e-9) for of in ours.values)
    for by in ours.at:
        found, expected = ({of: which.block(of, by) for of in ours.values} for which in (ours, dual))
        off = dict(gaps(found, expected, ROUNDING))
        assert max(off.values()) < ON_DUAL_NUMBERS, (by, off)
        worst = max(worst, *off.values())
    return worst


@pytest.mark.parametrize("trunk", TRUNKS)
@pytest.mark.parametrize("seed", mostly_long(range(4), (1,)))
def test_dynamics_on_dual_numbers(seed, trunk):
    """The library's own functions on dual numbers: any grasps, arms on trunks and free."""
    p = random_chain(seed, trunk)
    worst = worst_of_dynamics(p)
    print(f"\n{trunk or 'bases'}, {', '.join(grasp.kind for grasp in p.chain.grasps.values())}: {worst:.1e}")
    assert worst < ON_DUAL_NUMBERS


@pytest.mark.parametrize("trunk", mostly_long(TRUNKS, (None,)))
def test_off_the_constraint(trunk):
    """Grasps that gape, and rates that open them: the same map of all states."""
    p, random = random_chain(20, trunk), np.random.default_rng(0)
    apart, pose = random.normal(size=6), p.state.object_frame
    pose = Pose(rotation.exp(0.2 * apart[:3]) @ pose.R, pose.p + 0.05 * apart[3:])
    qd = p.state.qd + random.normal(size=p.chain.joint_count)
    assert worst_of_dynamics(replace(p, state=replace(p.state, object_pose=pose.wxyz_xyz, qd=qd))) < ON_DUAL_NUMBERS


@pytest.mark.parametrize("trunk", TRUNKS)
def test_differences(trunk):
    """Differences of the dense equations, solved by the library, along random directions of everything at once."""
    p, random, step = random_chain(30, trunk), np.random.default_rng(1), 1e-5
    found = chain_derivatives(p)
    size = max(part.stop for part in found.at.values())
    direction = random.normal(size=size)
    there, back = (moved_problem(p, found.at, e * direction).solved(method="kkt", check=False) for e in (step, -step))
    for of in OUTPUTS:
        slope = (getattr(there, of) - getattr(back, of)).ravel() / (2 * step)
        assert relative_gap(found.matrices[of] @ direction, slope) < 1e-6, of


@pytest.mark.parametrize("scale", mostly_slow([1e-2, 1.0, 1e2], (1e2,)))
@pytest.mark.parametrize("seed", mostly_long(range(3), (2,)))
def test_dynamics_with_objects_of_usual_mass(seed, scale):
    """A hundredth to a hundred times the usual object: the filter's own derivatives hold."""
    worst = worst_of_dynamics(random_chain(600 + seed, any_kind=False, object_scale=scale))
    print(f"\n{scale:.0e}: {worst:.1e}")
    assert worst < USUAL
