"""Weighted least squares over physically feasible bodies; what the rows do not determine keeps the guess's values.

    1. the unconstrained estimate, with weights from its own residuals          free_fit
    2. which combinations of unknowns it determines                             split_at
    3. the others are the guess's                                               with_the_guess
    4. if that is not a feasible body: the feasible body that fits the determined combinations best and,
       next to that, is nearest to the guess                                    feasible_bodies

The covariance is that of step 1 without the combinations Q that the guess gives,

    cov = P G^-1 M G^-1 P,    P = 1 - Q Q^T,    G = J^T J,    M = sum u u^T + motion,    u = J^T S e

where S leaves the share of the measurements' noise in the whitened residuals e. Its part of M is valid for any
distribution of the noise, even if the weights are wrong (White 1980); that of the motion follows from its noise
(`motion_noise`). With given noise, or if that of the motion hides it, the former part is J^T S^2 J.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from holdfast.errors import StateError
from holdfast.identification.equations import Equations
from holdfast.identification.feasible_bodies import best_feasible, is_feasible
from holdfast.identification.free_fit import FreeFit, free_fit
from holdfast.identification.motion_noise import JointNoise
from holdfast.identification.payload_unknowns import PayloadUnknowns
from holdfast.model import checks
from holdfast.spatial.scalar import Array

HUBER = 1.345  # 95 % efficient for normal noise
LEAST_LEFT = 0.05  # lower bound of 1 - h, which is near 0 if one sample alone determines a coefficient
HIDDEN = 0.1  # share of the motion's noise in the residuals above which these do not show that of the measurements
LEAST_RESIDUAL_NOISE = 1e-3  # least noise of whitened residuals that are exact, which averages do not reduce reliably
SURELY = 5.0  # standard deviations by which a mass below zero is no accident
MOST_GUESS_STEPS, NO_GUESS_STEP = 30, 1e-13  # of Newton steps to the values of the guess; the size at which they end
LEAST_TOLD = 1e-13  # lower bound of singular values, relative to the largest one
NULL_SINGULAR = 1e-10  # singular values and parts of null vectors below this are rounding
LEAK = 0.01  # of what is not told at all, in deviations, that a wrong guess of ten sizes makes a tenth of
AGREES = 4.0  # standard deviations by which an estimate differs from the guess beyond noise
FEWEST_BLOCKS = 8
EXACT_ROWS = 1e-3  # mean square of rows that are exact, relative to the noise
CHANCE = 1e-6  # that independent residuals exceed a limit


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimate and its uncertainty.

    Attributes:
        plain: (p,) the estimate xi.
        covariance: (p, p) covariance of xi; 0 along the fixed combinations.
        fixed: (p, d) orthonormal basis of the combinations that keep the guess's values, with unknowns scaled by size.
        residuals: (samples, r) residuals of the rows.
        noise: (channels,) standard deviations that define the weights.
        misfit: mean square of the whitened residuals, which is 1 if the noise has these standard deviations.
        moved: squared distance from the unconstrained estimate along the determined combinations, in standard
            deviations.
        autocorrelation: how residuals depend on those before them.
        motion_share: part of the whitened residuals' variance that the noise of the motion explains.
        settled: whether the weights converged.
        held: whether the guess's values are a feasible body together with the determined combinations.
        far: (samples,) which were left out, as their residuals are beyond chance.
    """

    plain: Array
    covariance: Array
    fixed: Array
    residuals: Array
    noise: Array
    misfit: float
    moved: float
    autocorrelation: Autocorrelation
    motion_share: float
    settled: bool
    held: bool
    far: Array


