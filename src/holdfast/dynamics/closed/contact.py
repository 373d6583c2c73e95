"""One grasp in motion: where it is, how it may turn, what it transmits (paper, App. A).

V- = V+ + H^T W,                  V- = A V(C) on the object's side, V+ at the tip    (a.6)
alpha- = alpha+ + H^T W_dot + g,  g = Hdot^T W                                       (a.8)
H f = 0  <=>  f = K^T lambda,     K H^T = 0                                          (a.7)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast.model.grasp import Grasp
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.spatial_vector import centripetal, rotate, shift_twist, unrotate
from holdfast.spatial.vector import cross


@dataclass(frozen=True, eq=False)
class Contact:
    """A grasp at one instant, world axes.

    Attributes:
        grasp: the grasp.
        R: (3, 3) axes of freedom and transmission, to world axes.
        offset: (3,) l(C, O), from C to the contact point [m].
        rows: which components of a wrench along `R` it transmits: the rows of K.
        h: (3, n_g) axes of free rotation.
        W: (n_g,) relative rates, omega_object - omega_tip = h W [rad/s].
        velocity_gap: (6 - n_g,) K (A V(C) - V+): zero when the velocities agree.
        a: (6,) a(C) = [0; w x (w x l)].
        g: (6,) Hdot^T W = [w x h W; 0], w of the body that carries the axes h.
        held: (6,) 1 for the components along `R` that are held, 0 for those that follow from others (see
            `held_rows`); None where every transmitted one is held and its pivot decides.
    """

    grasp: Grasp
    R: Array
    offset: Array
    rows: tuple[int, ...]
    h: Array
    W: Array
    velocity_gap: Array
    a: Array
    g: Array
    held: Array | None = None

    def transmitted(self, x: Array) -> Array:
        """Return K x: the part of a world-axes 6-vector along the transmitted directions."""
        return unrotate(self.R, x)[list(self.rows)]

    def transmissible(self, f: Array) -> Array:
        """Return K^T K f: a wrench about the contact, world axes, free moments taken as exactly 0."""
        if len(self.rows) == 6:
            return f
        if self.rows == (3, 4, 5):
            return concatenate([np.zeros(3), f[3:]])
        kept = array([x if i in self.rows else 0.0 for i, x in enumerate(unrotate(self.R, f))])
        return rotate(self.R, kept)

    def about(self, centre: Array, centripetal: Array) -> Contact:
        """Return the contact as seen from another point of the object than C.

        Args:
            centre: (3,) from C to that point, world axes [m].
            centripetal: (3,) w x (w x centre), 0 for an object at rest [m/s^2].
        """
        a = self.a - concatenate([np.zeros(3), centripetal])
        return replace(self, offset=self.offset - centre, a=a)

    @property
    def K(self) -> Array:
        """(6 - n_g, 6) orthonormal rows along the transmitted directions, world axes."""
        return array([rotate(self.R, row) for row in np.eye(6)[list(self.rows)]])

    @property
    def HT(self) -> Array:
        """H^T = [h; 0], (6, n_g)."""
        return np.vstack([self.h, 0.0 * self.h])


def contact(grasp: Grasp, object_frame: Pose, object_twist: Array, tip: Array, tip_twist: Array) -> Contact:
    """Return the grasp in motion.

    Args:
        grasp: the grasp.
        object_frame: pose of the object (origin C) in the world.
        object_twist: (6,) of C, world axes.
        tip: (3, 3) attitude of the arm's tip in the world.
        tip_twist: (6,) of the arm's tip point, world axes.
    """
    kind = grasp.of_kind
    R = kind.axes(object_frame.R @ grasp.frame.R, tip)
    offset = object_frame.R @ grasp.frame.p
    gap = shift_twist(offset, object_twist) - tip_twist
    h = np.eye(3) if "world" in kind.carried_by else R[:, list(kind.free)]
    W = gap[:3] @ h
    turning = np.zeros(3)
    for body, w in (("object", object_twist[:3]), ("tip", tip_twist[:3])):
        axes = kind.axes_carried_by(body)
        if axes:
            turning = turning + cross(w, h[:, axes] @ W[axes])
    return Contact(
        grasp,
        R,
        offset,
        kind.transmitted,
        h,
        W,
        unrotate(R, gap)[list(kind.transmitted)],
        concatenate([np.zeros(3), centripetal(object_twist[:3], offset)]),
        concatenate([turning, np.zeros(3)]),
    )
