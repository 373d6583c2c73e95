"""Several motions of one contact problem: what enumeration finds, and a body between two walls, in closed form."""

from importlib.util import find_spec

import numpy as np
import pytest
from benchmarks.contact_bars import drawn
from benchmarks.contact_instants import compared

from holdfast.dynamics import ContactStatus, solve_contacts
from holdfast.dynamics.contact.contact_forces import contact_problem
from holdfast.dynamics.contact.other_motions import all_motions
from holdfast.dynamics.contact.proximal_newton import polished
from tests.longer import mostly_long
from tests.oracles import contact_modes

needs_clarabel = pytest.mark.skipif(find_spec("clarabel") is None, reason="clarabel is not installed")
SEVERAL = [57, 65, 66, 80, 86, 98]  # of the problems below
G = 9.81


def two_contacts(number):
    """Return a random problem with two contacts and much friction, and the solver's contacts."""
    rng = np.random.default_rng(2016)
    one = [drawn(rng, 2, 1.6) for _ in range(number + 1)][-1]
    return one, contact_problem(*one, np.zeros(2), np.zeros((2, 2)), False)


@needs_clarabel
@pytest.mark.parametrize("number", mostly_long(range(100), [57, 66]))
def test_all_are_found(number):
    """Motions of two contacts are those of an enumeration from 2,304 pairs of directions, no more and no fewer."""
    one, problem = two_contacts(number)
    true = [P.change for P in contact_modes.all_motions(*one)]
    assert (len(true) > 1) == (number in SEVERAL)
    found = [polished(problem.contacts, forces) for forces in all_motions(problem.contacts)]
    changes = [
        sum(x @ c.along for x, c in zip(forces, problem.contacts, strict=True)) for forces, off in found if off < 1e-9
    ]
    size = np.abs(one.free).max()
    for own, other in ((true, [problem.L @ z for z in changes]), ([problem.L @ z for z in changes], true)):
        assert all(min(np.abs(one.rows @ (a - b)).max() for b in other) < 1e-7 * size for a in own)
    several = solve_contacts(*one).status is ContactStatus.AMBIGUOUS
    assert several == (len(true) > 1)


def between_walls(mu):
    """Return a body of 1 kg with a point on each of two vertical walls, at rest."""
    P = np.diag([10.0, 10.0, 10.0, 1.0, 1.0, 1.0])
    rows = np.zeros((2, 3, 6))
    for j, (l, n) in enumerate((([-0.1, 0, 0], [1.0, 0, 0]), ([0.1, 0, 0], [-1.0, 0, 0]))):
        for i, t in enumerate(([0, 1.0, 0], np.cross(n, [0, 1.0, 0]), n)):
            rows[j, i] = np.concatenate([np.cross(l, t), t])
    return P, rows, rows @ [0, 0, 0, 0, 0, -G], np.full(2, mu)


def test_between_two_walls():
    """Friction holds a body between two walls that squeeze it, or it falls: both satisfy the laws, for every mu."""
    for mu in (0.1, 0.6):
        found = solve_contacts(*between_walls(mu))
        assert found.status is ContactStatus.AMBIGUOUS
        assert found.range is not None
        np.testing.assert_allclose(np.sort(found.range[:, 5]), [0.0, G], atol=1e-9)
    assert solve_contacts(*between_walls(0.0)).status is not ContactStatus.AMBIGUOUS


@needs_clarabel
@pytest.mark.parametrize("seed", mostly_long(range(350), [1, 5, 8]))
def test_random_instants(seed):
    """Instants in the layout of cases have the status, and where motions are unique the answer, of the enumeration."""
    fault = compared(seed)[1]
    assert fault is None, fault


def test_small_forces_in_a_wedge():
    """Contacts that could squeeze have forces of the size of the load, also if the least ones leave their cones."""
    for mu in (0.3, 0.6, 1.2):
        P, rows, b, friction = between_walls(mu)
        found = solve_contacts(P, rows, b + rows @ [0, 0, 0, 0.2, 0.1, 0], friction)
        assert found.residual < 1e-12
        assert np.abs(found.force).max() < 2.0 * G / mu
