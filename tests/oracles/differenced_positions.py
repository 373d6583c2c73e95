"""Equations of motion of any mechanism from its positions alone, differenced in 60 digits.

A mechanism is a function from coordinates to the poses of its bodies, and one from coordinates to what must
vanish. Everything else (velocities, accelerations, the mass matrix, the constraint rows) is differences of these
two, so nothing that the library believes of joints or grasps can repeat here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mpmath
import numpy as np

DIGITS = 60
STEP = mpmath.mpf(10) ** -18

Poses = list[tuple[np.ndarray, np.ndarray]]


def exact(x) -> np.ndarray:
    """Return an array of multiprecision numbers."""
    return np.vectorize(mpmath.mpf, otypes=[object])(np.asarray(x, dtype=object))


def rotation_about(vector: np.ndarray) -> np.ndarray:
    """Return the rotation by |vector| about a vector, Rodrigues' formula."""
    angle = mpmath.sqrt(vector @ vector)
    x, y, z = vector
    K = np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]])
    if angle == 0:
        return exact(np.eye(3)) + K
    return exact(np.eye(3)) + mpmath.sin(angle) / angle * K + (1 - mpmath.cos(angle)) / angle**2 * (K @ K)


def axial(X: np.ndarray) -> np.ndarray:
    """Return the vector of a skew matrix."""
    return np.array([X[2, 1] - X[1, 2], X[0, 2] - X[2, 0], X[1, 0] - X[0, 1]]) / 2


@dataclass(frozen=True)
class Mechanism:
    """Bodies and constraints as functions of position.

    Attributes:
        poses: coordinates -> (R, mass centre) of every body.
        gaps: coordinates -> what vanishes.
        masses, inertias: of the bodies, inertias about their mass centres in their own axes.
        gravity: (3,).
    """

    poses: Callable[[np.ndarray], Poses]
    gaps: Callable[[np.ndarray], np.ndarray]
    masses: list
    inertias: list
    gravity: np.ndarray

    def accelerations(self, y: np.ndarray, rates: np.ndarray, forces: np.ndarray) -> dict[str, np.ndarray]:
        """Return accelerations, kinetic energy and constraint residuals, float64.

        Args:
            y: coordinates; the path through them is y + rates t + accelerations t^2 / 2.
            rates: their rates.
            forces: generalised forces other than weights.
        """
        with mpmath.workdps(DIGITS):
            y, rates, forces = exact(y), exact(rates), exact(forces)
            n = len(y)
            forward, backward = self._differences(y, rates)
            here = self.poses(y)
            units = [self._differences(y, exact(row)) for row in np.eye(n)]
            M, bias, energy = exact(np.zeros((n, n))), exact(np.zeros(n)), mpmath.mpf(0)
            for i, (R, c) in enumerate(here):
                turning = np.array([axial((f[i][0] - b[i][0]) @ R.T) / (2 * STEP) for f, b in units]).T
                moving = np.array([(f[i][1] - b[i][1]) / (2 * STEP) for f, b in units]).T
                (Rf, cf), (Rb, cb) = forward[i], backward[i]
                omega = axial((Rf - Rb) @ R.T) / (2 * STEP)
                # the skew part of Rddot R^T is the angular acceleration
                omega_dot = axial((Rf - 2 * R + Rb) @ R.T) / STEP**2
                c_ddot = (cf - 2 * c + cb) / STEP**2
                I = R @ self.inertias[i] @ R.T
                m = self.masses[i]
                M = M + m * (moving.T @ moving) + turning.T @ I @ turning
                bias = bias + moving.T @ (m * (c_ddot - self.gravity))
                bias = bias + turning.T @ (I @ omega_dot + np.cross(omega, I @ omega))
            energy = rates @ M @ rates / 2
            gap = self.gaps(y)
            G = np.array([(self.gaps(y + STEP * u) - self.gaps(y - STEP * u)) / (2 * STEP) for u in exact(np.eye(n))]).T
            at, back = self.gaps(y + STEP * rates), self.gaps(y - STEP * rates)
            G_dot = (at - 2 * gap + back) / STEP**2
            k = len(gap)
            K = np.block([[M, G.T], [G, exact(np.zeros((k, k)))]])
            x = mpmath.lu_solve(mpmath.matrix(K.tolist()), mpmath.matrix([*(forces - bias), *(-G_dot)]))
            found = np.array([float(x[i]) for i in range(n)])
        return {
            "accelerations": found,
            "energy": float(energy),
            "gap": gap.astype(float),
            "rate": (G @ rates).astype(float),
        }

    def _differences(self, y: np.ndarray, direction: np.ndarray) -> tuple[Poses, Poses]:
        return self.poses(y + STEP * direction), self.poses(y - STEP * direction)
