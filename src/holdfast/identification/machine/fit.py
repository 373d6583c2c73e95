"""The most probable machine: weighted least squares with a prior, and the covariance of its error.

    min  sum rho(W (A x(z) + b - P (gain * y)))  +  |(z - z_0) / spread|^2

over the coordinates z. W whitens the noise of the measurements, whose size is found from the residuals, in turns with
z. Where gains or time offsets are unknown, derivatives are taken at the measurements without their noise,
y + Sigma P^T V^-1 residual (the conditions of Gauss and Helmert), as noisy ones would draw gains towards zero.

With F = J^T J of the whitened rows and the prior's information L, an estimate has the error

    cov = (F + L)^-1 (M + L) (F + L)^-1

where M is F for white noise, and as in `coloured_noise` for the residuals that were found. Errors of smoothed positions
are a part of W and M of their own (`motion_noise`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.special import ndtri, stdtrit

from holdfast.identification.estimate import huber_weights
from holdfast.identification.free_fit import channel_sizes, estimated, far_off, least_noise, white_noise, whitener
from holdfast.identification.machine.coloured_noise import Autoregression, autoregressions
from holdfast.identification.machine.unknowns import MachineUnknowns
from holdfast.identification.motion_noise import JointNoise
from holdfast.identification.rows import RecordedRows
from holdfast.spatial.scalar import Array

NOT_USED = 1e4  # factor of the noise of measurements that do not count
MOST_REFITS, NOISE_SETTLED = 40, 1e-4  # of weights and estimate; relative change of the noise at which they end
FIRST_NOISE = 0.05  # first guess of the noise, relative to the measurements
TOLD_AT_LEAST = 1e-15  # of eigenvalues, relative to the largest one
BLOCK = 12  # rows of a block of equations, in units of its columns
OF_MEDIAN = 1.4826  # standard deviation of normal noise, in units of its median size


@dataclass(frozen=True, eq=False)
class MachineFit:
    """An estimate of a machine's coordinates.

    Attributes:
        z: (p,) the coordinates.
        around: (p,) coordinates whose slopes the covariance is for, away from the bound of possible bodies.
        covariance: (p, p) of the error of z, in steps of `around`.
        information: (p, p) F, what the recordings tell, likewise.
        noise: (channels,) standard deviations of the measurements.
        residuals: (samples, r) residuals of the rows.
        errors: (samples, channels) the smallest errors of the measurements that explain the rows; for arms that hold
            nothing, and for one arm, these are the residuals of its torques.
        misfit: mean square of the whitened residuals, for the freedoms that are left.
        processes: how the errors of each channel depend on the past.
        settled: whether weights and estimate converged.
        outliers: share of the rows whose weight Huber's loss reduces.
        freedoms: degrees of freedom from which the noise of a channel was estimated; infinite if it was given.
        motion_share: part of the whitened residuals' variance that the noise of positions explains.
        far: (samples,) which were left out, as their residuals are beyond chance (`free_fit`).
    """

    z: Array
    around: Array
    covariance: Array
    information: Array
    noise: Array
    residuals: Array
    errors: Array
    misfit: float
    processes: list[Autoregression]
    settled: bool
    outliers: float
    freedoms: float
    motion_share: float
    far: Array

    def widened(self, chance: float) -> float:
        """Return how much wider intervals are than normal ones, as the noise is an estimate itself (Student 1908).

        Args:
            chance: that the error is beyond the interval on one side.
        """
        return float(stdtrit(self.freedoms, chance) / ndtri(chance))


def machine_fit(
    rows: RecordedRows,
    unknowns: MachineUnknowns,
    kinds: Array,
    given: Array | None,
    huber: bool,
    coloured: bool = True,
    motion: Sequence[JointNoise] = (),
) -> MachineFit:
    """Return the estimate. O(samples r p^2) for each round.

    Args:
        rows: the equations.
        unknowns: the unknowns.
        kinds: (channels,) labels; channels with the same label have the same noise.
        given: (channels,) standard deviations of the noise; None to estimate them.
        huber: whether large residuals count by their size instead of their square.
        coloured: whether the covariance is that of noise that depends on its past.
        motion: the errors of smoothed positions.
    """
    whole = _settled(rows, unknowns, kinds, given, huber, coloured, motion)
    if not whole.far.any():
        return whole
    left = replace(rows, used=rows.used & ~whole.far[:, None])
    return replace(_settled(left, unknowns, kinds, given, huber, coloured, motion), far=whole.far)


def _settled(
    rows: RecordedRows,
    unknowns: MachineUnknowns,
    kinds: Array,
    given: Array | None,
    huber: bool,
    coloured: bool,
    motion: Sequence[JointNoise],
) -> MachineFit:
    """Return the estimate from all rows, with weights that agree with it; see `machine_fit`."""
    sizes = channel_sizes(rows.y, kinds)
    least = least_noise(rows.y, sizes)
    if motion:
        least = np.maximum(least, white_noise(rows.y, kinds, motion))
    noise = np.maximum(FIRST_NOISE * sizes, least) if given is None else given
    z, settled = unknowns.start.copy(), False
    z = np.maximum(z, unknowns.lowest)
    information = np.eye(len(z))
    weights = np.ones(rows.b.shape)
    at = _Point(rows, unknowns, z, noise, motion)
    for count in range(MOST_REFITS):
        z = _minimum(at, weights)
        before = noise
        at = _Point(rows, unknowns, z, noise, motion)
        information = at.information(weights)
        if given is None:
            noise = np.maximum(_noise(at, kinds, sizes, information, huber), least)
            noise = noise if count < MOST_REFITS // 2 else np.sqrt(noise * before)
        old = weights
        if huber:
            e = np.abs(at.whitened)
            weights = np.sqrt(huber_weights(e))
        at = _Point(rows, unknowns, z, noise, motion)
        same = float(np.abs(noise / before - 1.0).max()) < NOISE_SETTLED and float(np.abs(weights - old).max()) < 1e-2
        if same and (count or not at.bilinear):
            settled = True
            break
    around = unknowns.away_from_bounds(z)
    information = at.information(weights, around)
    G = with_prior(information, unknowns.spread)
    M, processes, size = at.scores(weights, around, coloured)
    M = M if given is not None else M * max(size, 1.0)
    spent = float(np.trace(G @ information))
    covariance = with_prior(information, unknowns.spread, M)
    repetition = float(np.mean([one.repetition for one in processes]))
    counted = float((at.whitened**2 * weights**2).sum())
    return MachineFit(
        z=z,
        around=around,
        covariance=covariance,
        information=information,
        noise=noise,
        residuals=at.residuals,
        errors=at.errors,
        misfit=counted / max(at.counted - spent, 1.0),
        processes=processes,
        settled=settled,
        outliers=float((weights < 1.0).mean()),
        freedoms=np.inf if given is not None else max((at.counted - spent) / len(noise) / repetition, 1.0),
        motion_share=0.0 if at.share is None else float(np.einsum("srr->", at.share)) / rows.b.size,
        far=far_off(at.whitened) if motion else np.zeros(len(rows.b), bool),
    )


def with_prior(information: Array, spread: Array, scores: Array | None = None) -> Array:
    """Return (F + L)^-1 (M + L) (F + L)^-1, (p, p); what is below rounding counts as not told.

    Args:
        information: (p, p) F.
        spread: (p,) standard deviations of the prior, L = spread^-2.
        scores: (p, p) M; None for F.
    """
    outer = np.outer(spread, spread)
    sizes, axes = np.linalg.eigh(0.5 * (information + information.T) * outer)
    told = sizes > len(sizes) * TOLD_AT_LEAST * sizes[-1]
    M = np.diag(sizes) if scores is None else axes.T @ (scores * outer) @ axes
    own, turn = np.linalg.eigh(np.where(np.outer(told, told), M, 0.0) + np.eye(len(sizes)))
    half = spread[:, None] * (axes / (np.where(told, sizes, 0.0) + 1.0)) @ (turn * np.sqrt(np.maximum(own, 0.0)))
    return half @ half.T


def errors_at(rows: RecordedRows, unknowns: MachineUnknowns, z: Array, noise: Array) -> Array:
    """Return the smallest errors of the measurements that explain the rows at coordinates z, (samples, channels)."""
    return _Point(rows, unknowns, z, noise).errors


def information_of(rows: RecordedRows, unknowns: MachineUnknowns, z: Array, noise: Array) -> Array:
    """Return the information F of rows about coordinates z, (p, p), for noise of the channels."""
    return _Point(rows, unknowns, z, noise).information(np.ones(rows.b.shape))


class _Point:
    """The whitened rows and their derivatives at coordinates z, for a noise of the channels and of positions."""

    def __init__(
        self, rows: RecordedRows, unknowns: MachineUnknowns, z: Array, noise: Array, motion: Sequence[JointNoise] = ()
    ) -> None:
        self.rows, self.unknowns, self.z, self.noise, self.motion = rows, unknowns, z, noise, motion
        self.gain, delay = unknowns.gain(z, rows.y.shape[1]), unknowns.delay(z)
        self.bilinear = unknowns.linear < len(z)
        y = _shifted(rows, delay) if delay else rows.y
        self.maps = rows.P * self.gain
        deviations = noise * np.where(rows.used, 1.0, NOT_USED)
        self.x, self.slopes = unknowns.x(z)
        self.features, spread = np.append(self.x, 1.0), None
        if motion:
            spread = np.zeros((*rows.b.shape, rows.b.shape[1]))
            for one in motion:
                spread[one.samples] += one.spread(rows.N, self.features)
        self.W = whitener(self.maps * (deviations / noise)[:, None, :], noise, spread)
        self.share = None if spread is None else self.W @ spread @ self.W.transpose(0, 2, 1)
        self.residuals = rows.A @ self.x + rows.b - (self.maps @ y[:, :, None])[:, :, 0]
        self.whitened = (self.W @ self.residuals[:, :, None])[:, :, 0]
        lifted = self.W @ self.maps  # (samples, r, channels)
        self.lifted = lifted
        self.errors = -(deviations**2) * (lifted.transpose(0, 2, 1) @ self.whitened[:, :, None])[:, :, 0]
        self.clean = y - self.errors
        columns = [self.W @ rows.A]
        if self.bilinear:
            linear = unknowns.linear
            of_gains = unknowns.kind_of[linear:].count("drive_gain") + unknowns.kind_of[linear:].count("sensor_scale")
            if of_gains:
                columns.append(-(self.W @ rows.P) * self.clean[:, None, :])
            if "time_offset" in unknowns.kinds:
                rate = np.concatenate([np.gradient(self.clean[part], rows.t[part], axis=0) for part in rows.parts])
                columns.append(-np.einsum("src,sc->sr", lifted, rate)[:, :, None])
        self.columns = np.concatenate(columns, axis=2)  # by x, gains and time offset

    @property
    def counted(self) -> float:
        """The number of rows, less those of measurements that do not count."""
        return self.rows.b.size * float(self.rows.used.mean())

    def slopes_of_all(self, z: Array) -> Array:
        """Return the derivatives of (x, gains, time offset) by z."""
        found = np.eye(len(z))
        linear = self.unknowns.linear
        found[:linear, :linear] = self.unknowns.x(z)[1]
        return found

    def information(self, weights: Array, around: Array | None = None) -> Array:
        """Return F, (p, p), for steps of z or of other coordinates."""
        J = (self.columns * weights[:, :, None]).reshape(-1, len(self.z))
        T = self.slopes_of_all(self.z if around is None else around)
        return T.T @ (J.T @ J) @ T

    def scores(self, weights: Array, around: Array, coloured: bool) -> tuple[Array, list[Autoregression], float]:
        """Return M, (p, p), the processes of the channels, and the variance of their noise in units of the weights'."""
        T, parts = self.slopes_of_all(around), self.rows.parts
        counted = self.lifted * np.where(self.rows.used, self.noise, 0.0)[:, None, :]
        of_errors = np.swapaxes(counted, 1, 2) @ (self.columns * (weights**2)[:, :, None]) @ T
        processes, size = autoregressions(
            errors=np.where(self.rows.used, self.errors / self.noise, 0.0),
            slopes=of_errors,
            shares=np.einsum("src,src->c", counted, counted),
            known=self.unknowns.spread**-2.0,
            parts=parts,
        )
        M = np.zeros((len(self.z), len(self.z)))
        if self.motion:
            raw = np.swapaxes(self.W, 1, 2) @ (self.columns * (weights**2)[:, :, None]) @ T
            for one in self.motion:
                M += one.score(self.rows.N, self.features, raw)
            drawn = np.zeros(len(self.z))
            drawn[: len(self.x)] = sum(one.drawn(self.rows.N, self.features, self.W)[:-1] for one in self.motion)
            M += np.outer(drawn @ T, drawn @ T) / 3.0
        if not coloured or all(len(one.a) == 1 for one in processes):
            if not self.motion:
                return self.information(weights, around), processes, 1.0
            return M + np.einsum("scj,sck->jk", of_errors, of_errors), processes, 1.0
        for c, process in enumerate(processes):
            for part in parts:
                filtered = process.filtered(of_errors[part, c])
                M += filtered.T @ filtered
        return M, processes, size


