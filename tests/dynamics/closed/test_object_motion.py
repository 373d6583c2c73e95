"""The object in motion: M(C) alpha + b = f (2.4), however light it is and wherever C lies."""

import numpy as np
import pytest

from holdfast import HeldObject, Pose
from holdfast.dynamics.closed.object_motion import object_motion, symmetric_inverse
from tests.systems.problems import relative_gap
from tests.systems.random_parts import inertia_about_com, rotation

cases = pytest.mark.parametrize(
    ("scale", "reach", "seed"), [(s, r, k) for s in (1.0, 1e-12, 1e12) for r in (0.1, 5.0) for k in (0, 1)]
)


def drawn(scale: float, reach: float, seed: int):
    """Return a body, its frame and twist; mass scaled, mass centre `reach` metres from C."""
    rng = np.random.default_rng(seed)
    body = HeldObject(3.0 * scale, scale * inertia_about_com(rng, 3.0, 0.5), reach * rng.normal(size=3))
    frame, V = Pose(rotation(rng), rng.normal(size=3)), rng.normal(size=6)
    return body, frame, V, object_motion(body, frame, V, np.arange(6.0))


@cases
def test_matrices(scale, reach, seed):
    """M(C) as in the paper after (2.3); mobility and factors are its inverse."""
    body, frame, _, o = drawn(scale, reach, seed)
    p = frame.R @ body.com
    px = np.array([np.cross(p, e) for e in np.eye(3)]).T
    I = frame.R @ body.inertia @ frame.R.T - body.mass * px @ px
    M = np.block([[I, body.mass * px], [-body.mass * px, body.mass * np.eye(3)]])
    assert relative_gap(o.inertia.dense() / scale, M / scale) < 1e-13
    np.testing.assert_array_equal(o.free.centre, p)
    assert min(o.free.D) > 0
    factored = sum(d * np.outer(x, x) for d, x in zip(o.free.D, o.free.w, strict=True))
    assert relative_gap(factored * scale, o.free.mobility.dense() * scale) < 1e-13
    at_C = o.free.mobility.mobility_shifted(-p).dense()
    assert relative_gap(at_C * scale, o.mobility.dense() * scale) < 1e-13
    np.testing.assert_allclose(o.inertia.dense() @ o.mobility.dense(), np.eye(6), atol=1e-11)


@cases
def test_free_motion(scale, reach, seed):
    """-M(C)^-1 b(C): the mass centre does not accelerate, and Euler's equations hold."""
    body, frame, V, o = drawn(scale, reach, seed)
    p, w, alpha = frame.R @ body.com, V[:3], o.free_acceleration
    centre = alpha[3:] + np.cross(alpha[:3], p) + np.cross(w, np.cross(w, p))
    np.testing.assert_allclose(centre, 0, atol=1e-13 * reach * 10)
    I = frame.R @ body.inertia @ frame.R.T / scale
    np.testing.assert_allclose(I @ alpha[:3], -np.cross(w, I @ w), atol=1e-12)
    assert relative_gap(o.inertia.apply(alpha) / scale, -o.bias / scale) < 1e-12
    np.testing.assert_array_equal(o.wrench, np.arange(6.0))
    assert relative_gap(o.free.wrench, [*(np.arange(3.0) - np.cross(p, np.arange(3.0, 6.0))), 3, 4, 5]) < 1e-14
    np.testing.assert_array_equal(o.free.at_rest().wrench, np.zeros(6))


@pytest.mark.parametrize("seed", range(5))
def test_symmetric_inverse(seed):
    """Inverse by cofactors."""
    X = np.random.default_rng(seed).normal(size=(3, 5))
    np.testing.assert_allclose(symmetric_inverse(X @ X.T) @ (X @ X.T), np.eye(3), atol=1e-10)
