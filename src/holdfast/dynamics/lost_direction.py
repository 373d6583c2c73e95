"""Directions in which an arm cannot move its tip, described as screws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

LOST = 1e-9  # relative singular value below which a direction is lost
NEARLY_LOST = 1e-3  # relative singular value below which a direction is reported
PURE = 1e-6  # components of a unit screw below this count as zero


@dataclass(frozen=True, eq=False)
class LostDirection(Frozen):
    """A direction, among those that the grasp transmits, in which an arm cannot move its tip.

    The same screw as a wrench loads the arm's structure, but none of its drives.

    Attributes:
        arm: name of the arm.
        kind: "translation" along the axis, "rotation" about it (the arm resists a pure moment without its drives), or
            "screw" (both, coupled).
        axis: (3,) unit vector, world axes.
        point: (3,) a point on the axis, world axes [m].
        strength: relative singular value; 0 if the direction is lost, 1e-3 if it is nearly lost.
        words: description of the direction.
    """

    arm: str
    kind: Literal["translation", "rotation", "screw"]
    axis: Array
    point: Array
    strength: float
    words: str


def lost_directions(name: str, c: Contact, J: Array, tip: Array) -> list[LostDirection]:
    """Return the lost and nearly lost directions of one arm's tip, the weakest first.

    The result depends neither on the units nor on the scaling of the joints (`tip_directions`).

    Args:
        name: name of the arm.
        c: its contact.
        J: (6, N) tip Jacobian, world axes.
        tip: (3,) tip point, world axes.
    """
    found = tip_directions(c.K, J)
    lost = found.strengths <= LOST
    directions = [(u, 0.0) for u in _moments_apart(found.screws[:, lost])]
    nearly = np.flatnonzero(~lost & (found.strengths <= NEARLY_LOST))
    directions += [(found.screws[:, k], float(found.strengths[k])) for k in reversed(nearly)]
    return [described(name, found, c.K, u, tip, strength) for u, strength in directions]


class TipDirections(NamedTuple):
    """The directions of an arm's tip that its grasp transmits, from the strongest to the weakest.

    Attributes:
        strengths: (rows,) singular values relative to the largest.
        screws: (rows, rows) directions as columns, along the rows of K.
        length: size of the arm, by which moments are divided [m].
    """

    strengths: Array
    screws: Array
    length: float


def tip_directions(K: Array, J: Array) -> TipDirections:
    """Return the singular directions of K J, with moments divided by the arm's size and columns scaled to one.

    Args:
        K: (rows, 6) the transmitted directions, world axes.
        J: (6, N) tip Jacobian, world axes.
    """
    lever = np.linalg.norm(J[3:], axis=0)[np.linalg.norm(J[:3], axis=0) > 0.5]
    length = float(lever.max(initial=0.0)) or 1.0
    KJ = (K * _unit(length)) @ J
    sizes = np.linalg.norm(KJ, axis=0)
    KJ = KJ[:, sizes > 0] / sizes[sizes > 0]
    U, s, _ = np.linalg.svd(KJ)
    relative = np.zeros(len(KJ))
    relative[: len(s)] = s / max(float(s.max(initial=0.0)), 1e-300)
    return TipDirections(relative, U, length)


def _unit(length: float) -> Array:
    return np.r_[np.full(3, length), np.ones(3)]  # twists [w length; v]


def _moments_apart(U: Array) -> list[Array]:
    """Return a basis of span(U), rows [.., force], that begins with the pure moments."""
    if not U.shape[1]:
        return []
    _, sizes, Vt = np.linalg.svd(U[-3:])
    rank = int((sizes > PURE).sum())
    return list((U @ Vt[rank:].T).T) + list((U @ Vt[:rank].T).T)


def described(arm: str, found: TipDirections, K: Array, u: Array, tip: Array, strength: float) -> LostDirection:
    """Return the description of a direction u along the rows of K as a screw; `tip` is the tip point [m]."""
    length, wrench = found.length, (K * _unit(found.length)).T @ u  # [moment; force] about the tip
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
        f" ({px:.3f}, {py:.3f}, {pz:.3f}) m, world axes; a load along it causes no joint torque"
    )
    return LostDirection(arm, kind, axis, point, strength, words)