def _minimum(at: _Point, weights: Array) -> Array:
    """Return the most probable coordinates for given weights."""
    unknowns, z = at.unknowns, at.z
    p, linear = len(z), unknowns.linear
    stacked = np.concatenate([at.columns * weights[:, :, None], (at.whitened * weights)[:, :, None]], axis=2)
    whole = _triangle(stacked.reshape(-1, p + 1))
    R, rest = whole[:, :p], whole[:, p]
    here = np.concatenate([at.x, z[linear:]])
    spread = unknowns.spread

    def residual(w: Array) -> Array:
        given = unknowns.start + spread * w
        value = np.concatenate([unknowns.x(given)[0], given[linear:]])
        return np.concatenate([R @ (value - here) + rest, w])

    def slope(w: Array) -> Array:
        return np.vstack([R @ at.slopes_of_all(unknowns.start + spread * w) * spread, np.eye(p)])

    low = (unknowns.lowest - unknowns.start) / spread
    w = np.maximum((z - unknowns.start) / spread, low)
    bounded = bool(np.isfinite(low).any())
    with np.errstate(all="ignore"):
        found: Any = _bounded(residual, slope, w, low) if bounded else _free(residual, slope, w)
    return unknowns.start + spread * found


def _triangle(x: Array) -> Array:
    """Return R of the QR decomposition of a tall matrix, by blocks that stay in the processor's cache."""
    rows, width = BLOCK * x.shape[1], x.shape[1]
    whole = len(x) - len(x) % rows
    blocks = np.asarray(np.linalg.qr(x[:whole].reshape(-1, rows, width), mode="r")).reshape(-1, width)
    return np.asarray(np.linalg.qr(np.concatenate([blocks, x[whole:]]), mode="r"))


