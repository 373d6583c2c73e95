"""Weighted least squares over physically feasible bodies; what the rows do not determine keeps the guess's values.

    1. the unconstrained estimate, with weights from its own residuals          free_fit
    2. which combinations of unknowns it determines                             kept.split_at
    3. the others are the guess's                                               kept.with_the_guess
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

from holdfast.errors import StateError
from holdfast.identification.colour import Colour, colour_of
from holdfast.identification.equations import Equations
from holdfast.identification.feasible_bodies import best_feasible, is_feasible
from holdfast.identification.free_fit import FreeFit, free_fit
from holdfast.identification.kept import Split, free_roots, sized, split_at, with_the_guess
from holdfast.identification.motion_noise import JointNoise
from holdfast.identification.unknowns import Unknowns
from holdfast.model import checks
from holdfast.spatial.scalar import Array

LEAST_LEFT = 0.05  # lower bound of 1 - h, which is near 0 if one sample alone determines a coefficient
HIDDEN = 0.1  # share of the motion's noise in the residuals above which these do not show that of the measurements
ROUNDING = 1e-3  # least noise of whitened residuals that are exact, which averages do not reduce reliably
SURELY = 5.0  # standard deviations by which a mass below zero is no accident


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
        colour: how residuals depend on those before them.
        motion_share: part of the whitened residuals' variance that the noise of the motion explains.
        settled: whether the weights converged.
        held: whether the guess's values are a feasible body together with the determined combinations.
    """

    plain: Array
    covariance: Array
    fixed: Array
    residuals: Array
    noise: Array
    misfit: float
    moved: float
    colour: Colour
    motion_share: float
    settled: bool
    held: bool


def estimate(
    system: Equations,
    unknowns: Unknowns,
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
    colour = colour_of(e, max((one.spline.memory for one in motion), default=1))
    covariance = _covariance(system, fit, split, x, motion, given is not None, colour.widening)
    checks.finite(np.append(covariance, left), "identify: the estimate")
    return Estimate(
        plain=unknowns.plain(x),
        covariance=covariance,
        fixed=split.fixed,
        residuals=left,
        noise=fit.noise,
        misfit=float((e * e).sum()) / max(e.size - len(x), 1),
        moved=float((off * off).sum()),
        colour=colour,
        motion_share=fit.motion_share,
        settled=fit.settled,
        held=held,
    )


def _covariance(
    system: Equations,
    fit: FreeFit,
    split: Split,
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
    scores = scores + ROUNDING**2 * np.einsum("srj,srk->jk", J, J)
    raw = fit.weights.transpose(0, 2, 1) @ J
    for one in motion:
        scores = scores + one.score(system.maps, values, raw)
    influence = split.unknowns.sizes[:, None] * (inverse - split.fixed @ (split.fixed.T @ inverse))
    return influence @ scores @ influence.T


def _require_mass(fit: FreeFit, unknowns: Unknowns, largest: float) -> None:
    """Refuse recordings that a mass below zero explains best, beyond doubt."""
    m, deviation = float(fit.x[0]), float(np.linalg.norm(free_roots(fit, unknowns)[0]))
    if m < -SURELY * deviation and deviation < largest * max(unknowns.sizes[0], -m):
        raise StateError(
            "identify: expected wrenches on the object, or torques of the joints, that some payload explains; got ones"
            f" that a mass of {m:.3g} +- {deviation:.2g} kg fits best. Most likely their sign is reversed, as many"
            " sensors report the reaction of the object: try -wrist_wrench (or -tau). If the sign is right, look at"
            " sensor offsets (sensor_bias=True) and at the masses of the model's arms"
        )


def _estimate_of(fit: FreeFit, split: Split) -> tuple[Array, bool]:
    """Return the feasible body, and whether what is not determined has the guess's values."""
    x = with_the_guess(fit.x, split)
    if x is not None and is_feasible(x[:10]):
        return x, True
    unknowns, count = split.unknowns, split.steps.shape[1]
    guess = unknowns.model.copy()
    guess[:10] *= unknowns.sizes[0] / guess[0]
    steps = split.change @ np.hstack([split.steps, split.fixed])
    return best_feasible(fit.x, steps, count, guess, unknowns.sizes[10:]), False


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
