"""Coordinates in which every body is physically possible: the log-Cholesky factor relative to a reference body.

The pseudo-inertia of a body with a mass distribution is positive definite (`feasible_bodies`), so that

    J(theta) = L_0 T T^T L_0^T,    T = lower triangular with diagonal exp(theta_1 .. theta_4),    J(0) = L_0 L_0^T

reaches all of them, and no other matrices, with ten free numbers (Rucker and Wensing 2022). As L_0 is the reference's,
theta has no units and does not depend on the axes' scale: 0.1 changes masses and extents by about a tenth.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from holdfast.identification.feasible_bodies import pseudo_inertia
from holdfast.spatial.scalar import Array

DIAGONAL = tuple((k, k) for k in range(4))
BELOW = tuple((i, j) for i in range(4) for j in range(i))
LEAST_EXTENT = 1e-3  # least eigenvalue of a reference's second moments about its mass centre, relative to the largest


def parameters_of(J: Array) -> Array:
    """Return the ten inertial parameters (m, h, I about the origin) of a pseudo-inertia, (..., 10)."""
    second, twice = J[..., :3, :3], np.einsum("...kk->...", J[..., :3, :3])
    I = twice[..., None, None] * np.eye(3) - second
    entries = [I[..., i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
    return np.stack([J[..., 3, 3], *(J[..., k, 3] for k in range(3)), *entries], axis=-1)


def reference_factor(pi: Array) -> Array | None:
    """Return L_0 of a body, with extents raised to possible ones; None for a body without mass.

    Args:
        pi: (10,) inertial parameters.
    """
    J = pseudo_inertia(pi)
    m, h = J[3, 3], J[:3, 3]
    if not m > 0.0:
        return None
    sizes, axes = np.linalg.eigh(J[:3, :3] - np.outer(h, h) / m)
    if not sizes[-1] > 0.0:
        return None
    J[:3, :3] = (axes * np.maximum(sizes, LEAST_EXTENT * sizes[-1])) @ axes.T + np.outer(h, h) / m
    return np.linalg.cholesky(J)


def body_at(root: Array, theta: Array) -> tuple[Array, Array]:
    """Return the parameters of a body, (10,), and their derivatives by its coordinates, (10, 10).

    Args:
        root: (4, 4) L_0.
        theta: (10,) logarithms of the diagonal, then the entries below it, row by row.
    """
    T, changes = np.diag(np.exp(theta[:4])), np.zeros((10, 4, 4))
    for k, place in enumerate(DIAGONAL):
        changes[(k, *place)] = np.exp(theta[k])
    for k, place in enumerate(BELOW, start=4):
        T[place], changes[(k, *place)] = theta[k], 1.0
    half = changes @ T.T
    slopes = root @ (half + half.transpose(0, 2, 1)) @ root.T
    return parameters_of(root @ T @ T.T @ root.T), parameters_of(slopes).T


def coordinates_of(root: Array, pi: Array) -> Array:
    """Return theta of a body, the inverse of `body_at`."""
    half = solve_triangular(root, pseudo_inertia(pi), lower=True)
    T = np.linalg.cholesky(solve_triangular(root, half.T, lower=True))
    return np.array([*np.log(np.diag(T)), *(T[place] for place in BELOW)])


def no_thinner(theta: Array, least: float) -> Array:
    """Return coordinates of a body whose pseudo-inertia, relative to the reference's, has no eigenvalue below one."""
    T = np.diag(np.exp(theta[:4]))
    for k, place in enumerate(BELOW, start=4):
        T[place] = theta[k]
    sizes, axes = np.linalg.eigh(T @ T.T)
    T = np.linalg.cholesky((axes * np.maximum(sizes, least)) @ axes.T)
    return np.array([*np.log(np.diag(T)), *(T[place] for place in BELOW)])
