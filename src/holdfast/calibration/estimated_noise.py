"""The variances of closures, measurements and joints, estimated from residuals, and how many freedoms show them.

Rows of unit variance have the covariance  sum_k A_k A_k^T  of all noises, e.g. of the positions of joints. With their
projection P beyond unknowns and free poses, and residuals r, every variance is that for which |A_k^T r|^2 has its mean,
tr(A_k^T P A_k): restricted maximum likelihood (Harville 1977). Derivatives of gaps are those at one point.
"""

from __future__ import annotations

import numpy as np

from holdfast.calibration.problem import FitPoint, Problem, Whitened, evaluated, whitened
from holdfast.errors import StateError
from holdfast.spatial.scalar import Array

MOST_ESTIMATES, ESTIMATE_STEADY = 60, 5e-3  # of the variances; their relative change that ends them
LEAST_DEVIATION = 1e-9  # [rad or m] of estimated noise
LEAST_SHOWN = 0.1  # share of a channel's rows that must be left to show its noise


def estimated_variances(problem: Problem, at: FitPoint, variances: Array, weights: Array, prior: Array) -> Array:
    """Return the variances of all channels, those of the joints last. O(estimates postures rows^2 (rows + n)).

    Args:
        problem: what is fitted.
        at: a point near the estimate.
        variances: a first guess.
        weights: (postures,) of the postures.
        prior: (p,) inverse variances of the unknowns, in sizes.
    """
    here, found, members = evaluated(problem, at), variances, _members(problem)
    for _ in range(MOST_ESTIMATES):
        white = whitened(problem, here, found, weights)
        spread = np.linalg.inv(white.information + np.diag(prior))
        left = white.left - white.still @ (spread @ (white.gradient + prior * at.x / problem.sizes))
        A = np.where(problem.active_rows[:, :, None], white.sources, 0.0)
        hidden = np.swapaxes(A, 1, 2) @ np.concatenate([white.U, white.still @ np.linalg.cholesky(spread)], axis=2)
        shown = ((A**2).sum(axis=(0, 1)) - (hidden**2).sum(axis=(0, 2))) @ members
        squares = ((np.swapaxes(A, 1, 2) @ left[:, :, None]) ** 2).sum(axis=(0, 2)) @ members
        before, found = found, np.maximum(found * squares / np.maximum(shown, 1e-300), LEAST_DEVIATION**2)
        if (np.abs(np.log(found / before)) < ESTIMATE_STEADY).all():
            break
    return found


def freedoms_of_noise(problem: Problem, white: Whitened, spread: Array, kept: Array) -> float:
    """Return the degrees of freedom with which estimated noise makes a joint region wider (Fai and Cornelius 1996).

    Args:
        problem: what is fitted.
        white: the rows at the estimate.
        spread: (p, p) covariance of the unknowns, in sizes.
        kept: (p, k) an orthonormal basis of what is determined.
    """
    members = _members(problem)
    A = np.where(problem.active_rows[:, :, None], white.sources, 0.0)
    beyond = (
        A - white.U @ (np.swapaxes(white.U, 1, 2) @ A) - white.still @ (spread @ (np.swapaxes(white.still, 1, 2) @ A))
    )
    information = 0.5 * members.T @ ((np.swapaxes(A, 1, 2) @ beyond) ** 2).sum(axis=0) @ members
    variances = np.linalg.pinv(information, rcond=1e-6, hermitian=True)  # of the logarithms of all variances
    root = kept @ np.linalg.cholesky(kept.T @ spread @ kept)
    shares = ((np.swapaxes(A, 1, 2) @ white.still @ root) ** 2).sum(axis=0).T @ members  # of each direction's variance
    each = 2.0 / np.maximum(np.einsum("jk,kl,jl->j", shares, variances, shares), 1e-12)
    excess = float((2.0 / np.maximum(each - 2.0, 1e-9)).sum())
    return float(np.clip(2.0 * (len(each) + excess) / max(excess, 1e-12), 1.0, 1e6)) if len(each) else np.inf


def require_shown(problem: Problem, at: FitPoint, prior: Array) -> None:
    """Refuse rows of which the unknowns explain nearly all, so that they show no noise."""
    names, channel = problem.channels
    variances = np.where(np.arange(len(problem.first_variances())) < len(names), problem.first_variances(), 0.0)
    white = whitened(problem, evaluated(problem, at), variances, np.ones(len(problem.q)))
    slopes, spread = white.still, np.linalg.inv(white.information + np.diag(prior))
    shown = problem.active_rows - (white.U**2).sum(axis=2) - np.einsum("kia,ab,kib->ki", slopes, spread, slopes)
    for k, name in enumerate(names):
        count, left = int(problem.active_rows[:, channel == k].sum()), float(shown[:, channel == k].sum())
        if left < LEAST_SHOWN * count:
            raise StateError(
                f"calibrate: noise: expected postures that show it, but the unknowns explain all but {left:.2g} of"
                f" {count} rows of {name}; try noise=ClosureNoise(...), a prior, fewer unknowns or more postures"
            )


def _members(problem: Problem) -> Array:
    """Return which channel every row's and every joint's noise belongs to, (rows + n_v, channels)."""
    names, channel = problem.channels
    of_joints, joint = problem.joint_channels
    component = np.r_[channel, np.where(joint < 0, -1, joint + len(names))]
    return (component[:, None] == np.arange(len(names) + len(of_joints))).astype(float)
