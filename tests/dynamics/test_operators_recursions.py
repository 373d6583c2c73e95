"""The paper's loops over links, link by link, and the library's sweeps: each equals its operators."""

import numpy as np
import pytest

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, tip_mobility, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import jacobian, link_twists
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.operators import ArmOperators, block
from holdfast.spatial.spatial_vector import rotate, unrotate
from tests.dynamics.problems import random_arm, random_motion
from tests.systems.problems import relative_gap

seeds = pytest.mark.parametrize("seed", range(5))
BACK = slice(None, None, -1)
TOLERANCE = 1e-12


def drawn(seed: int):
    """Return an arm's operators, its motion, I - H Psi L, and random torques and tip wrench."""
    o, rng = ArmOperators(random_arm(seed)), np.random.default_rng(seed)
    return o, random_motion(seed), np.eye(o.N) - o.H @ o.Psi @ o.L, rng.normal(size=o.N), rng.normal(size=6)


def psi_step(o, k: int) -> np.ndarray:
    """Return psi(k+1, k) = phi(k+1, k) - L(k) H(k), k = 1..N."""
    return o.phi_step(k) - np.outer(o.L[block(k), k - 1], o.h[k])


def smoothed(o, nu) -> np.ndarray:
    """Return (5.10e)-(5.10g), from the base (k = N) to the tip (errata: printed 1..N)."""
    result, lam = np.zeros(o.N), np.zeros(6)
    for k in range(o.N, 0, -1):
        result[k - 1] = nu[k - 1] - o.L[block(k), k - 1] @ lam
        lam = psi_step(o, k).T @ lam + o.h[k] * nu[k - 1]
    return result


@seeds
def test_filter_and_smoother(seed):
    """(5.10): z(k) = psi z(k-1) + L T'(k-1), eps = T' - H z, then smoothing, is M^-1 T'."""
    o, _, K, T, _ = drawn(seed)
    eps, z = np.zeros(o.N), np.zeros(6)
    for k in range(1, o.N + 1):
        if k > 1:
            z = psi_step(o, k - 1) @ z + o.L[block(k - 1), k - 2] * T[k - 2]
        eps[k - 1] = T[k - 1] - o.h[k] @ z
    assert relative_gap(eps, K @ T) < TOLERANCE
    D = np.diag(o.D)
    assert relative_gap(smoothed(o, eps / D), K.T @ (K @ T / D)) < TOLERANCE


@seeds
def test_correction_recursion(seed):
    """(6.4): z(1) = phi(1, 0) f, nu(k) = -H z / D from k = 1 on, smoothed, is -M^-1 J^T f."""
    o, _, K, _, f = drawn(seed)
    nu, z = np.zeros(o.N), o.phi_step(0) @ f
    for k in range(1, o.N + 1):
        nu[k - 1] = -o.h[k] @ z / o.D[k - 1, k - 1]
        z = psi_step(o, k) @ z
    J = o.B.T @ o.phi.T @ o.H.T
    assert relative_gap(smoothed(o, nu), -K.T @ np.linalg.solve(o.D, K @ J.T @ f)) < TOLERANCE


@seeds
def test_mobility_recursion(seed):
    """(6.10): Lambda(k) = psi^T Lambda(k+1) psi + H^T H / D is J M^-1 J^T at the tip."""
    o, _, K, _, _ = drawn(seed)
    mobility = np.zeros((6, 6))
    for k in range(o.N, 0, -1):
        psi = psi_step(o, k)
        mobility = psi.T @ mobility @ psi + np.outer(o.h[k], o.h[k]) / o.D[k - 1, k - 1]
    mobility = o.phi_step(0).T @ mobility @ o.phi_step(0)
    JK = o.B.T @ o.phi.T @ o.H.T @ K.T
    assert relative_gap(mobility, JK @ np.linalg.solve(o.D, JK.T)) < TOLERANCE


@seeds
def test_velocity_recursion(seed):
    """After (5.1): V = phi^T H^T qd link by link, the base's twist carried along."""
    o, motion, *_ = drawn(seed)
    carried = np.concatenate(
        [o.phi[block(o.N), block(k)].T @ o.phi_step(o.N).T @ o.twists[-1] for k in range(1, o.N + 1)]
    )
    stacked = o.phi.T @ o.H.T @ o.given.qd[BACK] + carried
    assert relative_gap(np.concatenate(o.twists[1:-1]), stacked) < TOLERANCE
    twists = link_twists(motion.arm, motion.at, o.given.qd, o.given.base_twist)
    in_world = [rotate(R, V) for R, V in zip(motion.at.R, twists, strict=True)]
    assert relative_gap(np.concatenate(in_world[::-1]), stacked) < TOLERANCE


