"""Directions in which an arm cannot move its tip, as screws in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

LOST = 1e-9  # relative singular value: the direction is gone
NEARLY_LOST = 1e-3  # relative singular value worth a word
PURE = 1e-6  # part of a unit screw that counts as zero


@dataclass(frozen=True, eq=False)
class LostDirection(Frozen):
    """A motion that an arm cannot give its tip where the grasp asks for it.

    The same screw, read as a wrench, loads the arm's structure and none of its drives.

    Attributes:
        arm: its name.
        kind: "translation" along the axis, "rotation" about it (the arm still bears a pure
            moment there), or "screw" (both, coupled).
        axis: (3,) unit vector, world axes.
        point: (3,) a point on the axis, world axes [m].
        strength: relative singular value: 0 is lost, 1e-3 nearly.
        words: all of this in words.
    """

    arm: str
    kind: Literal["translation", "rotation", "screw"]
    axis: Array
    point: Array
    strength: float
    words: str


def lost_directions(name: str, c: Contact, J: Array, tip: Array) -> list[LostDirection]:
    """Return the lost and nearly lost directions of one arm's tip, the weakest first.

    Singular values of K J with moments in units of the arm's own size and each joint's
    column scaled to one, so that neither units nor gear choice decide.

    Args:
        name: the arm's name.
        c: its grasp in motion.
        J: (6, N) tip Jacobian, world axes.
        tip: (3,) tip point, world axes.
    """
    lever = np.linalg.norm(J[3:], axis=0)[np.linalg.norm(J[:3], axis=0) > 0.5]
    length = float(lever.max(initial=0.0)) or 1.0
    unit = np.r_[np.full(3, length), np.ones(3)]  # twists [w length; v]
    KJ = (c.K * unit) @ J
    sizes = np.linalg.norm(KJ, axis=0)
    KJ = KJ[:, sizes > 0] / sizes[sizes > 0]
    U, s, _ = np.linalg.svd(KJ)
    relative = np.zeros(len(KJ))
    relative[: len(s)] = s / max(float(s.max(initial=0.0)), 1e-300)
    lost = relative <= LOST
    directions = [(u, 0.0) for u in _moments_apart(U[:, lost])]
    nearly = np.flatnonzero(~lost & (relative <= NEARLY_LOST))
    directions += [(U[:, k], float(relative[k])) for k in reversed(nearly)]
    # back to [moment; force] about the tip
    return [_described(name, (c.K * unit).T @ u, tip, strength, length) for u, strength in directions]


def _moments_apart(U: Array) -> list[Array]:
    """Return a basis of span(U), rows [.., force], with its pure moments first and apart."""
    if not U.shape[1]:
        return []
    _, sizes, Vt = np.linalg.svd(U[-3:])
    rank = int((sizes > PURE).sum())
    return list((U @ Vt[rank:].T).T) + list((U @ Vt[:rank].T).T)


def _described(arm: str, wrench: Array, tip: Array, strength: float, length: float) -> LostDirection:
    moment, force = wrench[:3], wrench[3:]
    if np.linalg.norm(force) * length > PURE * np.linalg.norm(moment):
        axis = force / np.linalg.norm(force)
        point = tip + np.cross(force, moment) / (force @ force)
        pitch = float(moment @ axis) / float(np.linalg.norm(force))  # [m]
        kind: Literal["translation", "rotation", "screw"] = "translation" if abs(pitch) <= PURE * length else "screw"
    else:
        axis, point, pitch, kind = moment / np.linalg.norm(moment), tip, 0.0, "rotation"
    action = {
        "translation": "move its tip along",
        "rotation": "turn its tip about",
        "screw": f"follow the screw of pitch {pitch:.3g} m along",
    }[kind]
    degree = "cannot" if strength <= LOST else f"can hardly (relative strength {strength:.1e})"
    (ax, ay, az), (px, py, pz) = axis, point
    words = (
        f"arm '{arm}' {degree} {action} ({ax:+.3f}, {ay:+.3f}, {az:+.3f}) through"
        f" ({px:.3f}, {py:.3f}, {pz:.3f}) m, world axes; a load along it is felt by no drive"
    )
    return LostDirection(arm, kind, axis, point, strength, words)
