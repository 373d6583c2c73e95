"""What each kind of grasp transmits, as rows that the relative motion of object and tip has no component along.

A row (m, n) says m . w + n . v = 0, w and v being the angular velocity of the object against the tip's link and the
velocity of the object's against the link's point where the tip is. Differentiated, the row turns with the body it is
fixed on. A wrench is a sum of rows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tests.oracles.arithmetic import Arithmetic
from tests.oracles.arm_kinematics import cross

# by kind: axes of the contact frame about which it transmits moments, and along which it transmits forces
AXES = {
    "rigid": ("xyz", "xyz"),
    "hinge": ("yz", "xyz"),
    "softfinger": ("z", "xyz"),
    "ball": ("", "xyz"),
    "universal": ("", "xyz"),
    "slider": ("xyz", "yz"),
    "cylinder": ("yz", "yz"),
    "screw": ("yz", "yz"),
    "planar": ("xy", "z"),
}


class Row(NamedTuple):
    """One row, world axes.

    Attributes:
        m, n: (3,) moment and force.
        m_dot, n_dot: (3,) their rates.
    """

    m: np.ndarray
    n: np.ndarray
    m_dot: np.ndarray
    n_dot: np.ndarray


class Side(NamedTuple):
    """A body at the contact.

    Attributes:
        R: (3, 3) contact frame on the object, tip frame on the link, to world axes.
        omega: (3,) of the body.
    """

    R: np.ndarray
    omega: np.ndarray


def grasp_rows(grasp, held: Side, tip: Side, numbers: Arithmetic) -> list[Row]:
    """Return the rows of a grasp.

    Args:
        grasp: its kind, pitch and motion are read.
        held: contact frame and object.
        tip: tip frame and last link.
        numbers: arithmetic.
    """
    if grasp.kind == "subspace":
        return [_fixed(tip, row[:3], row[3:]) for row in complement(numbers.array(grasp.motion).T, numbers)]
    axes, none = dict(zip("xyz", numbers.array(np.eye(3)), strict=True)), numbers.array(np.zeros(3))
    moments, forces = AXES[grasp.kind]
    rows = [_fixed(held, axes[a], none) for a in moments] + [_fixed(held, none, axes[a]) for a in forces]
    if grasp.kind == "universal":  # across the tip's x and the object's y
        x, y = tip.R[:, 0], held.R[:, 1]
        turned = cross(cross(tip.omega, x), y) + cross(x, cross(held.omega, y))
        rows.append(Row(cross(x, y), none, turned, none))
    if grasp.kind == "screw":
        pitch = numbers.array(grasp.pitch)[()]
        rows.append(_fixed(held, -pitch * axes["x"], axes["x"]))
    return rows


def complement(motions: np.ndarray, numbers: Arithmetic) -> list[np.ndarray]:
    """Return orthogonal 6-vectors that span what is orthogonal to some, by Gram and Schmidt."""
    spanned: list[np.ndarray] = []
    for one in motions:
        spanned.append(_without(one, spanned))
    free, units = len(spanned), list(numbers.array(np.eye(6)))
    while len(spanned) < 6:
        left = [_without(unit, spanned) for unit in units]
        spanned.append(max(left, key=lambda x: x @ x))
    return spanned[free:]


def _without(x: np.ndarray, spanned: list[np.ndarray]) -> np.ndarray:
    for one in spanned:
        x = x - (x @ one) / (one @ one) * one
    return x


def _fixed(side: Side, m: np.ndarray, n: np.ndarray) -> Row:
    """Return a row that is fixed on a body, given in its frame's axes."""
    m, n = side.R @ m, side.R @ n
    return Row(m, n, cross(side.omega, m), cross(side.omega, n))