def _free(residual: Any, slope: Any, w: Array) -> Array:
    """Return the least squares without bounds."""
    found: Any = least_squares(residual, w, slope, method="lm", xtol=1e-12, ftol=1e-15, gtol=1e-15, max_nfev=500)
    return found.x


def _bounded(residual: Any, slope: Any, w: Array, low: Array) -> Array:
    """Return the least squares with lower bounds: entries that would fall below theirs are held there in turns."""
    held = np.zeros(len(w), bool)
    for _ in range(MOST_REFITS):
        free = ~held

        base, columns = np.where(free, 0.0, low), np.eye(len(w))[:, free]
        w = base + columns @ _free(*_along(residual, slope, base, columns), w[free])
        below = free & (w < low)
        gradient = slope(w).T @ residual(w)
        pushed = held & (gradient < -1e-9 * max(1.0, float(np.abs(gradient).max())))
        w = np.maximum(w, low)
        if not below.any() and not pushed.any():
            return w
        held = (held & ~pushed) | below
    return w


def _along(residual: Any, slope: Any, base: Array, columns: Array) -> tuple[Any, Any]:
    """Return residuals and derivatives as functions of the coordinates that are free."""
    return (lambda v: residual(base + columns @ v)), (lambda v: slope(base + columns @ v) @ columns)


