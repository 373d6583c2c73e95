"""The held object: a body with mass and inertia."""

import numpy as np
import pytest

from holdfast import HeldObject, ModelError

REFUSED = {
    "no mass": ({"mass": 0.0}, r"object: mass: expected > 0, got 0.0"),
    "mass inf": ({"mass": np.inf}, r"object: mass: expected finite"),
    "com": ({"com": [0, 0, 0, 0]}, r"object: com: expected shape \(3,\), got shape \(4,\)"),
    "semidefinite": (
        {"inertia": np.diag([0.0, 1, 1])},
        r"object: inertia: expected principal moments > 0, got 0, 1, 1",
    ),
    "negative": ({"inertia": -np.eye(3)}, r"object: inertia: expected principal moments >= 0"),
    "asymmetric": ({"inertia": np.tri(3)}, r"object: inertia: expected a symmetric matrix"),
    "triangle": ({"inertia": np.diag([1, 1, 3])}, r"object: inertia: no mass distribution"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused(what):
    """An object that cannot exist is refused by field."""
    given, message = REFUSED[what]
    with pytest.raises(ModelError, match=message):
        HeldObject(**{"mass": 1.0, "inertia": np.eye(3), **given})


def test_box():
    """m/12 (y^2 + z^2) about x, the mass centre in C."""
    box = HeldObject.box(12.0, 1.0, 2.0, 3.0)
    np.testing.assert_array_equal(box.inertia, np.diag([13.0, 10.0, 5.0]))
    np.testing.assert_array_equal(box.com, np.zeros(3))


def test_accepted_and_frozen():
    """Unphysical moments where asked for; arrays are read-only."""
    body = HeldObject(1.0, np.diag([1.0, 1.0, 3.0]), [0, 0, 1], physical=False)
    for array in (body.com, body.inertia):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    np.testing.assert_allclose(body.spatial_inertia.I, np.diag([2.0, 2.0, 3.0]))
