"""The solver of cone programmes: answers by hand, by another solver, and proofs that need no solver to check."""

import numpy as np
import pytest
from scipy.optimize import linprog

from holdfast.forces.cone_solver import ConeProgramme, Cones, Verdict, solve

LINES = Cones(2, 0, 1)


def linear(c, G, h):
    """Return a linear programme."""
    G = np.asarray(G, dtype=float)
    return ConeProgramme(
        np.zeros((G.shape[1],) * 2), np.asarray(c, float), G, np.asarray(h, float), Cones(len(G), 0, 1)
    )


@pytest.mark.parametrize("seed", range(12))
def test_linear_programmes(seed):
    """Values and verdicts are those of the simplex method; every other one of these is infeasible."""
    rng = np.random.default_rng(seed)
    G, x = rng.normal(size=(12, 5)), rng.normal(size=5)
    h = G @ x + rng.uniform(0.1, 1.0, 12)
    if seed % 2:
        G, h = np.vstack([G, -G[:3].sum(axis=0)]), np.r_[h, -h[:3].sum() - 0.5]
    c = -G.T @ rng.uniform(0.0, 1.0, len(G))  # bounded below
    of = linear(c, G, h)
    found, other = solve(of), linprog(c, G, h, bounds=(None, None))
    if seed % 2:
        assert other.status == 2
        assert found.verdict is Verdict.INFEASIBLE
        assert (found.z >= 0.0).all()
        assert np.abs(G.T @ found.z).max() <= 1e-9
        assert h @ found.z == pytest.approx(-1.0, rel=1e-12)
    else:
        assert found.verdict is Verdict.OPTIMAL
        assert found.value == pytest.approx(other.fun, rel=1e-9)


def test_falls_for_ever():
    """A direction in which the value falls and no limit ends proves that there is no least value."""
    of = linear([-1.0, 0.0], [[-1.0, 0.0], [0.0, 1.0]], [0.0, 1.0])
    found = solve(of)
    assert found.verdict is Verdict.UNBOUNDED
    assert of.c @ found.x == pytest.approx(-1.0)
    assert (of.G @ found.x <= 1e-8).all()


@pytest.mark.parametrize("filled", [0, 2])
@pytest.mark.parametrize("seed", range(5))
def test_nearest_point_of_a_cone(seed, filled):
    """The projection onto a second-order cone has a closed form; zeros that fill the cone up change nothing."""
    p = np.random.default_rng(seed).normal(size=4)
    p[0] *= 0.3  # outside, mostly
    G = np.vstack([-np.eye(4), np.zeros((filled, 4))])
    of = ConeProgramme(np.eye(4), -p, G, np.zeros(4 + filled), Cones(0, 1, 4 + filled))
    found, length = solve(of), np.linalg.norm(p[1:])
    wanted = p if p[0] >= length else 0.5 * (1 + p[0] / length) * np.r_[length, p[1:]]
    if -p[0] >= length:
        wanted = np.zeros(4)
    assert found.verdict is Verdict.OPTIMAL
    np.testing.assert_allclose(found.x, wanted, atol=1e-6)
    assert found.value == pytest.approx(0.5 * (wanted - p) @ (wanted - p) - 0.5 * p @ p, abs=1e-9)


@pytest.mark.parametrize("size", [1e-5, 1.0, 1e5])
def test_scales(size):
    """The unknowns' units do not matter."""
    rng = np.random.default_rng(1)
    Q, G, h = rng.normal(size=(4, 4)), rng.normal(size=(9, 4)), rng.uniform(0.5, 1.0, 9)
    P, c, cones = Q.T @ Q, rng.normal(size=4), Cones(3, 2, 3)
    unit = np.array([size, 1.0, 1.0 / size, 1.0])
    plain = solve(ConeProgramme(P, c, G, h, cones))
    other = solve(ConeProgramme(P * unit[:, None] * unit, c * unit, G * unit, h, cones))
    assert other.value == pytest.approx(plain.value, rel=1e-9)
    np.testing.assert_allclose(other.x * unit, plain.x, atol=1e-5)  # values to 1e-10 are points to its square root


def test_nothing_to_choose():
    """Without unknowns, the limits are kept or not."""
    for h, verdict in ((1.0, Verdict.OPTIMAL), (-1.0, Verdict.INFEASIBLE)):
        of = ConeProgramme(np.zeros((0, 0)), np.zeros(0), np.zeros((2, 0)), np.array([1.0, h]), LINES)
        assert solve(of).verdict is verdict


@pytest.mark.parametrize("seed", range(4))
def test_optimality(seed):
    """Multipliers satisfy the conditions of an optimum: they are in the cone, balance the slope, and cost nothing."""
    rng = np.random.default_rng(seed)
    cones, G, P = Cones(4, 3, 4), rng.normal(size=(16, 6)), np.diag(rng.uniform(0, 1, 6))
    of = ConeProgramme(P, rng.normal(size=6), G, G @ rng.normal(size=6) + cones.unit, cones)
    found = solve(of)
    assert cones.depth(found.s) >= -1e-9 <= cones.depth(found.z)
    np.testing.assert_allclose(P @ found.x + of.c + G.T @ found.z, 0.0, atol=1e-8)
    np.testing.assert_allclose(G @ found.x + found.s, of.h, atol=1e-8)
    assert found.s @ found.z == pytest.approx(0.0, abs=1e-7)
