"""Which unknowns the rows determine, and the estimate in which what they do not determine has the guess's values.

An unknown is determined if the standard deviation of its unconstrained estimate is below a fraction of its typical
size. Such unknowns keep their unconstrained estimates, on which the guess has no influence. Of the other unknowns, the
singular vectors of their columns of the whitened rows are combinations with independent errors. Those that cannot be
told from noise, with a standard deviation above the limit and an estimate that agrees with the guess, get the guess's
values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.identification.free_fit import FreeFit
from holdfast.identification.unknowns import Unknowns
from holdfast.model import checks
from holdfast.spatial.scalar import Array

MOST_STEPS, NO_STEP = 30, 1e-13
LEAST_TOLD = 1e-13  # lower bound of singular values, relative to the largest one
UNTOLD = 1e-10  # singular values and parts of null vectors below this are rounding
LEAK = 0.01  # of what is not told at all, in deviations, that a wrong guess of ten sizes makes a tenth of
AGREES = 4.0  # standard deviations by which an estimate differs from the guess beyond noise


@dataclass(frozen=True, eq=False)
class Split:
    """The determined combinations of the plain unknowns, in units of their sizes, and the others.

    Attributes:
        unknowns: the unknowns, with the sizes that were used.
        change: (p, p) dx of small changes of the scaled plain unknowns.
        root: (p, q) root of the covariance of their unconstrained estimate, for noise of unit variance.
        fixed: (p, d) orthonormal basis of the combinations that are not determined.
        steps: (p, k) changes of the determined combinations by independent standard deviations.
    """

    unknowns: Unknowns
    change: Array
    root: Array
    fixed: Array
    steps: Array

    def deviations_between(self, x: Array, y: Array) -> Array:
        """Return the difference of two vectors of unknowns, in standard deviations of the determined combinations."""
        return np.linalg.pinv(self.steps) @ np.linalg.solve(self.change, x - y)


def free_roots(fit: FreeFit, unknowns: Unknowns) -> Array:
    """Return a root of the covariance of the unconstrained estimate; huge where nothing is told."""
    sizes = unknowns.linear_sizes
    _, singular, Vt = np.linalg.svd(fit.triangle @ unknowns.features(fit.x)[1] * sizes, full_matrices=True)
    whole = np.zeros(len(sizes))
    whole[: len(singular)] = singular
    return sizes[:, None] * Vt.T / np.maximum(whole, LEAST_TOLD * max(whole[0], 1.0))


def sized(unknowns: Unknowns, fit: FreeFit, largest: float) -> Unknowns:
    """Return the unknowns with the sizes of the estimate, where it tells them, or else of the guess."""
    x, roots = fit.x, free_roots(fit, unknowns)

    def told(value: float, slope: Array) -> bool:
        return value > 0.0 and float(np.linalg.norm(slope @ roots)) < largest * value

    m, radius = unknowns.sizes[:2].tolist()
    if told(x[0], np.eye(len(x))[0]):
        m = float(x[0])
        trace = np.isin(np.arange(len(x)), (4, 7, 9)).astype(float)
        twice = float(trace @ unknowns.plain(x))
        if told(twice, trace @ unknowns.slopes(x)):
            radius = float(np.sqrt(twice / (2.0 * m)))
    return unknowns.sized(m, radius)


def split_at(x: Array, fit: FreeFit, unknowns: Unknowns, largest: float) -> Split:
    """Return the determined and the other combinations of changes of unknowns x."""
    change = np.linalg.inv(unknowns.slopes(x)) * unknowns.sizes
    J = fit.triangle @ unknowns.features(fit.x)[1] @ change
    checks.finite(J, "identify: what the recordings tell")
    _, singular, Vt = np.linalg.svd(J, full_matrices=True)
    told = singular > UNTOLD * max(singular[0], 1.0)
    root = Vt[: len(told)][told].T / singular[told]
    null = np.vstack([Vt[: len(told)][~told], Vt[len(told) :]])
    deviations = np.linalg.norm(root, axis=1)
    loose = (deviations >= largest) | (np.abs(null).max(axis=0, initial=0.0) > LEAK * deviations)
    off = np.linalg.solve(change, fit.x - x) + (unknowns.plain(x) - unknowns.model) / unknowns.sizes
    _, singular, Vt = np.linalg.svd(J[:, loose], full_matrices=True)
    sizes = np.zeros(len(Vt))
    sizes[: len(singular)] = singular
    unseen = (sizes * largest < 1.0) & (np.abs(sizes * (Vt @ off[loose])) < AGREES)
    fixed = np.zeros((len(x), int(unseen.sum())))
    fixed[loose] = Vt[unseen].T
    basis = np.linalg.svd(fixed, full_matrices=True)[0][:, fixed.shape[1] :]
    P, spread, _ = np.linalg.svd(basis.T @ root, full_matrices=False)
    return Split(unknowns, change, root, fixed, basis @ (P * spread)[:, : basis.shape[1]])


def with_the_guess(x: Array, split: Split) -> Array | None:
    """Return the estimate x with the guess's values for what is not determined; None if that makes no body."""
    unknowns, Q = split.unknowns, split.fixed
    along = split.change @ Q
    x = x - along @ (Q.T @ np.linalg.solve(split.change, x - unknowns.model))
    for _ in range(MOST_STEPS):
        if not x[0] > 0.0 or not np.isfinite(x).all():
            return None
        off = Q.T @ ((unknowns.plain(x) - unknowns.model) / unknowns.sizes)
        slope = Q.T @ (unknowns.slopes(x) / unknowns.sizes[:, None]) @ along
        step = np.linalg.lstsq(slope, -off, rcond=1e-12)[0]
        x = x + along @ step
        if float(np.abs(step).max(initial=0.0)) < NO_STEP:
            break
    return x
