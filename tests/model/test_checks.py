"""What a caller gives becomes read-only float arrays; `test_misuse` has what is refused."""

import numpy as np
import pytest

from holdfast import ModelError
from holdfast.model import checks
from holdfast.spatial import rotation

TURN = rotation.exp(np.array([0.3, -0.4, 1.2]))


class Traced:
    """A stand-in for a scalar of which only the expression is known."""

    def where(self, a, b):
        """Mark it as one."""


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


def test_triangle_inequality():
    """A rod and a lamina are the limits; beyond them no mass distribution has such moments."""
    checks.rotational_inertia(np.diag([0.0, 1.0, 1.0]), "rod")
    checks.rotational_inertia(TURN @ np.diag([1.0, 2.0, 3.0]) @ TURN.T, "lamina")
    impossible = TURN @ np.diag([1.0, 2.0, 3.1]) @ TURN.T
    with pytest.raises(ModelError, match=r"no mass distribution has principal moments 1, 2, 3\.1"):
        checks.rotational_inertia(impossible, "body")
    checks.rotational_inertia(impossible, "body", physical=False)


def test_did_you_mean():
    """The closest name is found in any case; long lists of names are cut, so that a message stays a line."""
    assert checks.did_you_mean("Q ARM1/Joint1", ["q arm1/joint1", "q arm1/joint2"]) == " Did you mean 'q arm1/joint1'?"
    assert checks.did_you_mean("x", ["left", "right"]) == " Known: left, right."
    assert checks.did_you_mean("x", []) == " Known: none."
    assert checks.did_you_mean("x", map(str, range(500))).endswith(", 39 and 460 more.")
