"""The kinds of grasps, as one table; no other code depends on their names (paper, Appendix A)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from holdfast.model.bushing import Bushing
from holdfast.model.motion_subspace import MotionSubspace
from holdfast.model.wrench_condition import Condition, sliding, sliding_or_spinning, sliding_or_tipping, standing
from holdfast.spatial import rotation
from holdfast.spatial.frozen import Frozen, frozen_property
from holdfast.spatial.scalar import Array, Scalar, arctan2, array, concatenate, cos, maximum, sin, sqrt, where
from holdfast.spatial.vector import axial, cross

# Functions of the tip's attitude in contact axes, as `turn`, `opening` and `cosine` of `GraspKind`.
_TurnOpeningCosine = tuple[Callable[[Array], Array], Callable[[Array], Array], Callable[[Array], Scalar]]


def no_turn(tip: Array) -> Array:
    """Return zeros (3,), because the attitude of the tip (3, 3) is free."""
    return np.zeros(3)


def no_cosine(tip: Array) -> float:
    """Return 1: there is no angle, or none beyond a quarter turn, which its sine would not show."""
    return 1.0


def full_turn(tip: Array) -> Array:
    """Return the rotation vector from the tip's attitude to the contact frame, (3,) [rad]."""
    return rotation.log(tip.T)


def full_opening(tip: Array) -> Array:
    """Return the rotation vector from the contact frame to the tip's attitude, with the sine as its length, (3,)."""
    return 0.5 * axial(tip)


def turn_of_axis(k: int) -> _TurnOpeningCosine:
    """Return the functions of the shortest turn between axis k of the tip and that of the contact frame."""
    axis = np.eye(3)[k]
    return (
        lambda tip: rotation.align(tip[:, k], axis),
        lambda tip: cross(axis, tip[:, k]),
        lambda tip: tip[k, k],
    )


def cross_turn(tip: Array) -> Array:
    """Return the rotation about z that makes the arms of a cardan cross perpendicular, in its axes, (3,) [rad]."""
    sine = tip[1, 0]
    return array([0.0, 0.0, -arctan2(sine, sqrt(maximum((1.0 - sine) * (1.0 + sine), 0.0)))])


def cross_opening(tip: Array) -> Array:
    """Return the opposite rotation, with the sine as its length, (3,)."""
    return concatenate([np.zeros(2), [tip[1, 0]]])


_FULL = full_turn, full_opening, rotation.cosine
_ABOUT_X = turn_of_axis(0)
_ABOUT_Z = turn_of_axis(2)
_CROSS = cross_turn, cross_opening, no_cosine  # its angle never exceeds a quarter turn


PERPENDICULAR = 1e-6  # sine of the angle below which two directions count as parallel


def cross_axes(contact: Array, tip: Array) -> Array:
    """Return the axes of a cardan cross: y of the contact frame, and x along the tip's x if that is perpendicular."""
    z = cross(tip[:, 0], contact[:, 1])
    z = z / sqrt(z @ z)
    return array([cross(contact[:, 1], z), contact[:, 1], z]).T


def contact_axes(contact: Array, tip: Array) -> Array:
    """Return the contact frame's attitude, whatever the tip's."""
    return contact


def tip_attitude(contact: Array, tip: Array) -> Array:
    """Return the tip's attitude."""
    return tip


def _perpendicular(a: Array, axis: Array) -> Array | None:
    """Return the direction of the part of a vector perpendicular to a unit axis, (3,); None if it is along it."""
    across = a - (a @ axis) * axis
    sine = math.sqrt(across @ across)
    return None if sine < PERPENDICULAR else across / sine


def attitude_about_tip_axis(contact: Array, tip: Array) -> Array | None:
    """Return the attitude with the tip's x axis nearest to the contact frame's; None if x is along its normal."""
    x = tip[:, 0]
    z = _perpendicular(contact[:, 2], x)
    return None if z is None else np.column_stack([x, np.cross(z, x), z])


def attitude_about_tip_normal(contact: Array, tip: Array) -> Array | None:
    """Return the attitude with the tip's z axis that is nearest to the contact frame's; None if z is along its x."""
    z = tip[:, 2]
    x = _perpendicular(contact[:, 0], z)
    return None if x is None else np.column_stack([x, np.cross(z, x), z])


