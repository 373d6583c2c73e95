"""Equations (2.7)-(4.9) of the paper, corrected where the print is wrong, against the oracle's answer.

The stacks of (2.2) and (2.3) are those of `Stacked`.
"""

import numpy as np
import pytest

from holdfast.dynamics.closed.omega import Omega, filtered_arms, omega_from_matrices, omega_recursive
from holdfast.errors import MethodNotApplicable
from holdfast.spatial.spatial_vector import shift_twist
from tests.dynamics.closed.answered import nonrigid, rigid
from tests.systems.problems import relative_gap

SEEDS = range(5)
TOLERANCE = 1e-11


def reduced(o):
    """Return the coefficient matrix of (2.14)."""
    return np.block([[o.M, o.J.T], [o.J, -o.A @ o.MC1 @ o.A.T]])


def full(o):
    """Return the coefficient matrix of (2.11): first row [0, J, -A] (errata)."""
    l6, n = o.J.shape
    zero = np.zeros
    return np.block(
        [
            [zero((l6, l6)), o.J, -o.A],
            [o.J.T, o.M, zero((n, 6))],
            [-o.A.T, zero((6, n)), o.MC],
        ]
    )


def inverse(o):
    """Return the right side of (3.5a)."""
    MJO = o.M1 @ o.J.T @ o.Omega1
    return np.block([[o.M1 - MJO @ o.J @ o.M1, MJO], [MJO.T, -o.Omega1]])


def given(o):
    """Return col(T', a'(C))."""
    return np.r_[o.T1, o.a1]


def answer(o):
    """Return col(qdd, f)."""
    return np.r_[o.qdd, o.f]


def delta_alpha(o):
    """Return (4.6)."""
    return o.A @ o.MC1 @ o.A.T @ o.f - o.A @ o.MC1 @ o.b + o.a - o.alpha_f


EQUATIONS = {
    "(2.7a)": lambda o: (o.V0, o.A @ o.VC),
    "(2.7b)": lambda o: (o.alpha0, o.A @ o.alpha_C + o.a),
    "(2.8a)": lambda o: (o.VC, np.linalg.solve(o.A.T @ o.A, o.A.T @ o.V0)),
    "(2.8b)": lambda o: (o.alpha_C, np.linalg.solve(o.A.T @ o.A, o.A.T @ (o.alpha0 - o.a))),
    "(2.9), (2.10c)": lambda o: (o.MC @ o.alpha_C + o.b, o.A.T @ o.f),
    "(2.10a)": lambda o: (o.T, o.M @ o.qdd + o.C + o.J.T @ o.f),
    "(2.11)": lambda o: (np.r_[o.a - o.Jdot_qd, o.T - o.C, -o.b], full(o) @ np.r_[o.f, o.qdd, o.alpha_C]),
    "(2.12)": lambda o: (o.alpha0, o.A @ o.MC1 @ o.A.T @ o.f - o.A @ o.MC1 @ o.b + o.a),
    "(2.13b)": lambda o: (o.a - o.A @ o.MC1 @ o.b - o.Jdot_qd, o.J @ o.qdd - o.A @ o.MC1 @ o.A.T @ o.f),
    "(2.14)": lambda o: (given(o), reduced(o) @ answer(o)),
    "(2.15b)": lambda o: (o.a1, o.a - o.A @ o.MC1 @ o.b - o.Jdot_qd),
    "(3.2)": lambda o: (
        np.r_[o.T1, o.a1 - o.J @ o.M1 @ o.T1],
        np.block([[o.M, o.J.T], [0 * o.J, -o.Omega]]) @ answer(o),
    ),
    "(3.3)": lambda o: (
        np.r_[o.M @ o.qdd, -o.Omega @ o.f],
        np.block([[o.In - o.J.T @ o.Omega1 @ o.J @ o.M1, o.J.T @ o.Omega1], [-o.J @ o.M1, o.I6]]) @ given(o),
    ),
    "(3.4)": lambda o: (answer(o), inverse(o) @ given(o)),
    "(3.5a)": lambda o: (np.eye(len(given(o))), reduced(o) @ inverse(o)),
    "(3.5b)": lambda o: (
        inverse(o),
        np.block([[o.M1, 0 * o.J.T], [0 * o.J, o.Omega1]])
        @ np.block([[o.M - o.J.T @ o.Omega1 @ o.J, o.J.T], [o.J, -o.Omega]])
        @ np.block([[o.M1, 0 * o.J.T], [0 * o.J, o.Omega1]]),
    ),
    "(3.6a)": lambda o: (
        o.qdd,
        (o.M1 - o.M1 @ o.J.T @ o.Omega1 @ o.J @ o.M1) @ o.T1 + o.M1 @ o.J.T @ o.Omega1 @ o.a1,
    ),
    "(3.6b)": lambda o: (o.f, o.Omega1 @ o.J @ o.M1 @ o.T1 - o.Omega1 @ o.a1),
    "(4.3), (4.9e)": lambda o: (o.M @ (o.qdd - o.qdd_f), -o.J.T @ o.f),
    "(4.4)": lambda o: (o.qdd - o.qdd_f, -o.M1 @ o.J.T @ o.f),
    "(4.5), (4.9f)": lambda o: (o.alpha0 - o.alpha_f, o.J @ (o.qdd - o.qdd_f)),
    "(4.6)": lambda o: (o.alpha0 - o.alpha_f, delta_alpha(o)),
    "(4.8), (4.9d)": lambda o: (o.Omega @ o.f, o.alpha_f + o.A @ o.MC1 @ o.b - o.a),
    "(4.9g)": lambda o: (o.qdd, o.qdd_f - o.M1 @ o.J.T @ o.f),
    "(4.9h)": lambda o: (o.alpha0, o.alpha_f - o.J @ o.M1 @ o.J.T @ o.f),
}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("equation", EQUATIONS)
def test_equation(equation, seed):
    """Both sides of one equation are the same numbers, with the oracle's accelerations and forces."""
    left, right = EQUATIONS[equation](rigid(seed))
    assert relative_gap(right, left) < TOLERANCE


