"""The inertia of a rigid body, by ten parameters, equals the paper's 6x6 matrix."""

import numpy as np
import pytest

from holdfast.dynamics.operators import phi
from holdfast.spatial.inertia import NO_INERTIA, RigidInertia, about_origin
from holdfast.spatial.spatial_vector import acceleration_gradient
from holdfast.spatial.vector import skew
from tests.systems.random_parts import inertia_about_com, rotation

seeds = pytest.mark.parametrize("seed", range(4))


def drawn(seed: int) -> tuple[np.random.Generator, RigidInertia, np.ndarray]:
    """Return a random inertia and M = [I, m p~; -m p~, m 1] with I = I_com - m p~ p~."""
    rng = np.random.default_rng(seed)
    mass, com = rng.uniform(1, 5), rng.normal(size=3)
    inertia = inertia_about_com(rng, mass, 0.5)
    p = skew(com)
    dense = np.block([[inertia - mass * p @ p, mass * p], [-mass * p, mass * np.eye(3)]])
    return rng, about_origin(mass, com, inertia), dense


@seeds
def test_matrix(seed):
    """Blocks, product and sum are those of the dense matrix."""
    rng, body, M = drawn(seed)
    a = rng.normal(size=6)
    np.testing.assert_allclose(body.symmetric().dense(), M, atol=1e-13)
    assert np.linalg.eigvalsh(M)[0] > 0
    np.testing.assert_allclose(body.apply(a), M @ a, atol=1e-13)
    np.testing.assert_allclose(body.plus(NO_INERTIA).symmetric().dense(), M, atol=1e-13)
    np.testing.assert_allclose(body.plus(body).apply(a), 2 * M @ a, atol=1e-12)


@seeds
def test_moved(seed):
    """Turned axes and a shifted point: phi (R M R^T) phi^T."""
    rng, body, M = drawn(seed)
    R, l = rotation(rng), rng.normal(size=3)
    both = np.kron(np.eye(2), R)
    moved = body.moved(R, l)
    np.testing.assert_allclose(moved.symmetric().dense(), phi(l) @ both @ M @ both.T @ phi(l).T, atol=1e-12)
    np.testing.assert_array_equal(moved.I, moved.I.T)


@seeds
def test_turning(seed):
    """At a = 0 the wrench is b = [w x I w; m w x (w x p)], the paper's bias force; its moment does no work."""
    rng, body, M = drawn(seed)
    w = rng.normal(size=3)
    p = body.h / body.m
    expected = np.r_[np.cross(w, M[:3, :3] @ w), body.m * np.cross(w, np.cross(w, p))]
    b = body.wrench(np.zeros(6), w, acceleration_gradient(np.zeros(3), w))
    np.testing.assert_allclose(b, expected, atol=1e-12)
    assert abs(b[:3] @ w) < 1e-12


@seeds
def test_momentum_rate(seed):
    """M alpha + b is the rate of the momentum: a particle cloud with the same inertia agrees."""
    rng = np.random.default_rng(seed)
    masses, points = rng.uniform(0.1, 1, 9), rng.normal(size=(9, 3))
    body = RigidInertia(
        masses.sum(),
        masses @ points,
        sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, points, strict=True)),
    )
    w, wd, vd = rng.normal(size=(3, 3))
    pushes = [m * (vd + np.cross(wd, r) + np.cross(w, np.cross(w, r))) for m, r in zip(masses, points, strict=True)]
    moments = [np.cross(r, F) for r, F in zip(points, pushes, strict=True)]
    expected = np.r_[np.sum(moments, axis=0), np.sum(pushes, axis=0)]
    np.testing.assert_allclose(body.wrench(np.r_[wd, vd], w, acceleration_gradient(wd, w)), expected, atol=1e-12)