def attitude_across_tip_axis(contact: Array, tip: Array) -> Array | None:
    """Return the attitude nearest to the contact frame's with y perpendicular to the tip's x; None if y is along it."""
    y = contact[:, 1]
    across = _perpendicular(y, tip[:, 0])
    return None if across is None else rotation.exp(rotation.align(y, across)) @ contact


@dataclass(frozen=True)
class GraspKind(Frozen):
    """The properties of one kind of grasp.

    The object moves relative to the tip within a motion subspace that is constant in contact axes, about the tip's
    point; it is spanned by the columns of H^T. The grasp is closed or not depending on the tip's pose relative to the
    contact frame. If a transmitted moment has no closed angle, the grasp constrains a rate only, and is nonholonomic.

    Attributes:
        free: contact axes about which (0, 1, 2) and along which (3, 4, 5) the object can move relative to the tip.
        carried_by: the body in which each of these axes is fixed; it determines g.
        closed_angles: contact axes about which the tip must not be rotated if the grasp is closed.
        turn: function of the tip's attitude in contact axes (3, 3) that returns the rotation vector that closes the
            angles (3,) [rad].
        opening: function of the same that returns the opposite of `turn`, with the sine as its length (3,).
        cosine: function of the same that returns the cosine of that angle; None takes the angle from `turn`, which
            costs more. A negative one belongs to an angle that its sine does not show.
        axes: function of the attitudes of contact frame and tip in the world that returns the axes of the free and
            transmitted directions in the world (3, 3).
        regrasped: function of the attitudes of contact frame and tip relative to the object that returns the attitude
            of the nearest contact frame for which this tip closes the grasp (3, 3), or None if it is not unique.
        size: the field of `Friction` with the length, or the two lengths, that a one-sided contact needs.
        friction: function of the friction coefficient and two lengths, of which a kind with one uses the first, that
            returns the conditions on the wrench of a one-sided contact; None for a grasp that is always two-sided.
        listed_axes: number of unit vectors that a case file lists for such a grasp.
        equality: corresponding MJCF equality constraint: a weld, a connect of two points, or two connects along x; None
            if there is none.
        threaded: whether the object moves along x when it rotates about x, by the grasp's pitch.
        pitch: translation per rotation [m/rad].
        by_hand: whether the grasp has its own motion subspace instead of free axes.
        given: that subspace, which moves with the tip.
        compliant: whether the grasp is a bushing, which exerts a force and imposes no constraint.
        bushing: that bushing.
    """

    free: tuple[int, ...]
    carried_by: tuple[Literal["object", "tip", "world"], ...]
    closed_angles: tuple[int, ...] = ()
    turn: Callable[[Array], Array] = no_turn
    opening: Callable[[Array], Array] = no_turn
    cosine: Callable[[Array], Scalar] | None = None
    axes: Callable[[Array, Array], Array] = contact_axes
    regrasped: Callable[[Array, Array], Array | None] = contact_axes
    size: Literal["torsion_radius", "half_length", "half_lengths"] | None = None
    friction: Callable[[Scalar, Array], tuple[Condition, ...]] | None = None
    listed_axes: int = 0
    equality: Literal["weld", "connect", "two connects"] | None = None
    threaded: bool = False
    pitch: float = 0.0
    by_hand: bool = False
    given: MotionSubspace | None = None
    compliant: bool = False
    bushing: Bushing | None = None

    def with_motion(self, given: MotionSubspace) -> GraspKind:
        """Return the kind with a motion subspace given by the user."""
        k = len(given.columns)
        return replace(self, free=tuple(range(k)), carried_by=("tip",) * k, given=given)

    @property
    def transmitted(self) -> tuple[int, ...]:
        """Indices of the transmitted components of a wrench along `directions`, which are the rows of K."""
        return tuple(i for i in range(6) if i not in self.free)

    @property
    def position_rows(self) -> tuple[int, ...]:
        """Indices of the components of displacements [turn; shift] along `directions` that vanish in a closed grasp."""
        if self.given is not None:
            return self.transmitted
        return *self.closed_angles, *(i for i in (3, 4, 5) if i not in self.free)

    @property
    def rate_rows(self) -> tuple[int, ...]:
        """Indices of the transmitted components that constrain rates only, because they have no position row."""
        return tuple(i for i in self.transmitted if i not in self.position_rows)

    @property
    def oriented(self) -> bool:
        """Whether the attitude of the contact frame matters; it does not if all free axes are those of the world."""
        return self.carried_by != ("world", "world", "world")

    @property
    def crossed(self) -> bool:
        """Whether each body carries one of the axes, as of a cardan cross."""
        return {*self.carried_by} == {"tip", "object"}

    @property
    def slides(self) -> bool:
        """Whether the object slides along the tip; the wrench of the grasp is then about the tip's point."""
        return self.threaded or self.by_hand or any(i > 2 for i in self.free)

    @property
    def aligned(self) -> bool:
        """Whether `directions` are the contact axes themselves."""
        return not self.threaded and self.given is None

    @property
    def follows_tip(self) -> bool:
        """Whether its axes, or the reference point of its wrench, are not fixed in the object."""
        return self.slides or self.axes is not contact_axes

    def row_scales(self, length: Scalar) -> list[Scalar]:
        """Return the size of a wrench along each row of K equivalent to 1 N; moments are divided by `length`."""
        if self.aligned:
            return [length if i < 3 else 1.0 for i in self.transmitted]
        sizes = [
            (math.hypot(*row[:3]) / length, math.hypot(*row[3:])) for row in self.directions[list(self.transmitted)]
        ]
        return [1.0 / sqrt(moment * moment + force * force) for moment, force in sizes]

    @frozen_property
    def angular(self) -> tuple[bool, ...]:
        """Whether each of the `directions` is a moment rather than a force, (6,)."""
        return tuple(math.hypot(*row[:3]) > math.hypot(*row[3:]) for row in self.directions)

    @frozen_property
    def motion(self) -> Array:
        """(6, n_g) H^T in contact axes."""
        if self.given is not None:
            return np.array(self.given.columns).T
        columns = np.eye(6)[:, list(self.free)]
        return columns + self.pitch * np.eye(6)[:, [3]] if self.threaded else columns

    @frozen_property
    def rate_map(self) -> Array:
        """(n_g, 6) matrix from the object's twist relative to the tip, in contact axes, to the relative rates W."""
        return np.linalg.pinv(self.motion)

    @frozen_property
    def directions(self) -> Array:
        """(6, 6) orthonormal rows in contact axes: the free ones span H^T, and the transmitted ones are K.

        For a screw, these are the unit vectors with the first and the fourth rotated in their plane.
        """
        if self.given is not None:
            return np.array(self.given.rows)
        rows = np.eye(6)
        if self.threaded:
            rows[0, 3], rows[3, 0] = self.pitch, -self.pitch
            rows[[0, 3]] /= math.hypot(1.0, self.pitch)
        return rows

    def along(self, x: Array) -> Array:
        """Return the components of a 6-vector in contact axes along `directions`."""
        return x if self.aligned else x @ self.directions.T

    def back(self, x: Array) -> Array:
        """Return the 6-vector in contact axes from components along `directions`."""
        return x if self.aligned else x @ self.directions

    def gap(self, tip: Array, p: Array) -> Array:
        """Return the displacement [turn; shift] of the object relative to the tip, without its free motions.

        Args:
            tip: (3, 3) the tip's attitude in contact axes.
            p: (3,) the tip's origin, along its `axes` [m].

        Returns:
            The displacement (6,), along its `axes`.
        """
        if self.given is not None:
            return self.given.gap(tip, p)
        return concatenate([self.turn(tip), -self.across(p, tip, arctan2)])

    def small_gap(self, tip: Array, p: Array) -> Array:
        """Return the opposite displacement, with sines of angles, (6,)."""
        if self.given is not None:
            return self.given.small_gap(tip, p)
        return concatenate([self.opening(tip), self.across(p, tip, lambda sine, _: sine)])

    def hidden_gap(self, tip: Array, p: Array) -> Scalar:
        """Return the largest gap that `small_gap` does not show, because an angle exceeds a quarter turn; 0 if none.

        See `rotation.beyond_quarter_turn`; the angle past a thread is multiplied by the pitch [rad, or m].
        """
        if self.given is not None:
            return self.given.hidden_gap(tip, p)
        found = self._hidden_angle(tip) if self.closed_angles else 0.0
        if not self.threaded:
            return found
        _, cosine = _sine_cosine_past_thread(p, tip, self.pitch)
        return maximum(found, abs(self.pitch) * rotation.beyond_quarter_turn(cosine))

    def _hidden_angle(self, tip: Array) -> Scalar:
        """Return an angle that exceeds a quarter turn [rad]; 0 for others."""
        if self.cosine is not None:
            return rotation.beyond_quarter_turn(self.cosine(tip))
        turn = self.turn(tip)
        angle = sqrt(turn @ turn)
        return where(angle > 0.5 * math.pi, angle, 0.0)

    def across(self, p: Array, tip: Array, angle: Callable[[Scalar, Scalar], Scalar]) -> Array:
        """Return the displacement of a tip's origin without its free translations, contact axes, (3,) [m].

        For a screw, the component along x is the translation minus that which belongs to the rotation. The nearest of
        the screw's turns is used, because they cannot be distinguished.

        Args:
            p: (3,) the tip's origin, contact axes [m].
            tip: (3, 3) the tip's attitude, contact axes.
            angle: function of sine and cosine of the angle that a screw is past its thread, `arctan2` or the sine.
        """
        if not self.threaded:
            return p * self._closed_lengths if self.slides else p
        sine, cosine = _sine_cosine_past_thread(p, tip, self.pitch)
        return concatenate([[self.pitch * angle(sine, cosine)], p[1:]])

    @property
    def _closed_lengths(self) -> Array:
        return np.array([0.0 if i in self.free else 1.0 for i in (3, 4, 5)])

    def axes_carried_by(self, body: str) -> list[int]:
        """Return the indices of the free axes that are fixed in a body."""
        return [k for k, one in enumerate(self.carried_by) if one == body]


