"""Appendices A and B, (a.1)-(a.10) and (b.1)-(b.14), corrected where the print is wrong."""

import numpy as np
import pytest

from tests.dynamics.closed.answered import nonrigid
from tests.systems.problems import relative_gap

SEEDS = range(5)
TOLERANCE = 1e-11


def G1(o):
    """Return (b.4c), (b.9a): it holds -J M^-1 C."""
    return o.A @ o.MC1 @ o.b + o.Jdot_qd + o.g - o.a - o.J @ o.M1 @ o.C


def HOH(o):
    """Return H Omega^-1 H^T."""
    return o.HT.T @ o.Omega1 @ o.HT


def Pi(o):
    """Return (b.7b), (b.9c)."""
    return o.Omega1 - o.Omega1 @ o.HT @ np.linalg.solve(HOH(o), o.HT.T @ o.Omega1)


def G2(o, sign=-1.0):
    """Return (b.11); the print has +J M^-1 C."""
    return o.HT.T @ o.Omega1 @ ((o.A @ o.MC1 @ o.A.T @ Pi(o) - o.I6) @ G1(o) + sign * o.J @ o.M1 @ o.C)


def G3(o):
    """Return (b.13)."""
    return -o.J.T @ o.Omega1 @ G1(o) - o.C


def JMT(o):
    """Return J M^-1 T."""
    return o.J @ o.M1 @ o.T


def alpha_minus(o):
    """Return the contact accelerations on the object's side (a.10)."""
    return o.A @ o.alpha_C + o.a


EQUATIONS = {
    "(a.1), (a.5), (a.6)": lambda o: (o.A @ o.VC, o.V0 + o.HT @ o.W),
    "(a.7), (b.1c)": lambda o: (np.zeros(o.HT.shape[1]), o.HT.T @ o.f),
    "(a.8), (b.1f)": lambda o: (alpha_minus(o), o.alpha0 + o.HT @ o.W_dot + o.g),
    "(b.1a)": lambda o: (o.T, o.M @ o.qdd + o.C + o.J.T @ o.f),
    "(b.1b)": lambda o: (o.MC @ o.alpha_C + o.b, o.A.T @ o.f),
    "(b.2)": lambda o: (o.alpha0, o.J @ o.M1 @ (o.T - o.J.T @ o.f - o.C) + o.Jdot_qd),
    "(b.3)": lambda o: (alpha_minus(o), o.A @ o.MC1 @ o.A.T @ o.f - o.A @ o.MC1 @ o.b + o.a),
    "(b.4b)": lambda o: (o.Omega @ o.f, JMT(o) + o.HT @ o.W_dot + G1(o)),
    "(b.5a)": lambda o: (HOH(o) @ o.W_dot, -o.HT.T @ o.Omega1 @ (JMT(o) + G1(o))),
    "(b.5b), (b.6a), (b.9f)": lambda o: (o.W_dot, -np.linalg.solve(HOH(o), o.HT.T @ o.Omega1 @ (JMT(o) + G1(o)))),
    "(b.6b)": lambda o: (o.f, o.Omega1 @ (JMT(o) + o.HT @ o.W_dot + G1(o))),
    "(b.7a), (b.9d)": lambda o: (o.f, Pi(o) @ (JMT(o) + G1(o))),
    "(b.8), (b.9e)": lambda o: (
        o.qdd,
        (o.M1 - o.M1 @ o.J.T @ Pi(o) @ o.J @ o.M1) @ o.T - o.M1 @ o.J.T @ Pi(o) @ G1(o) - o.M1 @ o.C,
    ),
    "before (b.10), i": lambda o: (
        o.HT @ o.W_dot + o.J @ o.qdd,
        o.A @ o.MC1 @ o.A.T @ o.f - G1(o) - o.J @ o.M1 @ o.C,
    ),
    "(b.10)": lambda o: (
        HOH(o) @ o.W_dot + o.HT.T @ o.Omega1 @ o.J @ o.qdd,
        o.HT.T @ o.Omega1 @ o.A @ o.MC1 @ o.A.T @ Pi(o) @ JMT(o) + G2(o),
    ),
    "(b.12)": lambda o: (
        o.M @ o.qdd + o.J.T @ o.Omega1 @ o.HT @ o.W_dot,
        o.T - o.J.T @ o.Omega1 @ JMT(o) + G3(o),
    ),
    "(b.14)": lambda o: (
        coefficients(o) @ np.r_[o.W_dot, o.qdd],
        np.r_[
            o.HT.T @ o.Omega1 @ o.A @ o.MC1 @ o.A.T @ Pi(o) @ JMT(o) + G2(o),
            o.T - o.J.T @ o.Omega1 @ JMT(o) + G3(o),
        ],
    ),
    "Pi = K^T (K Omega K^T)^-1 K": lambda o: (
        Pi(o),
        o.stacked.K.T @ np.linalg.solve(o.stacked.K @ o.Omega @ o.stacked.K.T, o.stacked.K),
    ),
}


def coefficients(o):
    """Return the matrix of (b.14)."""
    return np.block([[HOH(o), o.HT.T @ o.Omega1 @ o.J], [o.J.T @ o.Omega1 @ o.HT, o.M]])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("equation", EQUATIONS)
def test_equation(equation, seed):
    """Both sides of one equation are the same numbers, with the oracle's accelerations and forces."""
    left, right = EQUATIONS[equation](nonrigid(seed))
    assert relative_gap(right, left) < TOLERANCE


@pytest.mark.parametrize("seed", SEEDS)
def test_last_system_is_singular(seed):
    """(b.14) has nullity max(0, contact freedoms - 6): it must not be used to solve (errata)."""
    o = nonrigid(seed)
    matrix = coefficients(o)
    size = np.sqrt(np.abs(np.diag(matrix)))
    sizes = np.linalg.svd(matrix / np.outer(size, size), compute_uv=False)
    assert int((sizes < 1e-10 * sizes[0]).sum()) == max(0, len(o.W) - 6)


@pytest.mark.parametrize("seed", SEEDS)
def test_wrong_in_print(seed):
    """Errata: J for J^T in (b.4a), the sign of J M^-1 C in (b.10), (b.11) and (b.14) fail as printed."""
    o = nonrigid(seed)
    with pytest.raises(ValueError, match="matmul"):
        o.J @ o.M1 @ o.J
    left = o.HT @ o.W_dot + o.J @ o.qdd
    assert relative_gap(o.A @ o.MC1 @ o.A.T @ o.f - G1(o) + o.J @ o.M1 @ o.C, left) > 1e-3
    left = HOH(o) @ o.W_dot + o.HT.T @ o.Omega1 @ o.J @ o.qdd
    right = o.HT.T @ o.Omega1 @ o.A @ o.MC1 @ o.A.T @ Pi(o) @ JMT(o)
    assert relative_gap(right + G2(o, +1.0), left) > 1e-3
