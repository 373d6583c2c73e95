"""Contact forces against the same conditions in 50 digits, on problems where a conic solver was 2e-6 away."""

import mpmath
import numpy as np
import pytest
from benchmarks.contact_bars import drawn, from_clarabel

from holdfast.dynamics.contact.contact_forces import contact_problem, found_forces
from holdfast.dynamics.contact.fixed_modes import ContactMode
from holdfast.dynamics.contact.solve_contacts import surely


def problem(most, k, number):
    """Return a random problem of k contacts, with what is found for it."""
    rng = np.random.default_rng([0, k, int(10 * most)])
    one = [drawn(rng, k, most) for _ in range(number + 1)][-1]
    reduced = contact_problem(*one, np.zeros(k), np.zeros((k, 2)), False)
    return one, reduced, found_forces(reduced, surely(reduced))


def in_fifty_digits(one, found):
    """Return the velocities (k, 3) by Newton's method on Signorini's and Coulomb's equations in the modes found.

    The signs of what the modes leave out are checked, so that these are a solution of the laws.
    """
    k, mu = len(one.friction), [mpmath.mpf(float(x)) for x in one.friction]
    rows = mpmath.matrix(one.rows.reshape(3 * k, 6).tolist())
    G, b = rows * mpmath.matrix(one.mobility.tolist()) * rows.T, mpmath.matrix(one.free.ravel().tolist())
    closed = [j for j in range(k) if found.force[j, 2] > 0.0]

    def motion(x):
        force = mpmath.matrix(3 * k, 1)
        for i, j in enumerate(closed):
            for a in range(3):
                force[3 * j + a] = x[3 * i + a]
        return force, b + G * force

    def left(*x):
        (force, u), equations = motion(x), []
        for j in closed:
            if found.mode[j] == ContactMode.STICKS:
                equations += [u[3 * j + a] for a in range(3)]
                continue
            slip = mpmath.sqrt(u[3 * j] ** 2 + u[3 * j + 1] ** 2)
            full = mu[j] * force[3 * j + 2]
            equations += [u[3 * j + 2], *(force[3 * j + a] * slip + full * u[3 * j + a] for a in range(2))]
        return equations

    start = [mpmath.mpf(float(x)) for j in closed for x in found.force[j]]
    x = mpmath.findroot(left, start, tol=1e-60, maxsteps=30, verify=False)
    assert max(abs(e) for e in left(*x)) < mpmath.mpf(10) ** -40
    force, u = motion(list(x))
    for j in range(k):
        n, t = force[3 * j + 2], mpmath.sqrt(force[3 * j] ** 2 + force[3 * j + 1] ** 2)
        assert (n > 0 and t <= mu[j] * n * (1 + mpmath.mpf(10) ** -30)) if j in closed else u[3 * j + 2] >= 0
    return np.array([float(x) for x in u]).reshape(k, 3)


@pytest.mark.parametrize(("most", "k", "number"), [(1.0, 2, 9), (0.5, 4, 9), (0.5, 4, 17)])
def test_velocities_to_the_last_digits(most, k, number):
    """Ours are those of 50 digits to 1e-12 of the largest; Clarabel's convex problem is within its accuracy."""
    one, reduced, found = problem(most, k, number)
    with mpmath.workdps(50):
        true = in_fifty_digits(one, found)
    assert np.abs(one.free + one.rows @ found.change - true).max() < 1e-12 * np.abs(one.free).max()
    assert from_clarabel(one, np.array(found.change), reduced) < 1e-6
