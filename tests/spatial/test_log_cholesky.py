"""Ten free numbers for a body: possible whatever they are, and all possible bodies are among them."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.spatial.differentiation import gradient, linearised
from holdfast.spatial.inertia import of_parameters
from holdfast.spatial.log_cholesky import inertia_of, numbers_of


@pytest.mark.parametrize("seed", range(20))
def test_points_of_mass(seed):
    """A cloud of points: the numbers of its inertia bring it back, to rounding."""
    rng = np.random.default_rng(seed)
    masses, places = rng.uniform(0.1, 1.0, 6), rng.normal(size=(6, 3)) * rng.uniform(0.01, 1.0, 3)
    second = np.einsum("k,ki,kj->ij", masses, places, places)
    I = np.trace(second) * np.eye(3) - second
    parameters = np.concatenate([[masses.sum()], masses @ places, I[np.triu_indices(3)]])
    numbers = numbers_of(of_parameters(parameters))
    assert np.exp(2 * numbers[0]) == pytest.approx(masses.sum(), rel=1e-14)
    assert numbers[7:] == pytest.approx(masses @ places / masses.sum(), rel=1e-12)
    assert np.abs(inertia_of(numbers).parameters - parameters).max() < 1e-12 * np.abs(parameters).max()


@pytest.mark.parametrize("seed", range(20))
def test_whatever_they_are(seed):
    """Any ten numbers are a body that the model takes as physical, and come back."""
    numbers = np.random.default_rng(seed).normal(size=10)
    body = inertia_of(numbers)
    c = body.h / body.m
    hf.HeldObject(body.m, body.I - body.m * (c @ c * np.eye(3) - np.outer(c, c)), c)
    assert np.abs(numbers_of(body) - numbers).max() < 1e-9


def test_gradient():
    """By central differences of eighth order."""
    rng = np.random.default_rng(1)
    numbers, weights = 0.5 * rng.normal(size=10), rng.normal(size=10)

    def text(x):
        return weights @ inertia_of(x).parameters

    (found,) = gradient(text, numbers)
    h, c = 1e-2, [4 / 5, -1 / 5, 4 / 105, -1 / 280]
    for k, unit in enumerate(np.eye(10)):
        slope = sum(w * (text(numbers + j * h * unit) - text(numbers - j * h * unit)) for j, w in enumerate(c, 1)) / h
        assert found[k] == pytest.approx(slope, rel=1e-10, abs=1e-11)


def test_one_to_one():
    """The change of parameters by the numbers is a matrix that can be inverted."""
    made = linearised(lambda x: (inertia_of(x).parameters,), np.zeros(10))
    assert np.linalg.matrix_rank(np.array([made.rates(unit)[0] for unit in np.eye(10)])) == 10


@pytest.mark.parametrize("moments", [[1.0, 1.0, 2.0], [1.0, 1.0, 3.0], [-1.0, 1.0, 1.0]])
def test_what_no_body_has(moments):
    """A flat plate, and worse, has no such numbers."""
    with pytest.raises(ValueError, match="expected"):
        numbers_of(of_parameters(np.array([1.0, 0, 0, 0, moments[0], 0, 0, moments[1], 0, moments[2]])))
