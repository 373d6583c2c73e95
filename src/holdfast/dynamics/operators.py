"""The spatial operators of one arm as explicit matrices, for teaching and tests.

Blocks are ordered as in the paper, k = 1 (tip) .. N (base), along world axes, about the joint points O_k. This code is
not fast; the sweeps in `arm` never form these matrices.

    J = B^T phi^T H^T      M = H phi M phi^T H^T (+ armature) = (I + H Phi L) D (I + H Phi L)^T
    C = H phi (M phi^T a + b)            M^-1 = (I - H Psi L)^T D^-1 (I - H Psi L)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.arm.motion import ArmInputs
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import skew


def phi(l: Array) -> Array:
    """Return phi = [I, l~; 0, I] with l from the outer point to the inner one [m]."""
    return np.block([[np.eye(3), skew(l)], [np.zeros((3, 3)), np.eye(3)]])


def block(k: int) -> slice:
    """Return the slice of block k = 1..N in a stack of 6-vectors."""
    return slice(6 * (k - 1), 6 * k)


@dataclass(frozen=True, eq=False)
class ArmOperators:
    """The operators of an arm; each matrix is computed when it is first used.

    Attributes:
        given: the arm, its state and its base motion (with base acceleration minus [0; g]).
    """

    given: ArmInputs

    @property
    def N(self) -> int:
        """Number of joints."""
        return self.given.arm.joint_count

    @cached_property
    def points(self) -> list[Array]:
        """O_0 (tip), O_1, ..., O_N, O_{N+1} (base origin), world axes."""
        at = forward_kinematics(self.given.arm, self.given.q)
        return [at.tip.p, *(at.tip.p - r for r in reversed(at.reach)), self.given.arm.base.p]

    @cached_property
    def rotations(self) -> list[Array]:
        """Rotation of link k = 1..N to world axes (index 0 is unused)."""
        return [np.eye(3), *reversed(forward_kinematics(self.given.arm, self.given.q).R)]

    def phi_step(self, k: int) -> Array:
        """Return phi(k+1, k), k = 0..N."""
        return phi(self.points[k] - self.points[k + 1])

    @cached_property
    def h(self) -> list[Array]:
        """H^T(k) as 6-vectors, k = 1..N (index 0 is unused)."""
        result = [np.zeros(6)]
        for k, joint in enumerate(reversed(self.given.arm.joints), start=1):
            parts = [np.zeros(3) if part is None else self.rotations[k] @ part for part in joint.motion_subspace]
            result.append(np.concatenate(parts))
        return result

    @cached_property
    def H(self) -> Array:
        """diag H(k), (N, 6N)."""
        H = np.zeros((self.N, 6 * self.N))
        for k in range(1, self.N + 1):
            H[k - 1, block(k)] = self.h[k]
        return H

    @cached_property
    def M(self) -> Array:
        """diag M(k): spatial inertias about O_k, (6N, 6N)."""
        M = np.zeros((6 * self.N, 6 * self.N))
        for k, link in enumerate(reversed(self.given.arm.links), start=1):
            R = self.rotations[k]
            p = skew(R @ link.com)
            I = R @ link.inertia @ R.T - link.mass * p @ p
            M[block(k), block(k)] = np.block([[I, link.mass * p], [-link.mass * p, link.mass * np.eye(3)]])
        return M

    @cached_property
    def phi(self) -> Array:
        """phi(k, j), k >= j: lower block triangular, I on the diagonal, (6N, 6N)."""
        return self._causal([self.phi_step(k) for k in range(self.N)])

    @cached_property
    def S(self) -> Array:
        """The shift operator with S(k, k-1) = I, (6N, 6N)."""
        return np.eye(6 * self.N, k=-6)

    @cached_property
    def B(self) -> Array:
        """B with first block phi(1, 0) and zeros below, (6N, 6)."""
        B = np.zeros((6 * self.N, 6))
        B[block(1)] = self.phi_step(0)
        return B

    @cached_property
    def armature(self) -> Array:
        """Diagonal matrix of the armatures, (N, N)."""
        return np.diag(self.given.arm.armature[::-1])

    @cached_property
    def P(self) -> Array:
        """Block diagonal matrix of the articulated inertias P(k), from their recursion, (6N, 6N)."""
        P = np.zeros_like(self.M)
        carried = np.zeros((6, 6))
        for k in range(1, self.N + 1):
            own = self.M[block(k), block(k)] + carried
            h = self.h[k]
            d = h @ own @ h + self.armature[k - 1, k - 1]
            step = self.phi_step(k)
            carried = step @ (own - np.outer(own @ h, h @ own) / d) @ step.T
            P[block(k), block(k)] = own
        return P

    @cached_property
    def D(self) -> Array:
        """D = H P H^T + armature, diagonal, (N, N)."""
        return self.H @ self.P @ self.H.T + self.armature

    @cached_property
    def G(self) -> Array:
        """G = P H^T D^-1, (6N, N)."""
        return self.P @ self.H.T @ np.linalg.inv(self.D)

    @cached_property
    def L(self) -> Array:
        """L(k) = phi(k+1, k) G(k), block diagonal, (6N, N)."""
        L = np.zeros_like(self.G)
        for k in range(1, self.N + 1):
            L[block(k), k - 1] = self.phi_step(k) @ self.G[block(k), k - 1]
        return L

    @cached_property
    def psi(self) -> Array:
        """psi(k, j) = psi(k, k-1) .. psi(j+1, j), psi(k+1, k) = phi(k+1, k) - L(k) H(k)."""
        steps = [np.eye(6)]
        for k in range(1, self.N):
            steps.append(self.phi_step(k) - np.outer(self.L[block(k), k - 1], self.h[k]))
        return self._causal(steps)

    @cached_property
    def Phi(self) -> Array:
        """Phi = phi S, strictly lower block triangular."""
        return self.phi @ self.S

    @cached_property
    def Psi(self) -> Array:
        """Psi = psi S, strictly lower block triangular."""
        return self.psi @ self.S

    @cached_property
    def twists(self) -> list[Array]:
        """V(0), V(1), ..., V(N), V(N+1) (the base), world axes."""
        V = [np.zeros(6)] * (self.N + 2)
        V[self.N + 1] = self.given.base_twist
        for k in range(self.N, 0, -1):
            V[k] = self.phi_step(k).T @ V[k + 1] + self.h[k] * self.given.qd[self.N - k]
        V[0] = self.phi_step(0).T @ V[1]
        return V

    @cached_property
    def a(self) -> Array:
        """Bias accelerations a(k), with the base acceleration included in a(N), (6N,)."""
        a = np.zeros(6 * self.N)
        for k in range(1, self.N + 1):
            w, l = self.twists[k + 1][:3], self.points[k] - self.points[k + 1]
            turning, sliding = self.h[k][:3], self.h[k][3:]
            rate = self.given.qd[self.N - k]
            a[block(k)] = np.r_[
                np.cross(w, turning * rate), np.cross(w, np.cross(w, l)) + 2 * np.cross(w, sliding * rate)
            ]
        a[block(self.N)] += self.phi_step(self.N).T @ self.given.base_acceleration
        return a

    @cached_property
    def a0(self) -> Array:
        """a(0) = [0; w x (w x l(1, 0))], (6,)."""
        w, l = self.twists[1][:3], self.points[0] - self.points[1]
        return np.r_[np.zeros(3), np.cross(w, np.cross(w, l))]

    @cached_property
    def b(self) -> Array:
        """Gyroscopic forces b(k) = [w x I w; m w x (w x p)], (6N,)."""
        b = np.zeros(6 * self.N)
        for k, link in enumerate(reversed(self.given.arm.links), start=1):
            w, p = self.twists[k][:3], self.rotations[k] @ link.com
            I = self.M[block(k), block(k)][:3, :3]
            b[block(k)] = np.r_[np.cross(w, I @ w), link.mass * np.cross(w, np.cross(w, p))]
        return b

    def _causal(self, steps: list[Array]) -> Array:
        """Return the block triangular operator with the steps[k] = X(k+1, k), k = 1..N-1."""
        X = np.zeros((6 * self.N, 6 * self.N))
        for j in range(1, self.N + 1):
            product = np.eye(6)
            X[block(j), block(j)] = product
            for k in range(j + 1, self.N + 1):
                product = steps[k - 1] @ product
                X[block(k), block(j)] = product
        return X
