"""Programs in phases."""

import numpy as np

from holdfast.compiler.interpret import interpret
from tests.compiler.schedules import stage

A, B, C = np.array([0.5, -1.25]), np.array([3.0]), np.array([[1.0, 2.0], [-0.5, 4.0]])


def function(a, b, c):
    """What is known of a comes first, what b adds next."""
    s = np.sin(a)
    t = s * b[0]
    return s @ a, 2.0, c @ t, t


def test_stage():
    """Ports by phase; each piece has what was known by then and the memories before it."""
    made = stage("three", function, [{"a": (2,)}, {"b": (1,)}, {"c": (2, 2)}], [("aa", "two"), (), ("ct", "t")])
    assert made.input_ports == ("a", "b", "c")
    assert made.outputs == ({"aa": (), "two": ()}, {}, {"ct": (2,), "t": (2,)})
    assert made.shapes == {"a": (2,), "b": (1,), "c": (2, 2), "aa": (), "two": (), "ct": (2,), "t": (2,)}
    assert [made.size(port) for port in ("a", "c", "aa")] == [2, 4, 1]
    first, second, third = made.pieces.programs
    nothing = np.full(1, np.nan), np.full((2, 2), np.nan)
    aa, two, sines = interpret(first, A, *nothing, fused=False)
    (t,) = interpret(second, A, B, nothing[1], sines, fused=False)
    ct, same, none = interpret(third, np.full(2, np.nan), nothing[0], C, sines, t, fused=False)
    expected = interpret(made.program, A, B, C, fused=False)
    for found, x in zip((aa, two, ct, same), expected, strict=True):
        assert np.array_equal(found, x)
    np.testing.assert_allclose(ct, C @ (np.sin(A) * B), rtol=1e-14)
    assert sines.shape == t.shape == (2,) and none.shape == (0,)
