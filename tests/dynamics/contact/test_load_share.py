"""How redundant contacts share a load: within their cones wherever some share is, with the same effect."""

import numpy as np

from holdfast.dynamics.contact.load_share import within_cones


def test_a_share_that_exists_is_found():
    """Loads made of forces inside the cones of four points: the share has the same effect and lies in the cones."""
    rng, left_cones = np.random.default_rng(0), 0
    for _ in range(100):
        places, mu = rng.uniform(-0.2, 0.2, (4, 3)), rng.uniform(0.1, 0.8, 4)
        places[:, 2] = -0.1
        D = np.array([np.concatenate([np.cross(l, t), t]) for l in places for t in np.eye(3)])
        known = np.column_stack([rng.uniform(-0.7, 0.7, (4, 2)) * mu[:, None], np.ones(4)]) * rng.uniform(
            0.1, 1, (4, 1)
        )
        load = D.T @ known.ravel()
        least = np.linalg.lstsq(D.T, load, rcond=None)[0]
        found = within_cones(np.repeat(np.arange(4), 3), D, mu, np.ones(4, bool), least)
        np.testing.assert_allclose(D.T @ found, load, atol=1e-12)
        left_cones += int((_left(mu, least) < 0.0).any())
        assert _left(mu, found).min() >= 0.0
    assert left_cones > 20


def test_many_at_once():
    """Loads of contacts in the same modes, sliding ones among them, are shared together as alone, bit by bit."""
    rng = np.random.default_rng(1)
    of, sticks = np.r_[np.repeat([0, 2, 3], 3), 5, 7], np.array([1, 0, 1, 1, 0, 0, 0, 0], dtype=bool)
    mu = np.array([0.4, 0.0, 0.1, 0.0, 0.5, 0.3, 0.2, 0.2])
    D = rng.normal(size=(20, len(of), 6))
    x = rng.normal(size=(20, len(of)))
    together = within_cones(of, D, mu, sticks, x)
    assert np.abs(together - x).max() > 0.1
    for k in range(20):
        assert within_cones(of, D[k], mu, sticks, x[k]).tobytes() == together[k].tobytes()
        np.testing.assert_allclose(D[k].T @ together[k], D[k].T @ x[k], atol=1e-12)


def _left(mu, x):
    """Return what friction leaves of each contact [N]."""
    x = x.reshape(4, 3)
    return mu * x[:, 2] - np.linalg.norm(x[:, :2], axis=1)