def estimate(
    system: Equations,
    unknowns: PayloadUnknowns,
    kinds: Array,
    given: Array | None,
    largest: float,
    motion: Sequence[JointNoise] = (),
) -> Estimate:
    """Return the estimate.

    Args:
        system: the equations.
        unknowns: the unknowns.
        kinds: (channels,) labels; channels with the same label have the same noise.
        given: (channels,) standard deviations of the noise; None to estimate them.
        largest: standard deviation of a combination, relative to its size, above which it is not estimated.
        motion: the noise of the motion.

    Raises:
        StateError: the recordings determine nothing, or a mass below zero.
    """
    for x in (system.rows, system.measured, system.maps):
        checks.finite(x, "identify: recordings")
    fit = free_fit(system, unknowns, kinds, given, motion)
    _require_mass(fit, unknowns, largest)
    unknowns = sized(unknowns, fit, largest)
    split = split_at(np.concatenate([unknowns.sizes[:1], unknowns.model[1:]]), fit, unknowns, largest)
    split = split_at(_estimate_of(fit, split)[0], fit, unknowns, largest)  # now at the estimate's mass centre
    x, held = _estimate_of(fit, split)
    if not split.steps.size:
        raise StateError(
            "identify: expected a recording that identifies some part of the payload, got one in which all its effects"
            " are below the noise; try larger and faster motions, above all rotations"
        )
    values = unknowns.features(x)[0]
    e, left, off = fit.rows @ values, system.rows @ values, split.deviations_between(x, fit.x)
    autocorrelation = autocorrelation_of(e, max((one.spline.memory for one in motion), default=1))
    covariance = _covariance(system, fit, split, x, motion, given is not None, autocorrelation.widening)
    checks.finite(np.append(covariance, left), "identify: the estimate")
    return Estimate(
        plain=unknowns.plain(x),
        covariance=covariance,
        fixed=split.fixed,
        residuals=left,
        noise=fit.noise,
        misfit=float((e * e).sum()) / max(e.size - len(x), 1),
        moved=float((off * off).sum()),
        autocorrelation=autocorrelation,
        motion_share=fit.motion_share,
        settled=fit.settled,
        held=held,
        far=fit.far,
    )


def _covariance(
    system: Equations,
    fit: FreeFit,
    split: Determined,
    x: Array,
    motion: Sequence[JointNoise],
    known: bool,
    widening: float,
) -> Array:
    """Return the covariance of the plain unknowns at an estimate x."""
    values, slopes = split.unknowns.features(x)
    J, inverse = fit.rows @ slopes @ split.change, split.root @ split.root.T
    known = known or fit.motion_share > HIDDEN
    scores = variance(J, fit.rows @ values, inverse, fit.of_motion, known) * widening
    scores = scores + LEAST_RESIDUAL_NOISE**2 * np.einsum("srj,srk->jk", J, J)
    raw = fit.weights.transpose(0, 2, 1) @ J
    for one in motion:
        scores = scores + one.score(system.motions, values, raw)
    if motion:
        drawn = sum(one.drawn(system.motions, values, fit.weights) for one in motion) @ slopes @ split.change
        scores = scores + np.outer(drawn, drawn) / 3.0
    influence = split.unknowns.sizes[:, None] * (inverse - split.fixed @ (split.fixed.T @ inverse))
    return influence @ scores @ influence.T


def _require_mass(fit: FreeFit, unknowns: PayloadUnknowns, largest: float) -> None:
    """Refuse recordings that a mass below zero explains best, beyond doubt."""
    m, deviation = float(fit.x[0]), float(np.linalg.norm(free_roots(fit, unknowns)[0]))
    if m < -SURELY * deviation and deviation < largest * max(unknowns.sizes[0], -m):
        raise StateError(
            "identify: expected wrenches on the object, or torques of the joints, that some payload explains; got ones"
            f" that a mass of {m:.3g} +- {deviation:.2g} kg fits best. Most likely their sign is reversed, as many"
            " sensors report the reaction of the object: try -wrist_wrench (or -tau). If the sign is right, look at"
            " sensor offsets (sensor_bias=True) and at the masses of the model's arms"
        )


def _estimate_of(fit: FreeFit, split: Determined) -> tuple[Array, bool]:
    """Return the feasible body, and whether what is not determined has the guess's values."""
    x = with_the_guess(fit.x, split)
    if x is not None and is_feasible(x[:10]):
        return x, True
    unknowns, count = split.unknowns, split.steps.shape[1]
    guess = unknowns.model.copy()
    guess[:10] *= unknowns.sizes[0] / guess[0]
    steps = split.change @ np.hstack([split.steps, split.fixed])
    return best_feasible(fit.x, steps, count, guess, unknowns.sizes[10:]), False


