"""The Runge-Kutta step and the rate of a rotation vector."""

import numpy as np
import pytest

from holdfast.simulation.rk4 import rk4_step, rotation_vector_rate
from holdfast.spatial import rotation


def test_exact_for_cubics():
    """A right-hand side that is a cubic in t is integrated exactly."""
    y = rk4_step(lambda t, y: np.array([4 * t**3 - 3 * t**2 + 1]), 0.3, np.array([2.0]), 0.7)
    assert y[0] == pytest.approx(2.0 + (1 - 1 + 1) - (0.3**4 - 0.3**3 + 0.3), abs=1e-15)


def test_known_first_stage_is_used():
    """The first derivative is not asked for again when it is given."""
    asked = []

    def derivative(t, y):
        asked.append(t)
        return -y

    given = rk4_step(derivative, 0.0, np.array([1.0]), 0.1, first=np.array([-1.0]))
    assert asked == [0.05, 0.05, 0.1]
    assert given == pytest.approx(rk4_step(derivative, 0.0, np.array([1.0]), 0.1), abs=0)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.999e-3, 1.001e-3, 0.5, 3.0, 6.0])
def test_rotation_vector_rate_turns_at_w(angle):
    """d/dt exp(u) = w~ exp(u) along the returned rate, for small and large u."""
    rng = np.random.default_rng(3)
    axis, w = rng.normal(size=(2, 3))
    u = angle * axis / np.linalg.norm(axis)
    rate, h = rotation_vector_rate(u, w), 1e-6
    turned = rotation.exp(u + h * rate) @ rotation.exp(u - h * rate).T
    assert rotation.log(turned) / (2 * h) == pytest.approx(w, abs=1e-8)


def test_spinning_frame_has_order_four():
    """A frame that turns about a moving axis: halving the step divides the error by 16."""

    def attitude(steps):
        R, h = np.eye(3), 1.0 / steps
        for k in range(steps):
            u = rk4_step(lambda t, u: rotation_vector_rate(u, np.array([np.sin(3 * t), 2.0, t])), k * h, np.zeros(3), h)
            R = rotation.exp(u) @ R
        return R

    exact = attitude(640)
    errors = [np.abs(attitude(n) - exact).max() for n in (10, 20, 40)]
    assert np.log2(errors[0] / errors[1]) > 3.8
    assert np.log2(errors[1] / errors[2]) > 3.8
