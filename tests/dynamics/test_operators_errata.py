"""Equations that are wrong in print: they fail as printed and hold as corrected."""

import numpy as np
import pytest

from tests.dynamics.aggregate import aggregate
from tests.dynamics.problems import relative_gap

WRONG, RIGHT = 1e-3, 1e-12


def bracket(o, f=None):
    """Return T' - H psi (S L T' + B f)."""
    return o.T1 - o.H @ o.psi @ (o.S @ o.L @ o.T1 + (0 if f is None else o.B @ f))


def bias_bracket(o):
    """Return T - H psi (S L T + M phi^T a + b)."""
    return o.T - o.H @ o.psi @ (o.S @ o.L @ o.T + o.M @ o.phi.T @ o.a + o.b)


# equation: (truth, as printed, as corrected)
ROWS = {
    "(5.13) inverse for transpose": lambda o: (
        o.free,
        np.linalg.inv(o.K) @ o.D1 @ bias_bracket(o),
        o.K.T @ o.D1 @ bias_bracket(o),
    ),
    "(6.11g) sign": lambda o: (
        -o.Ms1 @ o.J.T @ o.f,
        o.K.T @ o.D1 @ o.H @ o.psi @ o.B @ o.f,
        -o.K.T @ o.D1 @ o.H @ o.psi @ o.B @ o.f,
    ),
    "(6.18e) transpose": lambda o: (
        o.Ms1 @ (o.T1 - o.J.T @ o.f),
        o.K @ o.D1 @ bracket(o, o.f),
        o.K.T @ o.D1 @ bracket(o, o.f),
    ),
}

# products that do not even fit as printed: letters in order, as printed and as corrected
SHAPES = {
    "example after (5.1): V(0) = B^T H^T phi^T qd": ("BT HT phiT qd", "BT phiT HT qd"),
    "(6.5a): H is missing": ("KT D1 psi B f", "KT D1 H psi B f"),
}


def product(o, letters: str):
    """Return the product of the named operators; T after a name transposes."""
    named = {**vars(o), "qd": np.concatenate([arm.given.qd[::-1] for arm in o.arms])}
    result = None
    for letter in letters.split():
        matrix = named[letter[:-1]].T if letter.endswith("T") else named[letter]
        result = matrix if result is None else result @ matrix
    return result


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("row", ROWS)
def test_wrong_in_print(row, seed):
    """The printed equation misses the truth, the corrected one meets it."""
    truth, printed, corrected = ROWS[row](aggregate(seed))
    assert relative_gap(printed, truth) > WRONG
    assert relative_gap(corrected, truth) < RIGHT


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("row", SHAPES)
def test_not_conformable_in_print(row, seed):
    """The printed product cannot be formed; the corrected one is J qd, or M^-1 J^T f."""
    o = aggregate(seed)
    printed, corrected = SHAPES[row]
    with pytest.raises(ValueError, match="matmul"):
        product(o, printed)
    qd = np.concatenate([arm.given.qd[::-1] for arm in o.arms])
    truth = o.J @ qd if corrected.endswith("qd") else o.Ms1 @ o.J.T @ o.f
    assert relative_gap(product(o, corrected), truth) < RIGHT