def _sine_cosine_past_thread(p: Array, tip: Array, pitch: float) -> tuple[Scalar, Scalar]:
    """Return sine and cosine, up to a factor, of a tip's translation divided by the pitch minus its rotation."""
    s, c = tip[2, 1] - tip[1, 2], tip[1, 1] + tip[2, 2]
    angle = p[0] / pitch
    return 0.5 * (sin(angle) * c - cos(angle) * s), 0.5 * (cos(angle) * c + sin(angle) * s)


GRASP_KINDS: dict[str, GraspKind] = {
    "rigid": GraspKind((), (), (0, 1, 2), *_FULL, regrasped=tip_attitude, equality="weld"),
    "hinge": GraspKind(
        (0,),
        ("object",),
        (1, 2),
        *_ABOUT_X,
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
    "sole": GraspKind(
        (),
        (),
        (0, 1, 2),
        *_FULL,
        regrasped=tip_attitude,
        size="half_lengths",
        friction=standing,
        equality="weld",
    ),
    "universal": GraspKind(
        (0, 1),
        ("tip", "object"),
        (2,),
        *_CROSS,
        axes=cross_axes,
        regrasped=attitude_across_tip_axis,
    ),
    "slider": GraspKind((3,), ("object",), (0, 1, 2), *_FULL, regrasped=tip_attitude),
    "cylinder": GraspKind((0, 3), ("object", "object"), (1, 2), *_ABOUT_X, regrasped=attitude_about_tip_axis),
    "screw": GraspKind((0,), ("object",), (1, 2), *_ABOUT_X, regrasped=tip_attitude, threaded=True),
    "planar": GraspKind(
        (2, 3, 4),
        ("object", "object", "object"),
        (0, 1),
        *_ABOUT_Z,
        regrasped=attitude_about_tip_normal,
    ),
    "subspace": GraspKind((), (), (0, 1, 2), axes=tip_attitude, regrasped=tip_attitude, by_hand=True),
    "bushing": GraspKind((0, 1, 2, 3, 4, 5), ("tip",) * 6, axes=tip_attitude, regrasped=tip_attitude, compliant=True),
}
