"""Links: physical bodies, massless ones included."""

import numpy as np
import pytest

from holdfast import Link, ModelError

REFUSED = {
    "negative mass": ({"mass": -0.1}, r"link 'forearm': mass: expected > 0, got -0.1"),
    "mass nan": ({"mass": np.nan}, r"link 'forearm': mass: expected finite"),
    "mass text": ({"mass": "heavy"}, r"link 'forearm': mass: expected a number"),
    "com": ({"com": [0, 0]}, r"link 'forearm': com: expected shape \(3,\), got shape \(2,\)"),
    "inertia shape": ({"inertia": [1, 1, 1]}, r"link 'forearm': inertia: expected shape \(3, 3\)"),
    "asymmetric": ({"inertia": np.eye(3) + np.eye(3, k=1)}, r"link 'forearm': inertia: expected a symmetric matrix"),
    "negative moment": (
        {"inertia": np.diag([1, 1, -0.1])},
        r"link 'forearm': inertia: expected principal moments >= 0",
    ),
    "triangle": ({"inertia": np.diag([1, 1, 2.1])}, r"link 'forearm': inertia: no mass distribution .*physical=False"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused(what):
    """A body that cannot exist is refused; the message names link, field and value."""
    given, message = REFUSED[what]
    with pytest.raises(ModelError, match=message):
        Link(**{"mass": 1.0, **given}, name="forearm")


def test_accepted():
    """Massless links, point masses, rods, and unphysical moments where asked for."""
    assert Link(0.0).mass == 0.0
    assert Link(1.0, inertia=np.diag([0.0, 1.0, 1.0])).inertia[1, 1] == 1.0
    assert Link(1.0, inertia=np.diag([1.0, 1.0, 2.1]), physical=False).inertia[2, 2] == 2.1


def test_frozen():
    """Arrays are read-only copies."""
    inertia = np.eye(3)
    link = Link(1, [0, 0, 1], inertia)
    inertia[0, 0] = 9.0
    assert link.inertia[0, 0] == 1.0
    for array in (link.com, link.inertia):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_spatial_inertia():
    """Steiner: about the origin the inertia grows by m (d^2 1 - d d^T)."""
    com = np.array([0.1, -0.2, 0.3])
    about = Link(2.0, com, np.diag([0.3, 0.4, 0.5])).spatial_inertia
    steiner = 2.0 * (com @ com * np.eye(3) - np.outer(com, com))
    np.testing.assert_allclose(about.I, np.diag([0.3, 0.4, 0.5]) + steiner, atol=1e-15)
    np.testing.assert_allclose(about.h, 2.0 * com)
    assert about.m == 2.0
