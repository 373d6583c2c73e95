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
        R: (3, 3) contact axes to world axes.
        offset: (3,) l(C, O), from C to the contact point [m].
        h: (3, n_g) axes of free rotation (identity for a ball).
        W: (n_g,) relative rates, omega_object - omega_tip = h W [rad/s].
        velocity_gap: (6 - n_g,) K (A V(C) - V+): zero when the velocities agree.
        a: (6,) a(C) = [0; w x (w x l)].
        g: (6,) Hdot^T W = [w_object x h W; 0], and 0 for a ball (h is fixed in the world).
    """

    grasp: Grasp
    R: Array
    offset: Array
    h: Array
    W: Array
    velocity_gap: Array
    a: Array
    g: Array

    def transmitted(self, x: Array) -> Array:
        """Return K x: the part of a world-axes 6-vector along the transmitted directions."""
        return unrotate(self.R, x)[list(self.grasp.transmitted)]

    def transmissible(self, f: Array) -> Array:
        """Return K^T K f: a wrench about the contact, world axes, free moments taken as exactly 0."""
        if self.grasp.kind == "rigid":
            return f
        if self.grasp.kind == "ball":
            return concatenate([np.zeros(3), f[3:]])
        kept = array([x if i in self.grasp.transmitted else 0.0 for i, x in enumerate(unrotate(self.R, f))])
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
        return array([rotate(self.R, row) for row in self.grasp.transmission])

    @property
    def HT(self) -> Array:
        """H^T = [h; 0], (6, n_g)."""
        return np.vstack([self.h, 0.0 * self.h])


def contact(grasp: Grasp, object_frame: Pose, object_twist: Array, tip_twist: Array) -> Contact:
    """Return the grasp in motion.

    Args:
        grasp: the grasp.
        object_frame: pose of the object (origin C) in the world.
        object_twist: (6,) of C, world axes.
        tip_twist: (6,) of the arm's tip point, world axes.
    """
    R = object_frame.R @ grasp.frame.R
    offset = object_frame.R @ grasp.frame.p
    gap = shift_twist(offset, object_twist) - tip_twist
    h = np.eye(3) if grasp.kind == "ball" else R[:, list(grasp.free)]
    W = gap[:3] @ h
    w = object_twist[:3]
    turning = np.zeros(3) if grasp.kind in ("rigid", "ball") else cross(w, h @ W)
    return Contact(
        grasp,
        R,
        offset,
        h,
        W,
        unrotate(R, gap)[list(grasp.transmitted)],
        concatenate([np.zeros(3), centripetal(w, offset)]),
        concatenate([turning, np.zeros(3)]),
    )