@dataclass(frozen=True, eq=False)
class Determined:
    """The determined combinations of the plain unknowns, in units of their sizes, and the others.

    Attributes:
        unknowns: the unknowns, with the sizes that were used.
        change: (p, p) dx of small changes of the scaled plain unknowns.
        root: (p, q) root of the covariance of their unconstrained estimate, for noise of unit variance.
        fixed: (p, d) orthonormal basis of the combinations that are not determined.
        steps: (p, k) changes of the determined combinations by independent standard deviations.
    """

    unknowns: PayloadUnknowns
    change: Array
    root: Array
    fixed: Array
    steps: Array

    def deviations_between(self, x: Array, y: Array) -> Array:
        """Return the difference of two vectors of unknowns, in standard deviations of the determined combinations."""
        return np.linalg.pinv(self.steps) @ np.linalg.solve(self.change, x - y)


def free_roots(fit: FreeFit, unknowns: PayloadUnknowns) -> Array:
    """Return a root of the covariance of the unconstrained estimate; huge where nothing is told."""
    sizes = unknowns.linear_sizes
    _, singular, Vt = np.linalg.svd(fit.triangle @ unknowns.features(fit.x)[1] * sizes, full_matrices=True)
    whole = np.zeros(len(sizes))
    whole[: len(singular)] = singular
    return sizes[:, None] * Vt.T / np.maximum(whole, LEAST_TOLD * max(whole[0], 1.0))


def sized(unknowns: PayloadUnknowns, fit: FreeFit, largest: float) -> PayloadUnknowns:
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


def split_at(x: Array, fit: FreeFit, unknowns: PayloadUnknowns, largest: float) -> Determined:
    """Return the determined and the other combinations of changes of unknowns x.

    An unknown is determined if the standard deviation of its unconstrained estimate is below `largest` times its
    typical size. Such unknowns keep their unconstrained estimates, on which the guess has no influence. Of the other
    unknowns, the singular vectors of their columns of the whitened rows are combinations with independent errors. Those
    that cannot be told from noise, with a standard deviation above the limit and an estimate that agrees with the
    guess, get the guess's values.
    """
    change = np.linalg.inv(unknowns.slopes(x)) * unknowns.sizes
    J = fit.triangle @ unknowns.features(fit.x)[1] @ change
    checks.finite(J, "identify: what the recordings tell")
    _, singular, Vt = np.linalg.svd(J, full_matrices=True)
    told = singular > NULL_SINGULAR * max(singular[0], 1.0)
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
    return Determined(unknowns, change, root, fixed, basis @ (P * spread)[:, : basis.shape[1]])


def with_the_guess(x: Array, split: Determined) -> Array | None:
    """Return the estimate x with the guess's values for what is not determined; None if that makes no body."""
    unknowns, Q = split.unknowns, split.fixed
    along = split.change @ Q
    x = x - along @ (Q.T @ np.linalg.solve(split.change, x - unknowns.model))
    for _ in range(MOST_GUESS_STEPS):
        if not x[0] > 0.0 or not np.isfinite(x).all():
            return None
        off = Q.T @ ((unknowns.plain(x) - unknowns.model) / unknowns.sizes)
        slope = Q.T @ (unknowns.slopes(x) / unknowns.sizes[:, None]) @ along
        step = np.linalg.lstsq(slope, -off, rcond=1e-12)[0]
        x = x + along @ step
        if float(np.abs(step).max(initial=0.0)) < NO_GUESS_STEP:
            break
    return x


