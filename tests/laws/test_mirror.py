"""A mirrored system moves as the mirror image: moments and angular velocities are axial vectors."""

import numpy as np
import pytest

from tests.dynamics.problems import relative_gap
from tests.laws.systems import mixed, sample, solved
from tests.laws.transformed import both, mirrored
from tests.systems.random_parts import unit_vector

TOLERANCE = 1e-10


def mirrored_rates(p, S, W_dot) -> np.ndarray:
    """Return contact rates in the image: hinge as it was, soft finger's second sign turned, ball -S."""
    result = np.array(W_dot)
    for name, part in p.chain.contact_freedoms.items():
        kind = p.chain.grasps[name].kind
        if kind == "softfinger":
            result[part] = W_dot[part] * [1.0, -1.0]
        if kind == "ball":
            result[part] = -S @ W_dot[part]
    return result


@pytest.mark.parametrize("make", [sample, mixed])
@pytest.mark.parametrize("seed", range(12))
def test_mirror(make, seed):
    """Joint accelerations are the same, forces are reflected, moments reflected with another sign."""
    p, result = make(seed)
    image, S = mirrored(p, unit_vector(np.random.default_rng(seed)))
    got = solved(image)
    assert relative_gap(got.qdd, result.qdd) < TOLERANCE
    assert relative_gap(got.grasp_wrench, both(-S, S, result.grasp_wrench)) < TOLERANCE
    assert relative_gap(got.base_wrench, both(-S, S, result.base_wrench)) < TOLERANCE
    assert relative_gap(got.object_acceleration, both(-S, S, result.object_acceleration)) < TOLERANCE
    rates = mirrored_rates(p, S, result.contact_acceleration)
    assert relative_gap(got.contact_acceleration, rates) < TOLERANCE
    assert (got.rank, got.mobility, got.status) == (result.rank, result.mobility, result.status)


@pytest.mark.parametrize("seed", range(4))
def test_without_the_sign_it_fails(seed):
    """Reflecting moments like forces is wrong: the law has teeth."""
    p, result = mixed(seed)
    image, S = mirrored(p, np.array([0.0, 1.0, 0.0]))
    assert relative_gap(solved(image).base_wrench, both(S, S, result.base_wrench)) > 0.1
