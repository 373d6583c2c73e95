"""A motion subspace given by hand: the group of rigid motions it belongs to, and how far a pose is from that group.

A constant subspace has positions of its own only where it is closed under the bracket of twists: then moving along it
in any way never leads out of a group of as many dimensions. Such a group turns about nothing, about one axis (with a
pitch), or about one point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, cos, sin
from holdfast.spatial.vector import cross

CLOSED = 1e-9  # of unit twists: what is left of a bracket, or of a dependent column
Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class MotionSubspace:
    """Twists of the object against the tip that a grasp leaves free, tip axes about the tip's origin.

    Attributes:
        columns: of H^T, as given.
        rows: (6, 6) orthonormal: as many as there are columns span them, the others are K. No two rows of K share a
            component, whatever length moments are measured by.
        turning: 0, 1 or 3: of how many dimensions its turns are.
        axis: (3,) the axis of one turn.
        point: (3,) on that axis, or the point that all turns leave in its place [m].
        pitch: travel along the axis with each radian [m/rad].
    """

    columns: Rows
    rows: Rows
    turning: int
    axis: tuple[float, ...]
    point: tuple[float, ...]
    pitch: float

    def gap(self, tip: Array, p: Array) -> Array:
        """Return the displacement [turn; shift] of the object against the tip from the nearest pose of the group.

        Args:
            tip: (..., 3, 3) the tip's attitude, contact axes.
            p: (..., 3) the tip's origin from the contact frame's, tip axes [m].

        Returns:
            (..., 6) along K, tip axes, about the tip's origin.
        """
        R, n = np.swapaxes(tip, -1, -2), np.array(self.axis)
        turn = rotation.log(R) if self.turning == 0 else np.zeros(p.shape)
        if self.turning == 1:
            to = R @ n
            turn = rotation.align(np.broadcast_to(n, to.shape), to)
        at = R @ np.array(self.point) - p
        shift = at - np.array(self.point)
        if self.pitch:
            travel = shift @ n
            sine, cosine = self._past_thread(R, travel)
            left = np.asarray(self.pitch * np.arctan2(sine, cosine) - travel)
            shift = shift + left[..., None] * n
        return self._transmitted(np.concatenate([turn, shift - np.cross(turn, at)], -1))

    def small_gap(self, tip: Array, p: Array) -> Array:
        """Return the opposite, angles as sines, (6,); on traced numbers too."""
        R, n = tip.T, np.array(self.axis)
        turn = np.zeros(3)
        if self.turning == 0:
            turn = 0.5 * array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        if self.turning == 1:
            turn = cross(n, R @ n)
        at = R @ np.array(self.point) - p
        shift = at - np.array(self.point)
        if self.pitch:
            travel = shift @ n
            sine, _ = self._past_thread(R, travel)
            shift = shift + (self.pitch * sine - travel) * n
        return -self._transmitted(concatenate([turn, shift - cross(turn, at)]))

    def _past_thread(self, R: Array, travel: Array) -> tuple[Scalar, Scalar]:
        """Return sine and cosine, up to a factor, of the travel over the pitch less the turn about the axis."""
        axial = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
        s, c = 0.5 * (axial @ np.array(self.axis)), 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)
        angle = travel / self.pitch
        return sin(angle) * c - cos(angle) * s, cos(angle) * c + sin(angle) * s

    def _transmitted(self, x: Array) -> Array:
        K = np.array(self.rows[len(self.columns) :])
        return (x @ K.T) @ K


def motion_subspace(motion: Any) -> MotionSubspace:
    """Return a subspace of twists that is a group's.

    Args:
        motion: (6, k) columns [turn; slide], 1 <= k <= 5.

    Raises:
        ModelError: another shape, columns that depend on each other, or twists that are not closed under the bracket.
    """
    S = checks.numbers(motion, None, "grasp: motion")
    if S.ndim != 2 or len(S) != 6 or not 1 <= S.shape[1] <= 5:
        raise ModelError(f"grasp: motion: expected shape (6, k) with k from 1 to 5, got shape {S.shape}")
    Q, sizes, _ = np.linalg.svd(S / np.maximum(np.linalg.norm(S, axis=0), 1e-300), full_matrices=False)
    if not sizes[-1] > CLOSED:
        raise ModelError("grasp: motion: expected linearly independent columns, got dependent ones")
    _require_closed(Q)
    U, turns, Vt = np.linalg.svd(Q[:3])
    r = int((turns > CLOSED).sum())
    slides = Q[3:] @ Vt[r:].T  # (3, k - r)
    across = _complement(slides)
    n, point, pitch = np.zeros(3), np.zeros(3), 0.0
    if r == 0:
        K = np.vstack([np.eye(6)[:3], np.hstack([np.zeros_like(across.T), across.T])])
    elif r == 1:
        n = U[:, 0]
        v = across @ (across.T @ (Q[3:] @ (Vt[0] / turns[0])))
        point, pitch = np.cross(n, v), float(n @ v)
        pitch = pitch if abs(pitch) > CLOSED else 0.0
        forces = _begun_with(v, across).T
        moments = _complement(n[:, None]).T
        K = np.vstack([np.hstack([moments, np.zeros((2, 3))]), np.hstack([-np.outer(forces @ v, n), forces])])
    else:
        V = Q[3:] @ np.linalg.pinv(Q[:3])  # v = V omega, skew
        point = 0.5 * np.array([V[2, 1] - V[1, 2], V[0, 2] - V[2, 0], V[1, 0] - V[0, 1]])
        forces = _begun_with(point, np.eye(3)).T
        K = np.hstack([np.cross(point, forces), forces])
    rows = _plain(np.vstack([Q.T, K / np.linalg.norm(K, axis=1)[:, None]]))
    axis, place = _rows(_plain(np.array([n, point])))
    return MotionSubspace(_rows(S.T), _rows(rows), r, axis, place, pitch)


def _rows(x: Array) -> Rows:
    return tuple(tuple(row) for row in x.tolist())


def _require_closed(Q: Array) -> None:
    """Refuse an orthonormal basis (6, k) of twists whose brackets lie outside of what it spans."""
    for a in Q.T:
        for b in Q.T:
            bracket = np.concatenate([np.cross(a[:3], b[:3]), np.cross(a[:3], b[3:]) + np.cross(a[3:], b[:3])])
            if float(np.abs(bracket - Q @ (Q.T @ bracket)).max()) > CLOSED:
                raise ModelError(
                    "grasp: motion: expected twists closed under the bracket, as those of a joint are, got some"
                    " whose bracket leaves their span, so that no position constraint exists; try a universal or"
                    " softfinger grasp, or fewer twists"
                )


def _complement(vectors: Array) -> Array:
    """Return orthonormal columns (3, 3 - m) across orthonormal ones (3, m)."""
    if not vectors.shape[1]:
        return np.eye(3)
    return np.linalg.svd(vectors)[0][:, vectors.shape[1] :]


def _begun_with(v: Array, basis: Array) -> Array:
    """Return an orthonormal basis of the same span, its first column along a vector in it unless that is 0."""
    size = float(np.linalg.norm(v))
    if size <= CLOSED or basis.shape[1] < 2:
        return basis
    turned = basis.T @ v / size
    return basis @ np.linalg.svd(turned[:, None])[0]


def _plain(x: Array) -> Array:
    """Return an array whose rounding beside zero is zero, so that machine code folds it."""
    return np.where(np.abs(x) < 1e-15, 0.0, x) + 0.0
