"""What a caller gives becomes read-only float arrays, or is refused by name."""

import numpy as np
import pytest

from holdfast import ModelError, StateError
from holdfast.model import checks
from holdfast.spatial import rotation

TURN = rotation.exp(np.array([0.3, -0.4, 1.2]))


class Traced:
    """A stand-in for a scalar of which only the expression is known."""

    def where(self, a, b):
        """Mark it as one."""


NO_VECTORS = {
    "text": "123",
    "bytes": b"123",
    "texts": ["1", "2", "3"],
    "a text": [1, 2, "3"],
    "a gap": [1, None, 3],
    "complex": [1j, 2, 3],
    "complex array": np.array([1j, 2, 3]),
    "dates": np.array(["2020-01-01"] * 3, dtype="M8[D]"),
    "beyond float64": [10**400, 0, 0],
    "ragged": [[1], [1, 2]],
    "set": {1, 2, 3},
    "dict": {},
    "nan": [np.nan, 0, 0],
    "inf": [np.inf, 0, 0],
    "short": [1, 2],
    "number": 5,
    "nothing": None,
}


@pytest.mark.parametrize("kind", NO_VECTORS)
def test_no_vector(kind):
    """Texts, complex numbers, dates, huge integers, ragged lists, NaN: refused on one line, not converted."""
    with pytest.raises(StateError, match=r"^state: v: expected [^\n]*$"):
        checks.numbers(NO_VECTORS[kind], (3,), "state: v", StateError)


def test_vectors():
    """Integers, booleans and other floats become float64; the result is a read-only copy."""
    given = np.array([1.0, 2.0, 3.0])
    for value in ([1, 2, 3], (1, 2.0, 10**30), np.float32([1, 2, 3]), given):
        a = checks.numbers(value, (3,), "v")
        assert (a.dtype, a.shape, a.flags.writeable) == (np.dtype(float), (3,), False)
        assert a is not value
    assert given.flags.writeable


def test_traced_scalars_pass():
    """Arrays that hold traced scalars keep them; plain objects beside them are not converted."""
    node = Traced()
    a = checks.numbers([node, 1, 2.0], (3,), "v")
    assert a.dtype == object
    assert a[0] is node


@pytest.mark.parametrize(
    ("value", "bounds", "message"),
    [
        ("1.5", {}, "m: expected a number, got '1.5'"),
        ([1.0], {}, "m: expected shape (), got shape (1,)"),
        (np.nan, {}, "m: expected finite numbers, got nan"),
        (-1.0, {"at_least": 0.0}, "m: expected >= 0, got -1.0"),
        (0.0, {"above": 0.0}, "m: expected > 0, got 0.0"),
    ],
)
def test_no_number(value, bounds, message):
    """A number is one finite real number within its bounds."""
    with pytest.raises(ModelError) as caught:
        checks.number(value, "m", **bounds)
    assert str(caught.value) == message


@pytest.mark.parametrize("entry", [1e200, -1e308])
def test_huge_entries_do_not_warn(entry):
    """Overflow inside a check is part of the refusal, not a warning."""
    matrix = np.eye(3)
    matrix[0, 1] = entry
    for check in (checks.rotation_matrix, checks.symmetric_matrix, checks.rotational_inertia):
        with pytest.raises(ModelError, match="expected a"):
            check(matrix, "R")
    with pytest.raises(ModelError, match="expected a unit vector"):
        checks.unit_vector([entry, 0.0, 0.0], "axis")
    with pytest.raises(ModelError, match="expected a unit quaternion"):
        checks.pose([entry, 0, 0, 0, 0, 0, 0], "pose")


def test_huge_inertias_are_inertias():
    """The largest doubles do not overflow while they are made symmetric."""
    J = checks.rotational_inertia(1.5e308 * np.eye(3), "inertia")
    np.testing.assert_array_equal(J, 1.5e308 * np.eye(3))


def test_mended_values_are_read_only():
    """What was off by rounding is made exact, and may not be written either."""
    R = checks.rotation_matrix(np.round(TURN, 8), "R")
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
    axis = checks.unit_vector(np.round(TURN[0], 8), "axis")
    assert np.linalg.norm(axis) == pytest.approx(1.0, abs=1e-15)
    assert not R.flags.writeable
    assert not axis.flags.writeable


def test_mirrors_are_no_rotations():
    """R^T R = 1 is not enough."""
    with pytest.raises(ModelError, match=r"det R = -1"):
        checks.rotation_matrix(np.diag([1.0, 1.0, -1.0]), "R")


def test_triangle_inequality():
    """A rod and a lamina are the limits; beyond them no mass distribution has such moments."""
    checks.rotational_inertia(np.diag([0.0, 1.0, 1.0]), "rod")
    checks.rotational_inertia(TURN @ np.diag([1.0, 2.0, 3.0]) @ TURN.T, "lamina")
    impossible = TURN @ np.diag([1.0, 2.0, 3.1]) @ TURN.T
    with pytest.raises(ModelError, match=r"no mass distribution has principal moments 1, 2, 3\.1"):
        checks.rotational_inertia(impossible, "body")
    checks.rotational_inertia(impossible, "body", physical=False)
