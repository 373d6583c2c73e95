"""What is fitted, and its rows in standard deviations of their noise.

In each posture the rows are e = gaps(x, q, y), where y are the poses of free bodies, and joints that were not measured.
Errors of the measured joints enter the covariance of the rows,

    S = S_gaps + J_q S_q J_q^T,    W^T W = S^-1

and y is eliminated by the projection P onto what it does not move, posture by posture (Golub and Pereyra 1973):

    minimise  sum |P W e|^2 + |x / prior|^2,    H = sum (P W J)^T P W J
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.calibration.geometry import OpenGaps, Poses, gaps
from holdfast.calibration.layout import FrameLayout
from holdfast.calibration.noise import ClosureNoise
from holdfast.calibration.placing import placed
from holdfast.errors import StateError
from holdfast.spatial import rotation
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

JOINT_CHANNELS = ("joints turn", "joints shift")
UNKNOWN_NOISE = 1e-3  # [rad or m] before it is estimated
RELATIVE_ROUNDING = 1e-11  # singular values below this, relative to the largest one, are rounding


@dataclass(frozen=True, eq=False)
class Problem(Frozen):
    """What is fitted.

    Attributes:
        layout: the layout.
        q: (postures, n_q) joint positions; NaN where none was measured.
        active: (postures, meetings) whether each closure holds.
        noise: the noise; None to estimate that of angles and lengths from the residuals.
        sizes: (p,) sizes of the unknowns.
        known: (p,) 1 for an unknown with a prior, whose standard deviation is its size; else 0.
        robust: whether postures that fit badly count less.
        noisy_joints: whether the noise of joints is estimated, too, if `noise` is None.
    """

    layout: FrameLayout
    q: Array
    active: Array
    noise: ClosureNoise | None
    sizes: Array
    known: Array
    robust: bool = False
    noisy_joints: bool = False

    @property
    def rows(self) -> list[tuple[int, str]]:
        """Per row of the gaps, its meeting and whether it is a `turn` or a `shift`."""
        return [
            (m, kind)
            for m, meeting in enumerate(self.layout.meetings)
            for kind, number in (("turn", len(meeting.turns)), ("shift", len(meeting.shifts)))
            for _ in range(number)
        ]

    @property
    def channels(self) -> tuple[list[str], Array]:
        """Names of the channels of equal noise, and the channel of every row."""
        labels = []
        for m, kind in self.rows:
            meeting = self.layout.meetings[m]
            labels.append(f"{meeting.name if meeting.measured else 'closures'} {kind}")
        names = list(dict.fromkeys(labels))
        return names, np.array([names.index(one) for one in labels])

    @property
    def joint_channels(self) -> tuple[list[str], Array]:
        """Names of the channels of the joints' noise, if it is to be estimated, and that of every freedom, or -1."""
        kind = self._kind_of_freedom
        sought = self.noisy_joints and self.noise is None
        names = [name for name in JOINT_CHANNELS if sought and (kind == name).any()]
        return names, np.array([names.index(one) if one in names else -1 for one in kind.tolist()], dtype=int)

    @property
    def _kind_of_freedom(self) -> Array:
        kinds: list[str] = []
        for body in self.layout.bodies:
            if body.joint is not None and body.joint.type.quaternion:
                kinds += [""] * 3
            elif body.joint is not None:
                kinds.append(JOINT_CHANNELS[int(not body.joint.type.turns)])
        return np.array(kinds)

    @property
    def active_rows(self) -> Array:
        """(postures, rows) whether each row counts."""
        return self.active[:, [m for m, _ in self.rows]]

    @property
    def position_of_freedom(self) -> Array:
        """Per freedom of the joints, the index of its position in q; -1 for those of spherical joints."""
        found: list[int] = []
        for body in self.layout.bodies:
            if body.joint is not None:
                found += [-1] * 3 if body.joint.type.quaternion else [body.position]
        return np.array(found, dtype=int)

    @property
    def unmeasured(self) -> Array:
        """(postures, n_v) whether each freedom was not measured."""
        at = self.position_of_freedom
        return np.isnan(self.q)[:, at] & (at >= 0)

    def first_variances(self) -> Array:
        """Return the variances of the channels that are given, or those with which to begin; then those of joints."""
        names, _ = self.channels
        if self.noise is None:
            return np.full(len(names) + len(self.joint_channels[0]), UNKNOWN_NOISE**2)
        return np.array([(self.noise.turn if name.endswith("turn") else self.noise.shift) ** 2 for name in names])

    def joint_deviations(self, variances: Array) -> Array:
        """Return the standard deviations of the joints' noise, (n_v,), with variances as in `first_variances`."""
        names, channel = self.joint_channels
        if self.noise is not None:
            return np.broadcast_to(self.noise.joints, len(channel))
        of = np.append(np.sqrt(variances[len(variances) - len(names) :]), 0.0)
        return of[channel]

    def start(self, x: Array) -> FitPoint:
        """Return where the iteration begins: joints that were not measured at 0, free bodies where closures hold."""
        q = np.where(np.isnan(self.q), 0.0, self.q)
        return FitPoint(x, q, placed(self.layout, x, q, self.active))


