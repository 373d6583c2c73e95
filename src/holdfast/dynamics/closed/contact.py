"""The kinematics of one grasp: its place, its free directions, and its transmitted directions (paper, App. A).

V- = V+ + H^T W,                  V- = A V(C) on the object's side, V+ at the tip    (a.6)
alpha- = alpha+ + H^T W_dot + g,  g = Hdot^T W                                       (a.8)
H f = 0  <=>  f = K^T lambda,     K H^T = 0                                          (a.7)

If the object also slides, all three equations are about the tip's point. On the object's side they then refer to the
point of the object that is currently there, and g has an additional Coriolis term, [0; w x (H^T W)_v]
(docs/theory/contacts.md).
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
        R: (3, 3) rotation from the axes of the free and transmitted directions to world axes.
        offset: (3,) l(C, O), from C to the contact point, which is the tip's point if the object slides [m].
        origin: (3,) from C to the origin of the contact frame, which differs from `offset` if the object slides [m].
        frame: (3, 3) attitude of the contact frame.
        rows: indices of the transmitted components along `directions`, which are the rows of K.
        h: (3, n_g) axes of free rotation.
        s: (3, n_g) directions of free sliding, H^T = [h; s]; None if nothing slides.
        W: (n_g,) relative rates, A V(C) - V+ = H^T W [rad/s, m/s].
        velocity_gap: (6 - n_g,) K (A V(C) - V+), which is zero when the velocities agree.
        a: (6,) a(C) = [0; w x (w x l)].
        g: (6,) Hdot^T W = [w x h W; 0] with w of the body in which the axes h are fixed, and the additional term if the
            object slides.
        held: (6,) 1 for the components that are imposed, 0 for those that follow from others (see `held_rows`); None to
            impose every transmitted component whose pivot is not zero.
    """

    grasp: Grasp
    R: Array
    offset: Array
    origin: Array
    frame: Array
    rows: tuple[int, ...]
    h: Array
    s: Array | None
    W: Array
    velocity_gap: Array
    a: Array
    g: Array
    held: Array | None = None

    def transmitted(self, x: Array) -> Array:
        """Return K x, the components of a 6-vector in world axes along the transmitted directions."""
        return self.grasp.of_kind.along(unrotate(self.R, x))[list(self.rows)]

    def transmissible(self, f: Array) -> Array:
        """Return K^T K f, a wrench about the contact in world axes that is exactly 0 along the grasp's freedoms."""
        if len(self.rows) == 6:
            return f
        if not self.rows:
            return np.zeros(6)
        if self.rows == (3, 4, 5) and self.grasp.of_kind.aligned:
            return concatenate([np.zeros(3), f[3:]])
        kind = self.grasp.of_kind
        kept = array([x if i in self.rows else 0.0 for i, x in enumerate(kind.along(unrotate(self.R, f)))])
        return rotate(self.R, kind.back(kept))

    def without_rates(self, rates: Array) -> Array:
        """Return the f with H f = rates and K f = 0, (6,) about the contact, world axes."""
        if self.s is None:
            return concatenate([self.h @ rates, np.zeros(3)])
        return rotate(self.R, rates @ self.grasp.of_kind.rate_map)

    def about(self, centre: Array, centripetal: Array) -> Contact:
        """Return the contact with another point of the object in place of C.

        Args:
            centre: (3,) from C to that point, world axes [m].
            centripetal: (3,) w x (w x centre), 0 for an object at rest [m/s^2].
        """
        a = self.a - concatenate([np.zeros(3), centripetal])
        return replace(self, offset=self.offset - centre, a=a)

    @property
    def K(self) -> Array:
        """(6 - n_g, 6) orthonormal rows along the transmitted directions, for n_g freedoms; world axes."""
        return array([rotate(self.R, row) for row in self.grasp.of_kind.directions[list(self.rows)]]).reshape(-1, 6)

    @property
    def HT(self) -> Array:
        """H^T = [h; s], (6, n_g)."""
        return np.vstack([self.h, 0.0 * self.h if self.s is None else self.s])

    def rates(self, gap: Array) -> Array:
        """Return W, (n_g,), for a 6-vector H^T W in world axes."""
        return gap[:3] @ self.h if self.s is None else self.grasp.of_kind.rate_map @ unrotate(self.R, gap)


def contact(grasp: Grasp, object_frame: Pose, object_twist: Array, tip: Pose, tip_twist: Array) -> Contact:
    """Return the kinematics of a grasp.

    Args:
        grasp: the grasp.
        object_frame: pose of the object (origin C) in the world.
        object_twist: (6,) twist of C, world axes.
        tip: pose of the arm's tip in the world.
        tip_twist: (6,) twist of the arm's tip point, world axes.
    """
    kind, turn = grasp.of_kind, object_twist[:3]
    frame, origin = object_frame.R @ grasp.frame.R, object_frame.R @ grasp.frame.p
    R = kind.axes(frame, tip.R)
    offset = tip.p - object_frame.p if kind.slides else origin
    gap = shift_twist(offset, object_twist) - tip_twist
    s = None
    if kind.slides:
        HT = array([rotate(R, column) for column in kind.motion.T]).T
        h, s, W = HT[:3], HT[3:], kind.rate_map @ unrotate(R, gap)
    else:
        h = np.eye(3) if "world" in kind.carried_by else R[:, list(kind.free)]
        W = gap[:3] @ h
    turning, sliding = np.zeros(3), np.zeros(3)
    for body, w in (("object", turn), ("tip", tip_twist[:3])):
        axes = kind.axes_carried_by(body)
        if axes:
            turning = turning + cross(w, h[:, axes] @ W[axes])
        if axes and s is not None:  # the second w x, because the point moves through the object
            sliding = sliding + cross(w, s[:, axes] @ W[axes]) + cross(turn, s[:, axes] @ W[axes])
    return Contact(
        grasp,
        R,
        offset,
        origin,
        frame,
        kind.transmitted,
        h,
        s,
        W,
        kind.along(unrotate(R, gap))[list(kind.transmitted)],
        concatenate([np.zeros(3), centripetal(turn, offset)]),
        concatenate([turning, sliding]),
    )
