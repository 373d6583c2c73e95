"""Texts in phases, and the stages made of them."""

import numpy as np
import pytest

from holdfast.compiler.errors import CompileError
from holdfast.compiler.interpret import interpret
from holdfast.compiler.stage import stage
from holdfast.compiler.trace import trace, trace_phases

A, B, C = np.array([0.5, -1.25]), np.array([3.0]), np.array([[1.0, 2.0], [-0.5, 4.0]])


def three(a):
    """A text that keeps variables from phase to phase."""
    s = np.sin(a)
    (b,) = yield s @ a, 2.0
    t = s * b[0]
    (c,) = yield ()
    return c @ t, t


def at_once(a, b, c):
    """The same in one phase."""
    s = np.sin(a)
    aa = s @ a
    t = s * b[0]
    return aa, 2.0, c @ t, t


def test_phases():
    """Results come phase after phase, and are those of the text without them."""
    program, counts = trace_phases(three, [[(2,)], [(1,)], [(2, 2)]])
    assert counts == (2, 0, 2)
    assert program == trace(at_once, [(2,), (1,), (2, 2)])


def test_stage():
    """Ports by phase; each piece has what was known by then and the memories before it."""
    made = stage("three", three, [{"a": (2,)}, {"b": (1,)}, {"c": (2, 2)}], [("aa", "two"), (), ("ct", "t")])
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


def test_one_phase():
    """A plain function is a stage of one phase, and so is a generator that does not yield."""

    def unyielding(a):
        if a is None:
            yield
        return (a * 2.0,)

    plain = stage("plain", lambda a: (a * 2.0,), [{"a": (2,)}], [("b",)])
    assert plain.program == stage("unyielding", unyielding, [{"a": (2,)}], [("b",)]).program
    assert plain.pieces.memory == (0,)


def test_replaced_values():
    """A value that is replaced comes in under its name and leaves with a mark."""
    made = stage("count", lambda n: (n + 1.0,), [{"n": ()}], [("n'",)])
    assert made.shapes == {"n": (), "n'": ()}


@pytest.mark.parametrize(
    ("text", "phases", "message"),
    [
        (lambda a: (a,), 2, "expected a generator for 2 phases, got a plain function"),
        (three, 2, r"expected 2 phase\(s\), the text goes on"),
        (three, 4, r"expected 4 phase\(s\), the text ends after 3"),
        (three, 1, r"expected 1 phase\(s\), the text goes on"),
    ],
)
def test_wrong_number_of_phases(text, phases, message):
    """Both numbers are named."""
    shapes = [[(2,)], [(1,)], [(2, 2)], [(1,)]]
    with pytest.raises(CompileError, match=message):
        trace_phases(text, shapes[:phases])


def test_results_must_be_tuples():
    """In every phase."""

    def text(a):
        yield a
        return (a,)

    with pytest.raises(CompileError, match="tuple of arrays"):
        trace_phases(text, [[(2,)], []])


def test_misuse_in_a_later_phase_names_the_line():
    """As in the first one."""

    def text(a):
        (b,) = yield ()
        return (1.0 if b[0] > a[0] else 2.0,)

    line = text.__code__.co_firstlineno + 2
    with pytest.raises(CompileError) as caught:
        trace_phases(text, [[(2,)], [(1,)]])
    assert f"{__file__}:{line}: `return" in str(caught.value)
