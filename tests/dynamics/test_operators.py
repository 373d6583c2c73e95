"""Every operator identity of the paper, for chains with prismatic joints, moving bases and gravity.

`o` is an `Aggregate`; each entry gives the two sides, in the corrected form where the print is wrong.
"""

import numpy as np
import pytest

from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.dynamics.operators import ArmOperators, block, phi
from tests.dynamics.aggregate import aggregate
from tests.dynamics.problems import random_arm, relative_gap

SEEDS = range(6)
TOLERANCE = 1e-12


def eps(o, T, p=0.0, f=None):
    """Return T - H psi (S L T + p + B f)."""
    return T - o.H @ o.psi @ (o.S @ o.L @ T + p + (0 if f is None else o.B @ f))


def bias_wrenches(o):
    """Return M phi^T a + b."""
    return o.M @ o.phi.T @ o.a + o.b


def lambda_1(o):
    """Return Lambda(1) of all arms as the sum (6.9b), block diagonal."""
    sums = []
    for arm in o.arms:
        rows = [arm.psi[block(k), block(1)].T @ arm.h[k] for k in range(1, arm.N + 1)]
        sums.append(sum(np.outer(x, x) / d for x, d in zip(rows, np.diag(arm.D), strict=True)))
    return block_diagonal(sums)


def phi_1_0(o):
    """Return diag phi_i(1, 0)."""
    return block_diagonal([arm.phi_step(0) for arm in o.arms])


IDENTITIES = {
    "(5.1a) M = H phi M phi^T H^T": lambda o: (o.Ms, o.H @ o.phi @ o.M @ o.phi.T @ o.H.T + o.armature),
    "(5.1b) J = B^T phi^T H^T": lambda o: (o.J, o.B.T @ o.phi.T @ o.H.T),
    "(5.1c) C = H phi (M phi^T a + b)": lambda o: (o.C, o.H @ o.phi @ bias_wrenches(o)),
    "(5.1d) Jdot qd = B^T phi^T a + a(0)": lambda o: (o.Jdot_qd, o.B.T @ o.phi.T @ o.a + o.a0),
    "(5.2) factors": lambda o: (o.Ms, (o.I + o.H @ o.Phi @ o.L) @ o.D @ (o.I + o.H @ o.Phi @ o.L).T),
    "(5.3) causal inverse": lambda o: (o.I, (o.I + o.H @ o.Phi @ o.L) @ o.K),
    "(5.4) inverse": lambda o: (o.Ms1, o.K.T @ o.D1 @ o.K),
    "(5.5c) arm equation": lambda o: (o.Ms @ o.free + o.J.T @ o.f, o.T1 + o.H @ o.phi @ o.B @ o.f),
    "(5.8b) free accelerations": lambda o: (o.free, o.K.T @ o.D1 @ o.K @ o.T1),
    "(5.9) whiten, weigh, smooth": lambda o: (o.free, o.K.T @ (o.D1 @ (o.K @ o.T1))),
    "(5.11) bias in the bracket": lambda o: (
        o.free,
        o.K.T @ o.D1 @ o.K @ (o.T - o.H @ o.phi @ bias_wrenches(o)),
    ),
    "(5.12a) Psi = psi S": lambda o: (o.Psi, o.psi @ o.S),
    "(5.12a) Phi = phi S": lambda o: (o.Phi, o.phi @ o.S),
    "(5.12b) whitening turns phi to psi": lambda o: (o.H @ o.psi, o.K @ o.H @ o.phi),
    "(5.13) three sweeps": lambda o: (o.free, o.K.T @ o.D1 @ eps(o, o.T, bias_wrenches(o))),
    "(5.14) three sweeps": lambda o: (o.free, o.K.T @ np.linalg.solve(o.D, eps(o, o.T, o.M @ (o.phi.T @ o.a) + o.b))),
    "(6.2) correction": lambda o: (-o.Ms1 @ o.J.T @ o.f, -o.K.T @ o.D1 @ o.K @ o.H @ o.phi @ o.B @ o.f),
    "(6.3) correction": lambda o: (-o.Ms1 @ o.J.T @ o.f, -o.K.T @ o.D1 @ o.H @ o.psi @ o.B @ o.f),
    "(6.5b) its tip": lambda o: (
        -o.J @ o.Ms1 @ o.J.T @ o.f,
        -o.B.T @ o.phi.T @ o.H.T @ o.K.T @ o.D1 @ o.H @ o.psi @ o.B @ o.f,
    ),
    "(6.6) Lambda": lambda o: (
        o.J @ o.Ms1 @ o.J.T,
        o.B.T @ o.phi.T @ o.H.T @ o.K.T @ o.D1 @ o.K @ o.H @ o.phi @ o.B,
    ),
    "(6.7) Lambda": lambda o: (o.J @ o.Ms1 @ o.J.T, o.B.T @ o.psi.T @ o.H.T @ o.D1 @ o.H @ o.psi @ o.B),
    "(6.8) and (6.9) Lambda as a sum": lambda o: (
        o.J @ o.Ms1 @ o.J.T,
        phi_1_0(o).T @ lambda_1(o) @ phi_1_0(o),
    ),
    "(6.12) J M^-1": lambda o: (o.J @ o.Ms1, o.B.T @ o.psi.T @ o.H.T @ o.D1 @ o.K),
    "(6.13), (6.18d) forces": lambda o: (
        o.Omega1 @ o.J @ o.Ms1 @ o.T1 - o.Omega1 @ o.a1,
        o.Omega1 @ (o.B.T @ o.psi.T @ o.H.T @ o.D1 @ o.K @ o.T1 - o.a1),
    ),
    "(6.15) M^-1 T'": lambda o: (o.Ms1 @ o.T1, o.K.T @ o.D1 @ eps(o, o.T1)),
    "(6.16) M^-1 J^T f": lambda o: (o.Ms1 @ o.J.T @ o.f, o.K.T @ o.D1 @ o.H @ o.psi @ o.B @ o.f),
    "(6.17) M^-1 (T' - J^T f)": lambda o: (o.Ms1 @ (o.T1 - o.J.T @ o.f), o.K.T @ o.D1 @ eps(o, o.T1, 0.0, o.f)),
    "(6.20) answer to a'": lambda o: (
        o.Ms1 @ o.J.T @ o.Omega1 @ o.a1,
        o.K.T @ o.D1 @ o.H @ o.psi @ o.B @ o.Omega1 @ o.a1,
    ),
    "(6.21) answer to T'": lambda o: (
        (o.Ms1 - o.Ms1 @ o.J.T @ o.Omega1 @ o.J @ o.Ms1) @ o.T1,
        o.K.T @ (o.D1 - o.D1 @ o.H @ o.psi @ o.B @ o.Omega1 @ o.B.T @ o.psi.T @ o.H.T @ o.D1) @ o.K @ o.T1,
    ),
    "psi^-1 = phi^-1 + S L H": lambda o: (np.linalg.inv(o.psi), np.linalg.inv(o.phi) + o.S @ o.L @ o.H),
    "D = H P H^T": lambda o: (o.D, o.H @ o.P @ o.H.T + o.armature),
    "G = P H^T D^-1": lambda o: (o.G, o.P @ o.H.T @ o.D1),
}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("identity", IDENTITIES)
def test_identity(identity, seed):
    """Both sides of one equation of the paper are the same numbers."""
    left, right = IDENTITIES[identity](aggregate(seed))
    assert relative_gap(right, left) < TOLERANCE