@dataclass(frozen=True, eq=False)
class FitPoint:
    """Corrections (p,), joint positions (postures, n_q) and the poses of the free bodies."""

    x: Array
    q: Array
    free: dict[int, Poses]

    def moved(self, problem: Problem, dx: Array, dy: Array) -> FitPoint:
        """Return the point after a step of the unknowns and, (postures, y), of free bodies and unmeasured joints."""
        free, q = {}, self.q.copy()
        for k, (body, pose) in enumerate(self.free.items()):
            turn, shift = dy[:, 6 * k : 6 * k + 3], dy[:, 6 * k + 3 : 6 * k + 6]
            R = np.array([rotation.exp(w) for w in turn]) @ pose.R
            free[body] = Poses(R, pose.p + shift)
        for k, freedom in enumerate(np.flatnonzero(problem.unmeasured.any(axis=0)).tolist()):
            q[:, problem.position_of_freedom[freedom]] += dy[:, 6 * len(free) + k]
        return FitPoint(self.x + dx, q, free)


@dataclass(frozen=True, eq=False)
class Whitened:
    """Rows in standard deviations.

    Attributes:
        e: (postures, rows) gaps.
        J: (postures, rows, p) their derivatives by the unknowns, in sizes.
        N: (postures, rows, y) their derivatives by y.
        U: (postures, rows, y) an orthonormal basis of what y moves; zero columns if it is smaller.
        inverse: (postures, y, rows) pseudoinverse of N.
        still: (postures, rows, p) and
        left: (postures, rows) J and e without what y moves.
        sources: (postures, rows, channels' rows + freedoms) what one standard deviation of every gap, and of every
            joint, changes.
    """

    e: Array
    J: Array
    N: Array
    U: Array
    inverse: Array
    still: Array
    left: Array
    sources: Array

    @property
    def information(self) -> Array:
        """H (p, p), in sizes."""
        count, rows, p = self.still.shape
        flat = self.still.reshape(count * rows, p)
        return flat.T @ flat

    @property
    def gradient(self) -> Array:
        """(p,) half the derivative of the sum of squares, in sizes."""
        return np.einsum("kip,ki->p", self.still, self.left)


def evaluated(problem: Problem, at: FitPoint) -> OpenGaps:
    """Return the gaps at a point.

    Raises:
        StateError: they overflow.
    """
    with np.errstate(all="ignore"):
        found = gaps(problem.layout, at.x, at.q, at.free)
        finite = all(np.isfinite(part).all() for part in (found.gaps, found.unknowns, found.joints))
    if not finite:
        raise StateError("calibrate: expected finite gaps, got an overflow of float64; check units and frames")
    return found


def whitened(problem: Problem, here: OpenGaps, variances: Array, weights: Array) -> Whitened:
    """Return the rows in standard deviations, also without what y moves; rows that do not count are zero.

    Args:
        problem: the problem.
        here: gaps and derivatives.
        variances: by channel.
        weights: (postures,) by which variances are divided.
    """
    used = problem.active_rows
    _, channel = problem.channels
    unmeasured = problem.unmeasured
    own = np.broadcast_to(np.diag(np.sqrt(variances[channel])), (len(used), len(channel), len(channel)))
    of_joints = here.joints * np.where(unmeasured, 0.0, problem.joint_deviations(variances))[:, None, :]
    sources = np.concatenate([own, np.where(used[:, :, None], of_joints, 0.0)], axis=2)
    L = np.linalg.cholesky(sources @ np.swapaxes(sources, 1, 2))
    some = np.flatnonzero(unmeasured.any(axis=0))
    moved = np.concatenate([here.free, np.where(unmeasured[:, None, some], here.joints[:, :, some], 0.0)], axis=2)
    p = len(problem.sizes)
    stacked = np.concatenate([here.gaps[:, :, None], here.unknowns * problem.sizes, moved], axis=2)
    scale = np.where(used, np.sqrt(weights)[:, None], 0.0)[:, :, None]
    stacked = scale * np.linalg.solve(L, np.where(used[:, :, None], stacked, 0.0))
    e, J, N = stacked[:, :, 0], stacked[:, :, 1 : 1 + p], stacked[:, :, 1 + p :]
    U, s, V = np.linalg.svd(N, full_matrices=False)
    told = s > RELATIVE_ROUNDING * np.maximum(s.max(axis=1, keepdims=True, initial=0.0), 1e-300)
    U = U * told[:, None, :]
    across = np.swapaxes(U, 1, 2)
    inverse = np.swapaxes(V, 1, 2) @ (np.where(told, 1.0 / np.where(told, s, 1.0), 0.0)[:, :, None] * across)
    left = e - (U @ (across @ e[:, :, None]))[:, :, 0]
    return Whitened(e, J, N, U, inverse, J - U @ (across @ J), left, np.linalg.solve(L, sources))
