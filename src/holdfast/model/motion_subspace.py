"""Motion subspaces given by the user: the corresponding group of rigid motions, and the distance of a pose from it.

A constant subspace of twists corresponds to a set of poses only if it is closed under the Lie bracket: motions along it
then stay in a group of the same dimension. The rotations of such a group are none, those about one axis (with a pitch),
or those about one point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial import rotation
from holdfast.spatial.linalg import without_overflow
from holdfast.spatial.scalar import Array, Scalar, arctan2, concatenate, cos, maximum, sin
from holdfast.spatial.vector import axial, cross

GROUP_TOLERANCE = 1e-9  # tolerance, for unit twists, of dependent columns and of brackets outside the span
MatrixRows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class MotionSubspace:
    """The free twists of the object relative to the tip, in tip axes about the tip's origin.

    Attributes:
        columns: columns of H^T, as given.
        rows: (6, 6) orthonormal rows: the first ones span the columns, and the others are K. The rows of K are
            orthogonal for any length by which moments are divided.
        turning: dimension of its rotations, 0, 1 or 3.
        axis: (3,) axis of the rotation if there is one.
        point: (3,) a point on that axis, or the centre of all rotations [m].
        pitch: translation along the axis per radian [m/rad].
    """

    columns: MatrixRows
    rows: MatrixRows
    turning: int
    axis: tuple[float, ...]
    point: tuple[float, ...]
    pitch: float

    def gap(self, tip: Array, p: Array) -> Array:
        """Return the displacement [turn; shift] of the object relative to the tip from the nearest pose of the group.

        Args:
            tip: (3, 3) the tip's attitude in contact axes.
            p: (3,) the tip's origin relative to that of the contact frame, tip axes [m].

        Returns:
            The displacement (6,) along K, in tip axes about the tip's origin.
        """
        R, n = tip.T, np.array(self.axis)
        turn = rotation.log(R) if self.turning == 0 else np.zeros(3)
        if self.turning == 1:
            turn = rotation.align(n, R @ n)
        return self._gap(R, p, turn, arctan2)

    def small_gap(self, tip: Array, p: Array) -> Array:
        """Return the opposite displacement, with sines of angles, (6,)."""
        R, n = tip.T, np.array(self.axis)
        turn = np.zeros(3)
        if self.turning == 0:
            turn = 0.5 * axial(R)
        if self.turning == 1:
            turn = cross(n, R @ n)
        return -self._gap(R, p, turn, lambda sine, _: sine)

    def hidden_gap(self, tip: Array, p: Array) -> Scalar:
        """Return the largest gap that `small_gap` does not show, because an angle exceeds a quarter turn; 0 if none."""
        R, n = tip.T, np.array(self.axis)
        cosine = (rotation.cosine(R), n @ (R @ n), 1.0)[min(self.turning, 2)]
        found = rotation.beyond_quarter_turn(cosine)
        if not self.pitch:
            return found
        point = np.array(self.point)
        _, cosine = self._past_thread(R, (R @ point - p - point) @ n)
        return maximum(found, abs(self.pitch) * rotation.beyond_quarter_turn(cosine))

    def _gap(self, R: Array, p: Array, turn: Array, angle: Callable[[Scalar, Scalar], Scalar]) -> Array:
        """Return the transmitted part of [turn; shift], with the angle past a thread of its sine and cosine."""
        n, point = np.array(self.axis), np.array(self.point)
        at = R @ point - p
        shift = at - point
        if self.pitch:
            travel = shift @ n
            shift = shift + (self.pitch * angle(*self._past_thread(R, travel)) - travel) * n
        K = np.array(self.rows[len(self.columns) :])
        return (concatenate([turn, shift - cross(turn, at)]) @ K.T) @ K

    def _past_thread(self, R: Array, travel: Scalar) -> tuple[Scalar, Scalar]:
        """Return sine and cosine, up to a factor, of the translation divided by the pitch, minus the rotation."""
        s, c = 0.5 * (axial(R) @ np.array(self.axis)), rotation.cosine(R)
        angle = travel / self.pitch
        return sin(angle) * c - cos(angle) * s, cos(angle) * c + sin(angle) * s


def motion_subspace(motion: Any) -> MotionSubspace:
    """Return the motion subspace spanned by given twists, which must be that of a group.

    Args:
        motion: (6, k) columns [turn; slide], 1 <= k <= 5.

    Raises:
        ModelError: the shape is wrong, the columns are dependent, or the twists are not closed under the Lie bracket.
    """
    S = checks.numbers(motion, None, "grasp: motion")
    if S.ndim != 2 or len(S) != 6 or not 1 <= S.shape[1] <= 5:
        raise ModelError(f"grasp: motion: expected shape (6, k) with k from 1 to 5, got shape {S.shape}")
    scaled = without_overflow(S, axis=0)
    Q, sizes, _ = np.linalg.svd(scaled / np.maximum(np.linalg.norm(scaled, axis=0), 1e-300), full_matrices=False)
    if not sizes[-1] > GROUP_TOLERANCE:
        raise ModelError("grasp: motion: expected linearly independent columns, got dependent ones")
    _require_closed(Q)
    U, turns, Vt = np.linalg.svd(Q[:3])
    r = int((turns > GROUP_TOLERANCE).sum())
    slides = Q[3:] @ Vt[r:].T  # (3, k - r)
    across = _complement(slides)
    n, point, pitch = np.zeros(3), np.zeros(3), 0.0
    if r == 0:
        K = np.vstack([np.eye(6)[:3], np.hstack([np.zeros_like(across.T), across.T])])
    elif r == 1:
        n = U[:, 0]
        v = across @ (across.T @ (Q[3:] @ (Vt[0] / turns[0])))
        point, pitch = np.cross(n, v), float(n @ v)
        pitch = pitch if abs(pitch) > GROUP_TOLERANCE else 0.0
        forces = _basis_starting_with(v, across).T
        moments = _complement(n[:, None]).T
        K = np.vstack([np.hstack([moments, np.zeros((2, 3))]), np.hstack([-np.outer(forces @ v, n), forces])])
    else:
        V = Q[3:] @ np.linalg.pinv(Q[:3])  # v = V omega, skew
        point = 0.5 * axial(V)
        forces = _basis_starting_with(point, np.eye(3)).T
        K = np.hstack([np.cross(point, forces), forces])
    rows = _plain(np.vstack([Q.T, K / np.linalg.norm(K, axis=1)[:, None]]))
    axis, place = rows_of(_plain(np.array([n, point])))
    return MotionSubspace(rows_of(S.T), rows_of(rows), r, axis, place, pitch)


def rows_of(x: Array) -> MatrixRows:
    """Return a matrix as a tuple of rows, which can be compared and hashed."""
    return tuple(tuple(row) for row in x.tolist())


def _require_closed(Q: Array) -> None:
    """Refuse an orthonormal basis (6, k) of twists whose Lie brackets lie outside its span."""
    for a in Q.T:
        for b in Q.T:
            bracket = np.concatenate([np.cross(a[:3], b[:3]), np.cross(a[:3], b[3:]) + np.cross(a[3:], b[:3])])
            if float(np.abs(bracket - Q @ (Q.T @ bracket)).max()) > GROUP_TOLERANCE:
                raise ModelError(
                    "grasp: motion: expected twists closed under the bracket, as those of a joint are, got some"
                    " whose bracket leaves their span, so that no position constraint exists; try a universal or"
                    " softfinger grasp, or fewer twists"
                )


def _complement(vectors: Array) -> Array:
    """Return orthonormal columns (3, 3 - m) that are perpendicular to given orthonormal ones (3, m)."""
    if not vectors.shape[1]:
        return np.eye(3)
    return np.linalg.svd(vectors)[0][:, vectors.shape[1] :]


def _basis_starting_with(v: Array, basis: Array) -> Array:
    """Return an orthonormal basis of the same span with its first column along v, unless v is 0."""
    size = float(np.linalg.norm(v))
    if size <= GROUP_TOLERANCE or basis.shape[1] < 2:
        return basis
    turned = basis.T @ v / size
    return basis @ np.linalg.svd(turned[:, None])[0]


def _plain(x: Array) -> Array:
    """Return an array with rounding errors replaced by exact zeros, so that the compiler can drop them."""
    return np.where(np.abs(x) < 1e-15, 0.0, x) + 0.0
