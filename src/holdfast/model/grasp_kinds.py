"""The kinds of grasps: one row each, and nothing else in the library compares their names (paper, Appendix A)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from holdfast.model.wrench_condition import MOMENT_Y, MOMENT_Z, NORMAL, Condition, friction_cone
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.spatial.vector import cross

PERPENDICULAR = 1e-6  # sine below which a tip's hinge axis lies along the contact's normal

X = np.eye(3)[0]


def no_turn(tip: Array) -> Array:
    """Return (..., 3) zeros: no attitude of the tip (..., 3, 3) opens the grasp."""
    return np.zeros(tip.shape[:-1])


def full_turn(tip: Array) -> Array:
    """Return the rotation vector from the tip's attitude to the contact frame, (3,) [rad]."""
    return rotation.log(np.swapaxes(tip, -1, -2))


def full_opening(tip: Array) -> Array:
    """Return the rotation vector from the contact frame to the tip's attitude, its length as a sine, (3,)."""
    return 0.5 * array([tip[2, 1] - tip[1, 2], tip[0, 2] - tip[2, 0], tip[1, 0] - tip[0, 1]])


def axis_turn(tip: Array) -> Array:
    """Return the shortest rotation vector from the tip's x axis to the contact frame's, (3,) [rad]."""
    return rotation.align(tip[..., 0], X)


def axis_opening(tip: Array) -> Array:
    """Return the shortest rotation vector from the contact frame's x axis to the tip's, its length as a sine, (3,)."""
    return cross(X, tip[:, 0])


def contact_axes(contact: Array, tip: Array) -> Array:
    """Return the contact frame's attitude, whatever the tip's."""
    return contact


def tip_attitude(contact: Array, tip: Array) -> Array:
    """Return the tip's attitude."""
    return tip


def attitude_about_tip_axis(contact: Array, tip: Array) -> Array | None:
    """Return the attitude nearest to the contact frame's whose x axis is the tip's, or None along its normal."""
    x, normal = tip[:, 0], contact[:, 2]
    across = normal - (normal @ x) * x
    sine = math.sqrt(across @ across)
    if sine < PERPENDICULAR:
        return None
    z = across / sine
    return np.column_stack([x, np.cross(z, x), z])


def sliding(mu: Scalar, size: Scalar) -> tuple[Condition, ...]:
    """Return the conditions of a contact at a point: mu f_n >= |f_t|."""
    return friction_cone(mu)


def sliding_or_spinning(mu: Scalar, size: Scalar) -> tuple[Condition, ...]:
    """Return the conditions of a contact patch of torsion radius e: mu f_n >= sqrt(|f_t|^2 + (m_n/e)^2)."""
    return friction_cone(mu, MOMENT_Z / size)


def sliding_or_tipping(mu: Scalar, size: Scalar) -> tuple[Condition, ...]:
    """Return the conditions of an edge of half length L: mu f_n >= |f_t|, and f_n >= |m_y| / L."""
    return *friction_cone(mu), Condition(0.0, NORMAL, array([MOMENT_Y / size]), "tips over its edge")


@dataclass(frozen=True)
class GraspKind:
    """What distinguishes one kind of grasp from another.

    The tip's attitude seen from the contact frame decides whether the angles of a grasp are closed. Where a
    transmitted moment has no closed angle, the grasp constrains a rate only: it is nonholonomic.

    Attributes:
        free: contact axes about which the object turns against the tip: the columns of h.
        carried_by: the body on which each of these axes is fixed; g = Hdot^T W follows from it.
        closed_angles: contact axes about which the tip may not be turned while the grasp is closed.
        turn: tip's attitude in contact axes (..., 3, 3) -> rotation vector that closes the angles (..., 3) [rad].
        opening: tip's attitude in contact axes (3, 3) -> the opposite of `turn`, its length replaced by its
            sine (3,); on traced numbers too.
        axes: attitudes of contact frame and tip in the world -> axes of freedom and transmission in the world (3, 3).
        regrasped: attitudes of contact frame and tip on the object -> attitude of the nearest contact frame that
            this tip closes (3, 3), or None where there is no nearest one.
        size: the length that a one-sided contact needs, a field of `Friction`.
        friction: friction coefficient and that length -> conditions on the wrench of a one-sided contact; None for
            a grasp that is always two-sided.
        listed_axes: number of unit vectors that a case file lists for such a grasp.
        equality: what an MJCF file says of it: a weld, a connect of two points, or two of them along x; None if it
            cannot be written.
    """

    free: tuple[int, ...]
    carried_by: tuple[Literal["object", "tip", "world"], ...]
    closed_angles: tuple[int, ...] = ()
    turn: Callable[[Array], Array] = no_turn
    opening: Callable[[Array], Array] = no_turn
    axes: Callable[[Array, Array], Array] = contact_axes
    regrasped: Callable[[Array, Array], Array | None] = contact_axes
    size: Literal["torsion_radius", "half_length"] | None = None
    friction: Callable[[Scalar, Scalar], tuple[Condition, ...]] | None = None
    listed_axes: int = 0
    equality: Literal["weld", "connect", "two connects"] | None = None

    @property
    def transmitted(self) -> tuple[int, ...]:
        """Components of a contact-axes wrench [moment; force] that the grasp transmits: the rows of K."""
        return tuple(i for i in range(6) if i not in self.free)

    @property
    def position_rows(self) -> tuple[int, ...]:
        """Components of a contact-axes displacement [turn; shift] that vanish while the grasp is closed."""
        return *self.closed_angles, 3, 4, 5

    @property
    def rate_rows(self) -> tuple[int, ...]:
        """Transmitted components that constrain rates only, as no position row belongs to them."""
        return tuple(i for i in self.transmitted if i not in self.position_rows)

    @property
    def oriented(self) -> bool:
        """Whether the attitude of the contact frame matters: not where all free axes are the world's."""
        return self.carried_by != ("world", "world", "world")

    def axes_carried_by(self, body: str) -> list[int]:
        """Return which of the free axes are fixed on a body."""
        return [k for k, one in enumerate(self.carried_by) if one == body]


GRASP_KINDS: dict[str, GraspKind] = {
    "rigid": GraspKind((), (), (0, 1, 2), full_turn, full_opening, regrasped=tip_attitude, equality="weld"),
    "hinge": GraspKind(
        (0,),
        ("object",),
        (1, 2),
        axis_turn,
        axis_opening,
        regrasped=attitude_about_tip_axis,
        size="half_length",
        friction=sliding_or_tipping,
        listed_axes=1,
        equality="two connects",
    ),
    "softfinger": GraspKind(
        (0, 1),
        ("object", "object"),
        size="torsion_radius",
        friction=sliding_or_spinning,
        listed_axes=2,
        equality="connect",
    ),
    "ball": GraspKind((0, 1, 2), ("world", "world", "world"), friction=sliding, equality="connect"),
}
