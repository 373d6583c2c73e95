"""Millimetres for metres, grams for kilograms: the same motion in other numbers."""

import pytest

from tests.dynamics.problems import relative_gap
from tests.dynamics.rescaled import rescaled
from tests.laws.systems import mixed, sample, solved

TOLERANCE = 1e-10


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("length", "mass"), [(1e3, 1.0), (1.0, 1e3), (1e-3, 1e3)])
def test_other_units(make, seed, length, mass):
    """Every quantity scales by its own dimension; rank, status and condition have none."""
    p, result = make(seed)
    other, units = rescaled(p, length, mass)
    got = solved(other)
    assert relative_gap(got.qdd, result.qdd * units.joints) < TOLERANCE
    assert relative_gap(got.grasp_wrench, result.grasp_wrench * units.wrench) < TOLERANCE
    assert relative_gap(got.base_wrench, result.base_wrench * units.wrench) < TOLERANCE
    assert relative_gap(got.object_acceleration, result.object_acceleration * units.twist) < TOLERANCE
    assert relative_gap(got.contact_acceleration, result.contact_acceleration) < TOLERANCE
    assert (got.rank, got.mobility, got.status) == (result.rank, result.mobility, result.status)
    assert got.condition == pytest.approx(result.condition, rel=1e-8)