def _noise(at: _Point, kinds: Array, sizes: Array, information: Array, huber: bool) -> Array:
    """Return the standard deviations of the channels' noise, from the residuals at a point."""
    spent = float(np.trace(np.linalg.solve(information + np.diag(at.unknowns.spread**-2.0), information)))
    few = np.sqrt(at.counted / max(at.counted - spent, 0.1 * at.counted))
    shares, used = np.einsum("src,src->sc", at.lifted, at.lifted) * at.noise**2, at.rows.used
    if huber:
        errors = np.abs(at.errors) / np.sqrt(np.maximum(shares, 1e-12))
        found = [OF_MEDIAN * float(np.median(errors[:, kinds == k][used[:, kinds == k]])) for k in kinds]
        return few * np.array(found)
    if used.all():
        return few * estimated(at.lifted, at.whitened, kinds, sizes, at.share)
    return few * np.array([_pooled(at.errors, shares, (kinds == k) & used) for k in kinds])


def _pooled(errors: Array, shares: Array, counted: Array) -> float:
    """Return the standard deviation of noise of which errors show some share."""
    return float(np.sqrt((errors[counted] ** 2).sum() / max(float(shares[counted].sum()), 1e-12)))


def _shifted(rows: RecordedRows, delay: float) -> Array:
    """Return the measurements a time later, (samples, channels)."""
    return np.concatenate([
        CubicSpline(rows.t[part], rows.y[part])(np.clip(rows.t[part] + delay, rows.t[part][0], rows.t[part][-1]))
        for part in rows.parts
    ])  # fmt: skip