@pytest.mark.parametrize("seed", range(8))
def test_geometry(seed):
    """phi(k, j) is the shift from O_j to O_k; causal operators are block lower triangular."""
    o = ArmOperators(random_arm(seed))
    for k in range(1, o.N + 1):
        for j in range(1, o.N + 1):
            step = phi(o.points[j] - o.points[k]) if k >= j else np.zeros((6, 6))
            np.testing.assert_allclose(o.phi[block(k), block(j)], step, atol=1e-12)
            if k < j:
                assert not o.psi[block(k), block(j)].any()


@pytest.mark.parametrize("seed", range(8))
def test_riccati(seed):
    """P(k) = psi P psi^T + L armature L^T + M(k), step by step; P is symmetric and definite."""
    o = ArmOperators(random_arm(seed))
    for k in range(1, o.N + 1):
        P = o.P[block(k), block(k)]
        expected = o.M[block(k), block(k)]
        if k > 1:
            before = block(k - 1)
            psi, L = o.psi[block(k), before], o.L[before, k - 2]
            expected = expected + psi @ o.P[before, before] @ psi.T + o.armature[k - 2, k - 2] * np.outer(L, L)
        assert relative_gap(P, expected) < 1e-12
        assert np.linalg.eigvalsh(P)[0] > 0


@pytest.mark.parametrize("seed", range(8))
def test_joint_rests_on_what_is_beyond(seed):
    """psi(k+1, k) passes no force of joint k: what the joint yields to is not felt beyond it."""
    o = ArmOperators(random_arm(seed, extras=False))  # a drive without inertia yields freely
    for k in range(1, o.N):
        psi = o.psi[block(k + 1), block(k)]
        P = o.P[block(k), block(k)]
        assert np.abs(psi @ P @ o.h[k]).max() < 1e-12 * np.abs(P).max()