@pytest.mark.parametrize("seed", SEEDS)
def test_loops_close(seed):
    """After (2.5): V_j - phi^T(O_i, O_j) V_i = 0 around every loop; bases may move."""
    o = rigid(seed)
    tips = o.V0.reshape(-1, 6)
    for ci, Vi in zip(o.motion.contacts, tips, strict=True):
        for cj, Vj in zip(o.motion.contacts, tips, strict=True):
            np.testing.assert_allclose(shift_twist(cj.offset - ci.offset, Vi), Vj, atol=1e-11)


@pytest.mark.parametrize("seed", SEEDS)
def test_omega(seed):
    """(3.1) is symmetric and positive definite where no arm is singular; (2.11) is symmetric."""
    o = rigid(seed)
    np.testing.assert_allclose(o.Omega, o.Omega.T, atol=1e-12 * np.abs(o.Omega).max())
    assert np.linalg.eigvalsh(o.Omega)[0] > 0
    np.testing.assert_array_equal(full(o), full(o).T)


@pytest.mark.parametrize("seed", SEEDS)
def test_wrong_in_print(seed):
    """Errata: +A and thetadot in (2.11), A for A^T after (2.15), alpha(0) in (4.9h) fail as printed."""
    o = rigid(seed)
    printed = full(o)
    printed[: len(o.f), -6:] *= -1
    rhs = np.r_[o.a - o.Jdot_qd, o.T - o.C, -o.b]
    assert relative_gap(np.linalg.solve(printed, rhs), np.r_[o.f, o.qdd, o.alpha_C]) > 1e-3
    assert relative_gap(full(o) @ np.r_[o.f, o.qd, o.alpha_C], rhs) > 1e-3
    if len(o.f) > 6:
        with pytest.raises(ValueError, match="matmul"):
            np.linalg.inv(o.A.T @ o.A) @ o.A @ o.V0
    assert relative_gap(o.alpha0 - o.alpha_f, o.alpha0) > 1e-3  # (4.9h) sets d alpha = alpha


@pytest.mark.parametrize("make", [rigid, nonrigid])
@pytest.mark.parametrize("seed", range(5))
def test_omega_two_ways(make, seed):
    """(4.9c) from matrices and (6.11d, e) from recursions, symmetric, equal to (3.1)."""
    o = make(seed)
    for omega in (omega_from_matrices(o.stacked), omega_recursive(o.stacked, filtered_arms(o.motion))):
        assert relative_gap(omega.matrix, o.Omega) < 1e-11
        x = np.random.default_rng(seed).normal(size=(len(o.f), 2))
        assert relative_gap(omega.solve(omega.matrix @ x), x) < 1e-9


def test_omega_is_refused():
    """A singular matrix is refused with its nullity, a nearly singular one with its pivot."""
    with pytest.raises(MethodNotApplicable, match="its nullity is 2 of 5; try method='sequential'"):
        Omega(np.diag([1.0, 1.0, 1.0, 0.0, 0.0]))
    near = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-7]])
    with pytest.raises(MethodNotApplicable, match=r"smallest scaled pivot is 1\.0e-07: .*try method='sequential'"):
        Omega(near)
