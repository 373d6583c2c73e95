"""What the noise of recorded positions does to the equations, of which it changes the coefficients.

The errors of smoothing splines, of known covariance, change the residuals rows @ features by G = motions @ H, with
sensitivities H found by differences in some of the samples, and between them by interpolation, since motions are
smooth. As forces along all freedoms (H instead of G), they do not depend on the basis of a sample's rows, and those on
an object that turns freely in its grasps, which no measurement shows, are among them.

Errors that do not depend on the smoothed values do not draw estimates. The recorded motion of a floating base tells of
true accelerations, beside which they act as noise in the coefficients. How much lies between nothing and all that such
noise would draw, c: the scores get the mean square of a share that may be anything between 0 and 1, c c^T / 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_solve_banded
from scipy.sparse import csr_array

from holdfast.identification.completed import Smoothed
from holdfast.identification.equations import Equations, payload_forces
from holdfast.identification.payload_unknowns import Settings
from holdfast.identification.recording import Recording
from holdfast.identification.smoothing import Spline
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.joint_friction import friction_slope, joint_friction
from holdfast.spatial.scalar import Array

NODES, A_PERIOD, AT_ENDS = (40, 400), 8, 4  # samples with sensitivities: of all, per period, at each end
DIFFERENCE = 1e-6  # of the differences [rad, m, ...]


@dataclass(frozen=True, eq=False)
class JointNoise:
    """The errors of one joint's smoothed positions, rates and accelerations in one recording.

    Attributes:
        spline: the joint's spline.
        samples: the samples of the equations that belong to the recording.
        evaluations: of the spline, only for the samples that the equations have.
        covariance: (samples, k, k) covariance of the k errors in each of these samples.
        sensitivities: (nodes, k, freedoms, features) H for each of the features.
            Without dry friction, which changes too fast where a joint turns back.
        nodes: (nodes,) times at which these are known.
        t: (samples,) times.
        rubbing: (samples, k, freedoms) derivatives of a dry friction of unit size by the k errors.
        friction: (features,) by which the features give the size of the joint's dry friction.
        told: whether the rows have a recorded motion of a floating base, which tells of these errors.
    """

    spline: Spline
    samples: slice
    evaluations: list[csr_array]
    covariance: Array
    sensitivities: Array
    nodes: Array
    t: Array
    rubbing: Array
    friction: Array
    told: bool

    def spread(self, motions: Array, features: Array) -> Array:
        """Return (samples, r, r), the covariance of the residuals of rows along motions (samples, r, freedoms)."""
        G = self._of_rows(motions, features)
        return np.einsum("sra,sab,stb->srt", G, self.covariance, G)

    def score(self, motions: Array, features: Array, slopes: Array) -> Array:
        """Return the covariance (k, k) of the sum of slopes^T residuals, for slopes (samples, r, k)."""
        G = self._of_rows(motions, features)
        parts = np.einsum("srk,sra->ask", slopes[self.samples], G)
        weights = [E.T @ part for E, part in zip(self.evaluations, parts, strict=True)]
        return self.spline.covariance(np.sum(weights, axis=0))

    def drawn(self, motions: Array, features: Array, weights: Array) -> Array:
        """Return (features,), the mean of coefficients^T residuals if coefficients have these errors; 0 if none tells.

        Args:
            motions: (samples, r, freedoms) along which the rows are.
            features: (features,) their values.
            weights: (samples, r, r) which whiten the rows.
        """
        if not self.told:
            return np.zeros(len(features))
        H = _at_all(self.nodes, self.sensitivities, self.t)
        G = np.einsum("str,srf,safp->satp", weights[self.samples], motions[self.samples], H, optimize=True)
        return np.einsum("sab,satp,sbt->p", self.covariance, G, G @ features, optimize=True)

    def _of_rows(self, motions: Array, features: Array) -> Array:
        H = _at_all(self.nodes, self.sensitivities @ features, self.t) + self.rubbing * float(self.friction @ features)
        return np.einsum("srf,saf->sra", motions[self.samples], H)


def motion_noise(
    recordings: list[tuple[Recording, list[Smoothed]]],
    kept: list[Array],
    as_forces: Callable[[Sequence[Recording]], list[Array]],
    friction: Array,
) -> list[JointNoise]:
    """Return the errors of all joints whose positions (or rates) are not exact.

    The cost is that of the equations of at most 400 samples, three times for each joint.

    Args:
        recordings: recordings with joint rates and accelerations, and what was smoothed to find these.
        kept: by recording, which samples the equations have.
        as_forces: returns (samples, freedoms, features) of each of some recordings, the rows without dry friction as
            forces along all freedoms.
        friction: (n, features) by which the features give the sizes of the joints' dry friction; 0 if it does not
            enter.
    """
    found, first = [], 0
    for (recording, smoothed), those in zip(recordings, kept, strict=True):
        samples = slice(first, first + int(those.sum()))
        first = samples.stop
        if not any(spline.noise for one in smoothed for spline in one.splines):
            continue
        nodes = _nodes(recording, those)
        part = recording.part(nodes)
        noisy = [(one, joint) for one in smoothed for joint, spline in enumerate(one.splines) if spline.noise]
        changed = [_moved(part, name, joint) for one, joint in noisy for name in one.names]
        at_nodes, *moved = as_forces([part, *changed])
        changes = iter(moved)
        for one, joint in noisy:
            spline = one.splines[joint]
            H = np.stack([(next(changes) - at_nodes) / DIFFERENCE for _ in one.names], axis=1)
            t = recording.t[those]
            evaluations = [E[np.flatnonzero(those)] for E in spline.evaluations[: len(one.names)]]
            C = _at_all(recording.t[nodes], _covariances(spline, len(one.names), nodes), t, smooth=False)
            rubbing = np.zeros((len(t), len(one.names), at_nodes.shape[1]))
            if friction[joint].any() and "qd" in one.names and recording.qd is not None:
                slopes = friction_slope(np.ones(1), recording.qd[those, joint][None])
                rubbing[:, one.names.index("qd"), joint] = slopes[0]
            rest = (C, H, recording.t[nodes], t, rubbing, friction[joint], recording.base_acceleration is not None)
            found.append(JointNoise(spline, samples, evaluations, *rest))
    return found


def payload_noise(
    chain: ClosedChain, recordings: list[tuple[Recording, list[Smoothed]]], settings: Settings, system: Equations
) -> list[JointNoise]:
    """Return the errors of all joints in the equations of a payload."""
    friction = np.zeros((chain.joint_count, system.rows.shape[2]))
    if settings.source == "tau":
        friction[:, -4 if settings.gravity else -1] = joint_friction(chain)
    as_forces = partial(payload_forces, chain, settings=settings)
    return motion_noise(recordings, system.kept, as_forces, friction)


def _nodes(recording: Recording, kept: Array) -> Array:
    """Return the samples at which sensitivities are found: some in each period of the fastest joint."""
    assert recording.qd is not None and recording.qdd is not None
    count, t = len(recording), recording.t
    rates, accelerations = (np.sqrt((x * x).mean(axis=0)) for x in (recording.qd, recording.qdd))
    fastest = float((accelerations / np.maximum(rates, 1e-6)).max())  # rad/s
    wanted = np.clip(A_PERIOD * fastest * (t[-1] - t[0]) / (2.0 * np.pi), *NODES)
    ends = np.r_[np.arange(min(AT_ENDS, count)), np.arange(max(count - AT_ENDS, 0), count)]
    nodes = np.unique(np.r_[ends, np.linspace(0, count - 1, min(int(wanted), count)).round().astype(int)])
    return nodes[kept[nodes]] if kept[nodes].any() else np.flatnonzero(kept)[:1]


def _moved(recording: Recording, name: str, joint: int) -> Recording:
    """Return a recording in which one joint's position, rate or acceleration is larger by a step."""
    x = getattr(recording, name).copy()
    x[:, joint] += DIFFERENCE
    return replace(recording, **{name: x})


def _covariances(spline: Spline, count: int, nodes: Array) -> Array:
    """Return (nodes, count, count), the covariance of a spline's value and derivatives."""
    rows = np.stack([E[nodes].toarray() for E in spline.evaluations[:count]])  # (count, nodes, K)
    solved = cho_solve_banded((spline.triangle, True), rows.reshape(-1, rows.shape[2]).T).T.reshape(rows.shape)
    return spline.noise**2 * np.einsum("ank,bnk->nab", rows, solved)


def _at_all(nodes: Array, values: Array, t: Array, smooth: bool = True) -> Array:
    """Return values, which are known at some times, at all times."""
    if len(nodes) < 4:
        return np.repeat(values[:1], len(t), axis=0)
    if smooth:
        return CubicSpline(nodes, values)(t)
    flat = values.reshape(len(nodes), -1)
    return np.column_stack([np.interp(t, nodes, column) for column in flat.T]).reshape(len(t), *values.shape[1:])
