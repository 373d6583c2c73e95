"""Which combinations of the unknowns the rows determine, and the estimate in which the others have the guess's values.

With each unknown in units of its typical size, the singular values of the whitened rows are the inverses of the standard
deviations of combinations of unknowns. Those with a standard deviation above a limit are not estimated: of all
unknowns with the same values of the others, these are the nearest to the guess's mass, mass centre and inertia about it.
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


@dataclass(frozen=True, eq=False)
class Split:
    """The determined combinations and the others, of the plain unknowns in units of their sizes.

    Attributes:
        unknowns: the unknowns, with the sizes that were used.
        change: (p, p) dx of small changes of the scaled plain unknowns.
        identified: (p, k) orthonormal basis of the determined combinations.
        fixed: (p, d) orthonormal basis of the others.
        singular: (k,) inverse standard deviations of the former.
    """

    unknowns: Unknowns
    change: Array
    identified: Array
    fixed: Array
    singular: Array


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
    count = int((singular * largest >= 1.0).sum())
    return Split(unknowns, change, Vt[:count].T, Vt[count:].T, singular[:count])


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
