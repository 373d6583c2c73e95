"""The feasible body that fits best and, among those that fit equally well, is nearest to the guess.

A mass distribution has ten inertial parameters pi if and only if the pseudo-inertia

    J(pi) = [Sigma, h; h^T, m],   Sigma = tr(I) / 2 1 - I,   I about the origin

is positive semidefinite (Wensing, Kim and Slotine 2018). The fit is a sum of squares u^T u of the determined
combinations, in standard deviations, so the best feasible body solves a cone problem. It is solved by Newton's method
on

    u^T u + epsilon (tr(J_0^-1 J) - log det J)

where epsilon goes to zero. The second term is the distance from the guess J_0 (Bregman divergence of the
log-determinant; Lee, Wensing and Park 2020), which is infinite on the bound; as it only decides what the first leaves
open, what the data cannot tell gives way before anything that they tell.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from holdfast.spatial.inertia import of_parameters
from holdfast.spatial.scalar import Array

LEAST_EPSILON = 1e-9  # of the distance from the guess, relative to squared standard deviations
FALL = 0.3  # of epsilon from one problem to the next; a tenth took ten times the steps for guesses that are far off
MOST_BODY_STEPS, MOST_HALVINGS = 1000, 60
LEAST_EIGENVALUE = 1e-14  # least eigenvalue of a scaled Hessian; what is below is rounding
LEAST_DECREMENT = 1e-10  # squared Newton decrement, in units of epsilon, at which the next problem follows


def pseudo_inertia(pi: Array) -> Array:
    """Return J, (4, 4), of ten inertial parameters."""
    m, h, I = of_parameters(pi)
    second = 0.5 * np.trace(I) * np.eye(3) - I
    return np.block([[second, h[:, None]], [h[None, :], np.array([[m]])]])


UNIT_PSEUDO_INERTIAS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])


def is_feasible(pi: Array) -> bool:
    """Return whether the mass is positive and the mass has three extents about its centre."""
    J = pseudo_inertia(pi)
    if not J[3, 3] > 0.0:
        return False
    central = J[:3, :3] - np.outer(J[:3, 3], J[:3, 3]) / J[3, 3]
    return float(np.linalg.eigvalsh(central)[0]) > 0.0


def best_feasible(x: Array, steps: Array, determined: int, guess: Array, sizes: Array) -> Array:
    """Return the unknowns of the feasible body that fits best, and next to that is nearest to the guess.

    Args:
        x: (p,) the unconstrained estimate, of which the first ten entries are pi.
        steps: (p, p) changes of x along independent combinations: the first ones by a standard deviation, the others,
            which are not determined, by their sizes.
        determined: number of the former.
        guess: (p,) a feasible body, and other unknowns.
        sizes: (p - 10,) sizes of the other unknowns.
    """
    root = np.linalg.cholesky(pseudo_inertia(guess[:10]))
    scaled = np.array([_between(root, unit) for unit in UNIT_PSEUDO_INERTIAS])
    fit = np.where(np.arange(len(x)) < determined, 1.0, 0.0)
    others = np.eye(len(x))[10:] / sizes[:, None]
    w = np.linalg.solve(steps, guess - x)
    epsilon = max(1.0, float(fit @ w**2))
    directions = np.einsum("pab,pk->kab", scaled, steps[:10])
    pull = others @ steps

    def slopes(w: Array) -> tuple[Array, Array] | None:
        """Return gradient and Hessian at w, or None where no body is."""
        J = np.einsum("pab,p->ab", scaled, (x + steps @ w)[:10])
        try:
            inverse = np.linalg.inv(np.linalg.cholesky(J))
        except np.linalg.LinAlgError:
            return None
        inside = inverse @ directions @ inverse.T  # (k, 4, 4)
        off = others @ (x + steps @ w - guess)
        gradient = np.einsum("kaa->k", directions) - np.einsum("kaa->k", inside) + 2.0 * pull.T @ off
        curvature = np.einsum("kab,lab->kl", inside, inside) + 2.0 * pull.T @ pull
        return 2.0 * fit * w + epsilon * gradient, np.diag(2.0 * fit) + epsilon * curvature

    while True:
        w = _centred(w, slopes, epsilon)
        if epsilon <= LEAST_EPSILON:
            return x + steps @ w
        epsilon = max(FALL * epsilon, LEAST_EPSILON)


def _centred(w: Array, slopes, epsilon: float) -> Array:
    """Return the minimum of a convex function by Newton's method with halved steps, from a point where it is finite."""
    here = slopes(w)
    for _ in range(MOST_BODY_STEPS):
        gradient, curvature = here
        sizes = 1.0 / np.sqrt(np.diag(curvature))
        spread, axes = np.linalg.eigh(sizes[:, None] * curvature * sizes)
        step = -sizes * (axes @ ((axes.T @ (sizes * gradient)) / np.maximum(spread, LEAST_EIGENVALUE)))
        decrement = -float(gradient @ step)
        if not decrement > LEAST_DECREMENT * epsilon:
            break
        for halving in range(MOST_HALVINGS):
            there = w + 0.5**halving * step
            found = slopes(there)
            if found is not None and float(found[0] @ step) < 0.5 * decrement:  # not far beyond the least value
                break
        else:
            break
        w, here = there, found
    return w


def _between(root: Array, J: Array) -> Array:
    """Return L^-1 J L^-T."""
    return solve_triangular(root, solve_triangular(root, J, lower=True).T, lower=True)