@seeds
def test_sweeps_of_matrices(seed):
    """mass_matrix, jacobian, tip_mobility, D and bias_torque are their operator products."""
    o, motion, *_ = drawn(seed)
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    b = o.b - o.given.link_wrenches[BACK].ravel()
    assert relative_gap(mass_matrix(arm, at)[0][BACK, BACK], o.H @ o.phi @ o.M @ o.phi.T @ o.H.T + o.armature) < 1e-12
    assert relative_gap(jacobian(arm, at)[:, BACK], o.B.T @ o.phi.T @ o.H.T) < 1e-12
    assert relative_gap(filter.D[BACK], np.diag(o.D)) < TOLERANCE
    HpsiB = o.H @ o.psi @ o.B
    mobility = tip_mobility(arm, at, filter).rotated(at.R[-1]).dense()
    assert relative_gap(mobility, HpsiB.T @ np.linalg.solve(o.D, HpsiB)) < TOLERANCE
    C, _ = bias_torque(arm, at, motion.bias.wrenches)
    assert relative_gap(C[BACK], o.H @ o.phi @ (o.M @ o.phi.T @ o.a + b)) < 1e-12
    assert relative_gap(motion.bias.tip_acceleration, o.B.T @ o.phi.T @ o.a + o.a0) < 1e-12


@seeds
def test_sweep_of_whitening(seed):
    """whiten is T - H psi (S L T + p + B f) for every combination of torques, wrenches and tip wrench."""
    o, motion, _, T, f = drawn(seed)
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    p = o.M @ o.phi.T @ o.a + o.b - o.given.link_wrenches[BACK].ravel()
    tip = unrotate(at.R[-1], f)
    for torque, wrenches, load in ((T, None, None), (T, motion.bias.wrenches, None), (None, None, tip), (T, None, tip)):
        left = np.zeros(o.N) if torque is None else torque
        bracket = o.S @ o.L @ left
        bracket = bracket + (0 if wrenches is None else p) + (0 if load is None else o.B @ f)
        expected = left - o.H @ o.psi @ bracket
        got, _ = whiten(arm, at, filter, None if torque is None else torque[BACK], wrenches, load)
        assert relative_gap(got[BACK], expected) < TOLERANCE


@seeds
def test_sweep_of_smoothing(seed):
    """smooth is (I - H Psi L)^T nu, and its tip B^T psi^T H^T nu."""
    o, motion, K, nu, _ = drawn(seed)
    arm, at = motion.arm, motion.at
    out, tip = smooth(arm, at, articulated_filter(arm, at), nu[BACK])
    assert relative_gap(out[BACK], K.T @ nu) < TOLERANCE
    assert relative_gap(rotate(at.R[-1], tip), o.B.T @ o.psi.T @ o.H.T @ nu) < TOLERANCE


@seeds
def test_printed_recursions_fail(seed):
    """Errata: T for T' in (5.10b, c), 1..N for N..1 after (5.10e), and (6.4) with its sign and start."""
    o, motion, K, _, f = drawn(seed)
    C = o.H @ o.phi @ (o.M @ o.phi.T @ o.a + o.b)
    T, D = motion.torque[BACK], np.diag(o.D)
    right = K @ (T - C)
    assert relative_gap(K @ T, right) > 1e-3  # (5.10b, c)

    lam, out = np.zeros((o.N + 2, 6)), np.zeros(o.N)
    for k in range(1, o.N + 1):  # lambda(k+1) is not there yet
        lam[k] = psi_step(o, k).T @ lam[k + 1] + o.h[k] * right[k - 1] / D[k - 1]
        out[k - 1] = right[k - 1] / D[k - 1] - o.L[block(k), k - 1] @ lam[k + 1]
    assert relative_gap(out, K.T @ (right / D)) > 1e-3

    nu = o.H @ o.psi @ o.B @ f / D
    correct = -K.T @ nu
    assert relative_gap(K.T @ nu, correct) > 1  # (6.4c), (6.11g): the sign
    assert relative_gap(-K.T @ np.r_[0.0, nu[1:]], correct) > 1e-3  # nu(1) is never set
