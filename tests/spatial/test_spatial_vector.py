"""3-vectors, twists and wrenches, symmetric matrices and inertias, which are the paper's 6x6 matrices."""

import numpy as np
import pytest

from holdfast.dynamics.operators import phi
from holdfast.spatial.inertia import NO_INERTIA, RigidInertia, about_origin
from holdfast.spatial.spatial_vector import (
    acceleration_gradient,
    centripetal,
    rotate,
    shift_twist,
    shift_wrench,
    unrotate,
)
from holdfast.spatial.symmetric import Symmetric6, mirrored, symmetric6, zero6
from holdfast.spatial.vector import cross, outer, skew
from tests.spatial.dual import duals, slopes_of
from tests.systems.random_parts import inertia_about_com, rotation

seeds = pytest.mark.parametrize("seed", range(5))


@seeds
def test_duality(seed):
    """<phi^T V, f> = <V, phi f>: power does not depend on the point."""
    rng = np.random.default_rng(seed)
    l, (V, f) = rng.normal(size=3), rng.normal(size=(2, 6))
    assert shift_twist(l, V) @ f == pytest.approx(V @ shift_wrench(l, f), abs=1e-14)


@seeds
def test_shifts_are_phi(seed):
    """phi f and phi^T V as cross products equal the 6x6 matrix of the paper; shifts one after the other add up."""
    rng = np.random.default_rng(seed)
    l, x = rng.normal(size=3), rng.normal(size=6)
    np.testing.assert_allclose(shift_wrench(l, x), phi(l) @ x, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(shift_twist(l, x), phi(l).T @ x, rtol=1e-14, atol=1e-15)
    m = rng.normal(size=3)
    np.testing.assert_allclose(phi(l) @ phi(m), phi(l + m), atol=1e-14)


@seeds
def test_axes(seed):
    """Turning the axes keeps power and commutes with shifting; unrotate undoes rotate."""
    rng = np.random.default_rng(seed)
    R, l, (V, f) = rotation(rng), rng.normal(size=3), rng.normal(size=(2, 6))
    assert rotate(R, V) @ rotate(R, f) == pytest.approx(V @ f, abs=1e-14)
    np.testing.assert_allclose(unrotate(R, rotate(R, V)), V, atol=1e-14)
    np.testing.assert_allclose(rotate(R, shift_twist(l, V)), shift_twist(R @ l, rotate(R, V)), atol=1e-14)
    np.testing.assert_allclose(rotate(R, shift_wrench(l, f)), shift_wrench(R @ l, rotate(R, f)), atol=1e-14)


@seeds
def test_centripetal(seed):
    """w x (w x l) points to the axis, with |w|^2 times the distance from it."""
    w, l = np.random.default_rng(seed).normal(size=(2, 3))
    across = l - (l @ w) / (w @ w) * w
    np.testing.assert_allclose(centripetal(w, l), -(w @ w) * across, atol=1e-14 * (w @ w))


@seeds
def test_products(seed):
    """a x b, a~ b and a b^T are NumPy's, term by term."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(3, 3))
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
    np.testing.assert_array_equal(cross(a, a), np.zeros(3))
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), rtol=1e-14, atol=1e-15)
    np.testing.assert_array_equal(skew(a).T, -skew(a))
    np.testing.assert_array_equal(outer(a, b[:2]), np.outer(a, b[:2]))
    jacobi = cross(a, cross(b, c)) + cross(b, cross(c, a)) + cross(c, cross(a, b))
    np.testing.assert_allclose(jacobi, np.zeros(3), atol=1e-14)


def test_product_rule():
    """(a x b)' = a' x b + a x b': the products run on other scalars."""
    rng = np.random.default_rng(1)
    a, b, da, db = rng.normal(size=(4, 3))
    turning = slopes_of(cross(duals(a, da), duals(b, db)))
    np.testing.assert_allclose(turning, np.cross(da, b) + np.cross(a, db), rtol=1e-14)
    np.testing.assert_allclose(slopes_of(skew(duals(a, da)) @ duals(b, db)), turning, rtol=1e-14)


def random_symmetric(seed: int) -> tuple[np.random.Generator, np.ndarray, Symmetric6]:
    """Return a random symmetric matrix, dense and in blocks."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(6, 6))
    X = X + X.T
    return rng, X, symmetric6(X)


def assert_is(blocks: Symmetric6, dense) -> None:
    """Assert equality, and symmetry to the last bit."""
    got = blocks.dense()
    np.testing.assert_allclose(got, dense, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(got, got.T)


@seeds
def test_blocks(seed):
    """Dense matrix and blocks are the same numbers; products and sums agree."""
    rng, X, blocks = random_symmetric(seed)
    x = rng.normal(size=6)
    np.testing.assert_array_equal(blocks.dense(), X)
    np.testing.assert_allclose(blocks.apply(x), X @ x, rtol=1e-13, atol=1e-14)
    assert_is(blocks.plus(zero6()), X)
    assert_is(blocks.plus(blocks), 2 * X)


@seeds
def test_outer_products(seed):
    """X + u s^T with s along u, and X + u s^T + s u^T for any s."""
    rng, X, blocks = random_symmetric(seed)
    u, s = rng.normal(size=(2, 6))
    assert_is(blocks.plus_outer(u, -0.3 * u), X - 0.3 * np.outer(u, u))
    assert_is(blocks.plus_symmetric_outer(u, s), X + np.outer(u, s) + np.outer(s, u))


@seeds
def test_axes_and_points(seed):
    """R X R^T, phi X phi^T and phi^T X phi, symmetric to the last bit."""
    rng, X, blocks = random_symmetric(seed)
    R, l = rotation(rng), rng.normal(size=3)
    both = np.kron(np.eye(2), R)
    assert_is(blocks.rotated(R), both @ X @ both.T)
    assert_is(blocks.inertia_shifted(l), phi(l) @ X @ phi(l).T)
    assert_is(blocks.mobility_shifted(l), phi(l).T @ X @ phi(l))


def test_mirrored():
    """The upper triangle decides."""
    np.testing.assert_array_equal(mirrored(np.array([[1.0, 2.0], [7.0, 3.0]])), [[1.0, 2.0], [2.0, 3.0]])


def test_other_scalars():
    """Shifts differentiate like the dense product: blocks run on other scalars."""
    rng, X, _ = random_symmetric(3)
    dX, l, dl = rng.normal(size=(6, 6)), rng.normal(size=3), rng.normal(size=3)
    dX = dX + dX.T
    blocks = symmetric6(duals(X, dX))
    dphi = phi(dl) - np.eye(6)
    expected = dphi.T @ X @ phi(l) + phi(l).T @ dX @ phi(l) + phi(l).T @ X @ dphi
    np.testing.assert_allclose(slopes_of(blocks.mobility_shifted(duals(l, dl)).dense()), expected, atol=1e-13)


def random_inertia(seed: int) -> tuple[np.random.Generator, RigidInertia, np.ndarray]:
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
    rng, body, M = random_inertia(seed)
    a = rng.normal(size=6)
    np.testing.assert_allclose(body.symmetric().dense(), M, atol=1e-13)
    assert np.linalg.eigvalsh(M)[0] > 0
    np.testing.assert_allclose(body.apply(a), M @ a, atol=1e-13)
    np.testing.assert_allclose(body.plus(NO_INERTIA).symmetric().dense(), M, atol=1e-13)
    np.testing.assert_allclose(body.plus(body).apply(a), 2 * M @ a, atol=1e-12)


@seeds
def test_moved(seed):
    """Turned axes and a shifted point: phi (R M R^T) phi^T."""
    rng, body, M = random_inertia(seed)
    R, l = rotation(rng), rng.normal(size=3)
    both = np.kron(np.eye(2), R)
    moved = body.moved(R, l)
    np.testing.assert_allclose(moved.symmetric().dense(), phi(l) @ both @ M @ both.T @ phi(l).T, atol=1e-12)
    np.testing.assert_array_equal(moved.I, moved.I.T)


@seeds
def test_turning(seed):
    """At a = 0 the wrench is b = [w x I w; m w x (w x p)], the paper's bias force; its moment does no work."""
    rng, body, M = random_inertia(seed)
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
