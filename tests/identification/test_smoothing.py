"""Smoothing splines: the noise that was added, derivatives near the true ones, deviations that tell how near."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.identification.smoothing import encoder_step, smoothing_spline


def moved(t: np.ndarray) -> list[np.ndarray]:
    """Return a position with its two derivatives."""
    size, f, phase = np.array([[0.3], [0.1]]), np.array([[3.0], [5.1]]), np.array([[0.0], [1.0]])
    x = f * t + phase
    return [part.sum(axis=0) for part in (size * np.sin(x), size * f * np.cos(x), -size * f**2 * np.sin(x))]


@pytest.mark.parametrize(("rate", "noise"), [(100.0, 1e-4), (100.0, 1e-3), (1000.0, 1e-4)])
def test_noise_is_found_and_smoothed(rate, noise):
    t = np.arange(0.0, 6.0, 1.0 / rate)
    x, v, a = moved(t)
    found = smoothing_spline(t, x + noise * np.random.default_rng(1).normal(size=len(t)))
    assert found.noise == pytest.approx(noise, rel=0.1)
    inner = slice(len(t) // 10, -len(t) // 10)
    for k, true in enumerate((x, v, a)):
        rows = found.evaluations[k][[len(t) // 2]].toarray().T
        expected = float(np.sqrt(found.covariance(rows)[0, 0]))
        error = float(np.sqrt(((found.values[k] - true)[inner] ** 2).mean()))
        assert 0.2 * expected < error < 1.5 * expected, k
    assert abs(float((found.values[2] - a) @ found.values[2])) < 0.01 * float(a @ a)  # not drawn towards zero


def test_steps_of_an_encoder():
    """Steps are seen, and count as noise of a twelfth of their square, even where the joint hardly moves."""
    t = np.arange(0.0, 5.0, 0.005)
    z = 1e-4 * np.round(1e3 * np.sin(1.6 * np.pi * t))
    assert encoder_step(z) == pytest.approx(1e-4)
    assert smoothing_spline(t, z).noise == pytest.approx(1e-4 / np.sqrt(12.0), rel=0.1)
    slow = 1e-4 * np.round(2.0 * np.sin(t))
    assert smoothing_spline(t, slow).noise >= 0.999e-4 / np.sqrt(12.0)
    assert encoder_step(np.sin(t)) == 0.0


def test_exact_positions_are_interpolated():
    t = np.arange(0.0, 3.0, 0.01)
    x, v, a = moved(t)
    found = smoothing_spline(t, x)
    assert found.noise < 1e-10
    for k, (true, bound) in enumerate(((x, 1e-11), (v, 1e-9), (a, 1e-7))):
        assert np.abs(found.values[k] - true)[20:-20].max() < bound, k


def test_a_joint_that_stands_still():
    t = np.arange(0.0, 1.0, 0.01)
    found = smoothing_spline(t, np.full(len(t), 0.7))
    assert found.noise == 0.0
    assert np.abs(found.values[0] - 0.7).max() < 1e-14 and not found.values[1:].any()


def test_unequal_times_and_few_samples():
    rng = np.random.default_rng(2)
    for count in (8, 9, 12, 200):
        t = np.cumsum(rng.uniform(0.005, 0.02, count))
        x, v, _ = moved(t)
        found = smoothing_spline(t, x)
        assert np.abs(found.values[0] - x).max() < 5 * found.noise + 1e-9
        assert np.abs(found.values[1] - v).max() < 0.05


@pytest.mark.parametrize("lost", [0.3, 1.5, 4.0])
def test_a_gap(lost):
    """Knots over a gap have no samples, and little smoothing leaves their matrix singular: more is taken instead."""
    t = np.arange(0.0, 5.0, 0.05)
    t = t[(t < 0.4) | (t > 0.4 + lost)]
    x, v, _ = moved(t)
    found = smoothing_spline(t, x)
    beside = (t < 0.3) | (t > 0.5 + lost)
    assert np.abs(found.values[0] - x).max() < 5 * found.noise + 1e-9 < 1e-4
    assert np.abs(found.values[1] - v)[beside].max() < 0.05


def test_a_motion_that_rests_and_swings():
    """One lambda flattens a short swing and leaves noise in the rests: the second fit does neither."""
    t = np.arange(0.0, 4.0, 0.01)
    u = (t - 2.0) / 0.15
    x, a = np.exp(-0.5 * u * u), (u * u - 1.0) / 0.15**2 * np.exp(-0.5 * u * u)
    squares, claimed = [], []
    for seed in range(5):
        found = smoothing_spline(t, x + 1e-3 * np.random.default_rng(seed).normal(size=len(t)))
        assert found.noise == pytest.approx(1e-3, rel=0.1)
        squares.append((found.values[2] - a) ** 2)
        claimed.append(np.diag(found.covariance(found.evaluations[2].toarray().T)))
    swing, rest = np.abs(u) < 3.0, np.abs(u) > 6.0
    error, said = np.mean(squares, axis=0), np.mean(claimed, axis=0)
    assert np.sqrt(error.mean()) < 0.27 and np.sqrt(error[rest].mean()) < 0.25  # 0.36 and 0.41 with one lambda
    for part in (swing, rest):
        assert 0.2 < error[part].mean() / said[part].mean() < 1.5
