"""Impacts: energy is never gained, nothing approaches afterwards, and a ball rebounds as it should."""

import numpy as np
import pytest
from benchmarks.contact_bars import drawn

from holdfast.dynamics.contact.collision import impact
from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.errors import StateError
from tests.dynamics.contact.test_contact_forces import rows_at


def test_a_ball_rebounds():
    """Along the normal with e times the speed; a fast slip loses mu times the normal impulse."""
    P = np.diag([1 / 0.004] * 3 + [1.0] * 3)
    C = rows_at([(0.0, 0.0, -0.1)])
    twist = np.array([0.0, 0.0, 0.0, 5.0, 0.0, -2.0])
    found = impact(P, C, C @ twist, [0.2], [0.6])
    np.testing.assert_allclose((twist + found.change)[3:], [5.0 - 0.2 * 3.2, 0.0, 1.2], atol=1e-12)
    assert found.energy_change == pytest.approx(found.wrench @ (twist + 0.5 * found.change), rel=1e-12)
    assert impact(P, C, C @ -twist, [0.2], [0.6]).rounds == 0


@pytest.mark.slow
def test_energy_is_never_gained():
    """Any coefficients, friction and number of contacts: the kinetic energy does not grow, and nothing approaches."""
    rng = np.random.default_rng(4)
    for i in range(24):
        k = 1 + i % 4
        P, C, u, mu = drawn(rng, k, 1.0)
        found = impact(P, C, u, mu, rng.uniform(0.0, 1.0, k))
        V = np.linalg.lstsq(C.reshape(-1, 6), u.ravel(), rcond=None)[0]
        change = found.wrench @ (V + 0.5 * found.change)
        assert change <= 1e-12 * abs(found.wrench @ found.change)
        assert change == pytest.approx(found.energy_change, rel=1e-6, abs=1e-9 * abs(found.wrench @ found.change))
        assert found.velocity[:, 2].min() >= -1e-10 * np.abs(u).max()
        assert found.impulse[:, 2].min() >= 0.0
        assert found.status not in (ContactStatus.JAMMED, ContactStatus.UNRESOLVED)


def test_equal_coefficients_keep_their_share():
    """With e = 1 and without friction, the energy stays."""
    rng = np.random.default_rng(6)
    P, C, u, _ = drawn(rng, 1, 1.0)
    u = np.abs(u) * [1.0, 1.0, -1.0]
    assert impact(P, C, u, [0.0], [1.0]).energy_change == pytest.approx(0.0, abs=1e-12)


def test_refusals():
    """A coefficient of restitution is a number from 0 to 1."""
    with pytest.raises(StateError, match="restitution"):
        impact(np.eye(6), rows_at([(0, 0, 0)]), np.zeros((1, 3)), [0.1], [1.5])