def variance(J: Array, e: Array, inverse: Array, share: Array | None, known: bool) -> Array:
    """Return the covariance (k, k) of the sum of J^T e that is due to the noise of the measurements.

    The residuals are smaller than the noise, because the estimate is fitted to it: those of a sample by (1 - h)^1/2,
    where h is the leverage of the sample (Bell and McCaffrey 2002).

    Args:
        J: (samples, r, k) derivatives of the whitened rows by the coefficients.
        e: (samples, r) whitened residuals.
        inverse: (k, k) inverse of the sum of J^T J.
        share: (samples, r, r) part of their covariance that is due to the motion; None for none.
        known: whether the noise is known, so that e has unit variance; else its size is used.
    """
    one = np.eye(J.shape[1])
    left = np.broadcast_to(one, (len(J), *one.shape)) if share is None else one - share
    if known:
        return np.einsum("srj,srt,stk->jk", J, left, J)
    part = power(one - np.einsum("srj,jk,stk->srt", J, inverse, J), -0.5, LEAST_LEFT) @ e[..., None]
    scores = np.einsum("srj,sr->sj", J, (power(left, 0.5, 0.0) @ part)[..., 0])
    return scores.T @ scores


def power(matrices: Array, exponent: float, least: float) -> Array:
    """Return powers of symmetric matrices (samples, r, r), whose eigenvalues are raised to a least one."""
    sizes, axes = np.linalg.eigh(matrices)
    return (axes * np.maximum(sizes, least)[:, None, :] ** exponent) @ axes.transpose(0, 2, 1)


@dataclass(frozen=True)
class Autocorrelation:
    """How residuals depend on those before them.

    Attributes:
        of_neighbours: correlation of residuals of successive samples.
        widening: factor of the covariance, >= 1.
        significant: whether they depend on each other, beyond chance.
    """

    of_neighbours: float
    widening: float
    significant: bool


def huber_weights(deviations: Array) -> Array:
    """Return weights of residuals in units of their standard deviations: 1 up to `HUBER`, and inverse to them beyond.

    Reference: Huber, "Robust estimation of a location parameter", 1964.
    """
    return np.minimum(1.0, HUBER / np.maximum(deviations, 1e-300))


def autocorrelation_of(e: Array, memory: int) -> Autocorrelation:
    """Return how whitened residuals e, (samples, r), depend on those before them, and how much that widens deviations.

    Sums over blocks of L samples have L times the variance of single samples if these are independent. The largest
    ratio

        widening = max over L of  mean (sum over a block)^2 / (L mean e^2)

    is the number of samples that tell as much as one independent sample. It multiplies the covariance, which is an
    upper bound, reached by motions that are slow compared with the noise's memory. Where recordings are too short for
    long blocks, the ratio is at least that of noise whose correlation falls geometrically, (1 + rho) / (1 - rho), with
    rho corrected for the bias of short samples (Kendall 1954).

    Args:
        e: the residuals.
        memory: samples over which the errors of smoothed motions depend on each other, which is accounted for
            elsewhere.
    """
    e = e[:, (e * e).mean(axis=0) > EXACT_ROWS]
    squares = (e * e).mean(axis=0)
    correlation = float((e[1:] * e[:-1]).sum() / max(float((e * e).sum()), 1e-300))
    widening, coloured = 1.0, False
    length = 2
    while e.size and len(e) // length >= FEWEST_BLOCKS:
        if length >= memory:
            blocks = e[: len(e) // length * length].reshape(-1, length, e.shape[1]).sum(axis=1)
            ratios = (blocks * blocks).mean(axis=0) / np.maximum(length * squares, 1e-300)
            count = len(blocks)
            for ratio, freedoms in [
                *((x, count) for x in ratios.tolist()),
                (float(ratios.mean()), count * len(ratios)),
            ]:
                low, high = chdtri(freedoms, [1.0 - CHANCE, CHANCE]) / freedoms
                if ratio > high:
                    widening = max(widening, ratio)
                coloured = coloured or not low < ratio < high
        length *= 2
    if widening > 1.0:
        lasting = min(correlation + (1.0 + 4.0 * correlation) / len(e), 1.0 - 2.0 / len(e))
        widening = max(widening, (1.0 + lasting) / (1.0 - lasting))
    return Autocorrelation(correlation, widening, coloured)
