"""The oracle of derivatives, dual numbers over the dense equations, has the stored 126-digit answers."""

from __future__ import annotations

import pytest

from tests.derivatives.stored import OF, columns, gaps, names, stored
from tests.oracles.chain_derivatives import chain_derivatives
from tests.oracles.least_forces import least_force_derivatives
from tests.systems.problems import relative_gap

BAR = 1e-11
DIGITS = 40
EXACT = 1e-14  # what rounding of inputs and of the file leaves of many digits
UNIQUE = [name for name in names() if stored(name).unique]
NOT_UNIQUE = [name for name in names() if name not in UNIQUE]


def worst_gap(name: str, digits: int | None) -> float:
    """Return the worst gap of all blocks of a stored case."""
    case, worst = stored(name), 0.0
    found = chain_derivatives(case.problem, digits=digits)
    for of in OF:
        assert relative_gap(found.values[of], case.values[of]) < BAR
    for group in case.groups:
        by, which = columns(case.problem.chain, group)
        ours = {of: found.block(of, by)[:, which] for of in OF}
        off = dict(gaps(ours, {of: case.blocks[of, group] for of in OF}))
        assert max(off.values()) < BAR, (group, off)
        worst = max(worst, *off.values())
    return worst


@pytest.mark.parametrize("name", UNIQUE)
def test_stored_answers(name):
    """Every block of partial derivatives, in float64."""
    print(f"\n{name}: {worst_gap(name, None):.1e}")


@pytest.mark.parametrize("name", UNIQUE)
def test_stored_answers_in_many_digits(name):
    """The same in forty digits: what is left is the rounding of the pose's quaternion."""
    print(f"\n{name}: {worst_gap(name, DIGITS):.1e}")


@pytest.mark.parametrize("name", UNIQUE)
def test_along_the_manifold(name):
    """Partial derivatives times the tangent."""
    case = stored(name)
    found = chain_derivatives(case.problem, ("q", "object_pose", "qd", "object_twist"))
    ours = {of: found.matrices[of] @ case.tangent for of in OF}
    off = dict(gaps(ours, case.along))
    assert max(off.values()) < BAR, off


@pytest.mark.parametrize("name", NOT_UNIQUE)
def test_least_forces(name):
    """Where forces are not unique: accelerations and the least forces, along the manifold."""
    case = stored(name)
    found = least_force_derivatives(case.problem, case.tangent)
    for of in OF:
        assert relative_gap(found.values[of], case.values[of]) < BAR, of
    off = dict(gaps({of: found.matrices[of] for of in OF}, case.along))
    print(f"\n{name}: {max(off.values()):.1e}")
    assert max(off.values()) < BAR, off
