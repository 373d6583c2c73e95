"""Every operator identity of the paper, for chains with prismatic joints, moving bases and gravity, and its misprints.

`o` is an `Aggregate`; each entry gives the two sides, in the corrected form where the print is wrong.
"""

from functools import cache, reduce

import numpy as np
import pytest

from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.closed.stacked import Stacked, block_diagonal
from holdfast.dynamics.operators import ArmOperators, block, phi
from tests.dynamics.problems import inputs_of, motion_of, random_arm
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem, relative_gap

SEEDS = range(4)
TOLERANCE, WRONG = 1e-12, 1e-3
BACK = slice(None, None, -1)


class Aggregate:
    """The paper's letters for a whole chain, (5.1)-(5.5) and (6.1)-(6.22): block diagonals of all arms, world axes.

    Within an arm joints count from tip to base, as in the paper. What the identities are held against (Ms, J, C,
    Jdot_qd) comes from the sweeps, which are tested on their own. Script M is `Ms`, the links' M is `M`; `b` is less
    the links' external wrenches. T' is `T1`, a'(C) is `a1`, I - H Psi L is `K`; f is any stack of tip wrenches.
    """

    def __init__(self, problem: Problem, seed: int) -> None:
        motion = motion_of(problem)
        self.arms = [ArmOperators(inputs_of(problem, name)) for name in problem.chain.grasps]
        for letter in ("H", "phi", "M", "S", "B", "armature", "D", "L", "psi", "Phi", "Psi", "P", "G"):
            setattr(self, letter, block_diagonal([getattr(arm, letter) for arm in self.arms]))
        self.a = np.concatenate([arm.a for arm in self.arms])
        self.a0 = np.concatenate([arm.a0 for arm in self.arms])
        self.b = np.concatenate([arm.b - arm.given.link_wrenches[BACK].ravel() for arm in self.arms])

        holding = motion.holding
        self.Ms = block_diagonal([mass_matrix(arm.arm, arm.at)[0][BACK, BACK] for arm in holding])
        self.J = block_diagonal([jacobian(arm.arm, arm.at)[:, BACK] for arm in holding])
        self.C = np.concatenate([bias_torque(arm.arm, arm.at, arm.bias.wrenches)[0][BACK] for arm in holding])
        self.T = np.concatenate([arm.torque[BACK] for arm in holding])
        self.Jdot_qd = np.concatenate([arm.bias.tip_acceleration for arm in holding])

        stacked = Stacked(motion)
        self.A, self.MC1, self.a1 = stacked.A, stacked.M_C_inverse, stacked.a_prime
        self.T1 = self.T - self.C
        self.I = np.eye(len(self.T))
        self.K = self.I - self.H @ self.Psi @ self.L
        self.D1 = np.linalg.inv(self.D)
        self.Ms1 = np.linalg.inv(self.Ms)
        self.Omega = self.J @ self.Ms1 @ self.J.T + self.A @ self.MC1 @ self.A.T
        self.Omega1 = np.linalg.inv(self.Omega)
        self.f = 10 * np.random.default_rng(seed).normal(size=len(self.a1))
        self.free = self.Ms1 @ self.T1  # the free accelerations


@cache
def aggregate(seed: int) -> Aggregate:
    """Return a random chain of rigid grasps: prismatic joints, moving bases, oblique gravity, wrenches."""
    options = {"grasps": "rigid", "joints": (7, 6, 8)[: 1 + seed % 3], "moving_base": True}
    return Aggregate(random_problem(seed, gravity=(1.0, -2.0, -9.0), **options), seed)


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


@pytest.mark.parametrize("seed", range(4))
def test_geometry(seed):
    """phi(k, j) is the shift from O_j to O_k; causal operators are block lower triangular."""
    o = ArmOperators(random_arm(seed))
    for k in range(1, o.N + 1):
        for j in range(1, o.N + 1):
            step = phi(o.points[j] - o.points[k]) if k >= j else np.zeros((6, 6))
            np.testing.assert_allclose(o.phi[block(k), block(j)], step, atol=1e-12)
            if k < j:
                assert not o.psi[block(k), block(j)].any()


@pytest.mark.parametrize("seed", range(4))
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


@pytest.mark.parametrize("seed", range(4))
def test_joint_rests_on_what_is_beyond(seed):
    """psi(k+1, k) passes no force of joint k: what the joint yields to is not felt beyond it."""
    o = ArmOperators(random_arm(seed, extras=False))  # a drive without inertia yields freely
    for k in range(1, o.N):
        psi = o.psi[block(k + 1), block(k)]
        P = o.P[block(k), block(k)]
        assert np.abs(psi @ P @ o.h[k]).max() < 1e-12 * np.abs(P).max()


# equation: (truth, as printed, as corrected)
MISPRINTS = {
    "(5.13) inverse for transpose": lambda o: (
        o.free,
        np.linalg.inv(o.K) @ o.D1 @ eps(o, o.T, bias_wrenches(o)),
        o.K.T @ o.D1 @ eps(o, o.T, bias_wrenches(o)),
    ),
    "(6.11g) sign": lambda o: (
        -o.Ms1 @ o.J.T @ o.f,
        o.K.T @ o.D1 @ o.H @ o.psi @ o.B @ o.f,
        -o.K.T @ o.D1 @ o.H @ o.psi @ o.B @ o.f,
    ),
    "(6.18e) transpose": lambda o: (
        o.Ms1 @ (o.T1 - o.J.T @ o.f),
        o.K @ o.D1 @ eps(o, o.T1, 0.0, o.f),
        o.K.T @ o.D1 @ eps(o, o.T1, 0.0, o.f),
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
    return reduce(np.matmul, [named[x[:-1]].T if x.endswith("T") else named[x] for x in letters.split()])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("row", MISPRINTS)
def test_wrong_in_print(row, seed):
    """The printed equation misses the truth, the corrected one meets it."""
    truth, printed, corrected = MISPRINTS[row](aggregate(seed))
    assert relative_gap(printed, truth) > WRONG
    assert relative_gap(corrected, truth) < TOLERANCE


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("row", SHAPES)
def test_not_conformable_in_print(row, seed):
    """The printed product cannot be formed; the corrected one is J qd, or M^-1 J^T f."""
    o = aggregate(seed)
    printed, corrected = SHAPES[row]
    with pytest.raises(ValueError, match="matmul"):
        product(o, printed)
    qd = np.concatenate([arm.given.qd[::-1] for arm in o.arms])
    truth = o.J @ qd if corrected.endswith("qd") else o.Ms1 @ o.J.T @ o.f
    assert relative_gap(product(o, corrected), truth) < TOLERANCE
