"""Grasps, the attachments of arm tips to the object (paper, Appendix A)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from numpy.typing import ArrayLike

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.bushing import bushing
from holdfast.model.fingerprint import ADDED, OMITTED
from holdfast.model.grasp_kinds import GRASP_KINDS, GraspKind
from holdfast.model.motion_subspace import motion_subspace
from holdfast.names import called
from holdfast.spatial.frozen import NOT_GIVEN, Frozen, OptionalArrayField, changed, frozen_property, making
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array

GraspName = Literal[
    "rigid",
    "hinge",
    "softfinger",
    "ball",
    "sole",
    "universal",
    "slider",
    "cylinder",
    "screw",
    "planar",
    "subspace",
    "bushing",
]

LEAST_PITCH = 1e-6  # [m/rad]


@called
@dataclass(frozen=True)
class Friction(Frozen):
    """The friction of a one-sided contact, which can only press and holds within a friction cone.

    Attributes:
        mu: friction coefficient, > 0.
        torsion_radius: e [m]; without a tangential force, a soft finger holds |m_n| <= e mu f_n.
        half_length: L [m], half the length of the edge of a hinge.
        half_lengths: (a, b) [m], half the lengths of a sole along x and y; it tips if |m_y| > a f_n or |m_x| > b f_n.
    """

    mu: float
    torsion_radius: float | None = None
    half_length: float | None = None
    half_lengths: tuple[float, float] | None = field(default=None, metadata=OMITTED)

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "mu", checks.number(self.mu, "friction: mu", above=0.0))
        for name in ("torsion_radius", "half_length"):
            if getattr(self, name) is not None:
                put(self, name, checks.number(getattr(self, name), f"friction: {name}", above=0.0))
        if self.half_lengths is not None:
            given = checks.numbers(self.half_lengths, (2,), "friction: half_lengths")
            both = (checks.number(float(x), "friction: half_lengths", above=0.0) for x in given)
            put(self, "half_lengths", tuple(both))


@called
@dataclass(frozen=True)
class WrenchLimits(Frozen):
    """The largest wrench that a grasp can hold, for example the rating of a gripper.

    Attributes:
        moment: largest |moment| about the contact point, > 0 or inf [N m].
        force: largest |force|, > 0 or inf [N].
    """

    moment: float = math.inf
    force: float = math.inf

    def __post_init__(self) -> None:
        for name in ("moment", "force"):
            object.__setattr__(self, name, checks.limit(getattr(self, name), f"wrench_limits: {name}"))

    @property
    def lever(self) -> float:
        """Length by which moments are divided to compare with forces: moment / force, or 1 m if one is infinite [m]."""
        return self.moment / self.force if math.isfinite(self.moment) and math.isfinite(self.force) else 1.0


@called
@dataclass(frozen=True, eq=False)
class Grasp(Frozen):
    """The attachment of one arm's tip frame to the contact frame on the object.

    The contact frame's z axis is the normal INTO the object, so an arm that presses has f.z >= 0. A sole, the face of a
    foot or a palm, moves as little as a rigid grasp, but may press only. A hinge rotates about the frame's x axis, a
    soft finger about x and y, and a universal joint about the tip's x and the frame's y. A slider
    slides along x, a cylinder slides along x and rotates about it, and a screw couples these two motions. A planar
    grasp slides along x and y and rotates about z. A subspace is any of these, or another group of motions, given by a
    matrix. A bushing imposes no constraint: it is a spring and damper in all six directions, unstretched if the tip is
    at the contact frame, and its wrench follows from the state.

    Attributes:
        kind: "rigid", "hinge", "softfinger", "ball", "sole", "universal", "slider", "cylinder", "screw", "planar",
            "subspace" or "bushing".
        frame: pose of the contact frame in object axes.
        contact: None for a two-sided grasp, or a `Friction` for a one-sided one.
        wrench_limits: the largest moment and force that the grasp can hold, or None.
        pitch: translation of the object along x per radian of rotation about x, for a screw [m/rad]; negative for a
            left-handed screw.
        motion: (6, k) free twists [turn; slide] of the object relative to the tip, in tip axes about the tip's origin,
            for a subspace. They must be closed under the Lie bracket, like those of a joint.
        stiffness: K of a bushing, (6,) or (6, 6), tip axes. The stored energy is 1/2 x . K x, and the wrench is its
            exact gradient; x = [2 sin(t / 2) axis; shift] for a contact frame rotated by t relative to the tip [N m, N,
            N/m].
        damping: C of a bushing, likewise. The dissipated power is V . C V with the rates V = [turn; slide] of the
            object relative to the tip at the contact's origin, tip axes [N m s, N s, N s/m]; None for no damping.
        of: name of the object that is held; None for `held_object`, or for the only one.
    """

    kind: GraspName
    frame: PoseField = field(default_factory=making(Pose.identity))
    contact: Friction | None = None
    wrench_limits: WrenchLimits | None = None
    pitch: float | None = None
    motion: OptionalArrayField = NOT_GIVEN
    stiffness: OptionalArrayField = field(default=NOT_GIVEN, metadata=ADDED)
    damping: OptionalArrayField = field(default=NOT_GIVEN, metadata=ADDED)
    of: str | None = field(default=None, metadata=OMITTED)

    def __post_init__(self) -> None:
        checks.instance(self.of, (str, type(None)), "grasp: of")
        if not isinstance(self.kind, str) or self.kind not in GRASP_KINDS:
            raise ModelError(
                f"grasp: kind: expected one of {', '.join(GRASP_KINDS)}, got {checks.short(self.kind)}."
                + checks.did_you_mean(str(self.kind), GRASP_KINDS)
            )
        object.__setattr__(self, "frame", checks.pose(self.frame, "grasp: frame"))
        if self.contact is not None:
            self._check_contact(self.contact)
        if not isinstance(self.wrench_limits, WrenchLimits | None):
            raise ModelError(
                f"grasp: wrench_limits: expected None or WrenchLimits, got {type(self.wrench_limits).__name__}"
            )

        self._check_pitch()
        if (self.motion is not None) != GRASP_KINDS[self.kind].by_hand:
            needed = "needs a motion, (6, k) twists" if self.motion is None else "has no motion"
            raise ModelError(f"grasp: a {self.kind} grasp {needed}")
        if self.motion is not None:
            object.__setattr__(self, "motion", checks.numbers(self.motion, None, "grasp: motion"))
            _ = self.of_kind  # raises an error if the motions do not form a group
        self._check_bushing()

    def _check_pitch(self) -> None:
        if (self.pitch is not None) != GRASP_KINDS[self.kind].threaded:
            needed = "needs a pitch [m/rad]" if self.pitch is None else "has no pitch"
            raise ModelError(f"grasp: a {self.kind} grasp {needed}")
        if self.pitch is not None:
            pitch = checks.number(self.pitch, "grasp: pitch")
            if not abs(pitch) >= LEAST_PITCH:
                raise ModelError(f"grasp: pitch: expected at least {LEAST_PITCH:g} m/rad, got {pitch!r}; try a hinge")
            object.__setattr__(self, "pitch", pitch)

    def _check_bushing(self) -> None:
        compliant = GRASP_KINDS[self.kind].compliant
        for name in ("stiffness", "damping"):
            given = getattr(self, name)
            if given is not None and not compliant:
                raise ModelError(f"grasp: a {self.kind} grasp has no {name}; try a bushing")
            if given is None and compliant and name == "stiffness":
                raise ModelError(
                    "grasp: a bushing grasp needs a stiffness, (6,) or (6, 6), turns first; try np.zeros(6) for a"
                    " damper alone"
                )
            if given is not None:
                object.__setattr__(self, name, checks.numbers(given, None, f"grasp: {name}"))
        if compliant:
            _ = self.of_kind  # raises an error if a matrix is not positive semidefinite

    def _check_contact(self, contact: Friction) -> None:
        if self.of_kind.friction is None:
            raise ModelError(f"grasp: a {self.kind} grasp is two-sided; expected contact=None, got Friction")
        if not isinstance(contact, Friction):
            raise ModelError(f"grasp: contact: expected None or Friction, got {type(contact).__name__}")
        for name in ("torsion_radius", "half_length", "half_lengths"):
            if (getattr(contact, name) is not None) != (name == self.of_kind.size):
                verb = "needs" if name == self.of_kind.size else "has no"
                raise ModelError(f"grasp: a {self.kind} contact {verb} {name}")

    def standing_at(self, frame: Pose) -> Grasp:
        """Return the same grasp at another valid frame, for algorithms; nothing is checked or copied."""
        return changed(self, frame=frame)

    @frozen_property
    def of_kind(self) -> GraspKind:
        """The properties of its kind, with its pitch, its motion or its bushing."""
        row = GRASP_KINDS[self.kind]
        if self.motion is not None:
            return row.with_motion(motion_subspace(self.motion))
        if row.compliant:
            return replace(row, bushing=bushing(self.stiffness, self.damping))
        return row if self.pitch is None else replace(row, pitch=self.pitch)

    @property
    def transmitted(self) -> tuple[int, ...]:
        """Indices of the transmitted components of a wrench along its kind's `directions`; their number is 6 - n_g."""
        return self.of_kind.transmitted

    @property
    def free(self) -> tuple[int, ...]:
        """Indices of the free contact axes, 0 to 2 for rotations and 3 to 5 for translations; their number is n_g."""
        return self.of_kind.free

    @property
    def transmission(self) -> Array:
        """K in contact axes, (6 - n_g, 6)."""
        return self.of_kind.directions[list(self.transmitted)]

    @property
    def contact_size(self) -> tuple[float, float]:
        """The two lengths that its kind's friction takes [m]: the same twice if it needs one, 1 m if it needs none."""
        name = self.of_kind.size
        size = 1.0 if self.contact is None or name is None else getattr(self.contact, name)
        return size if isinstance(size, tuple) else (size, size)


def contact_frame(point: ArrayLike, into: ArrayLike, x: ArrayLike | None = None) -> Pose:
    """Return the contact frame at a point of the object, with its z axis along the normal into the object.

    The tip frame of a rigid grasp coincides with this frame; a hinge rotates about its x axis.

    Args:
        point: (3,) the contact point from C, object axes [m].
        into: (3,) the normal INTO the object, object axes, of any length.
        x: (3,) direction to which the x axis is as close as possible. By default, x and y are the axes of a camera that
            looks along `into`, with x to the right and y downwards (the object's -z); if `into` is parallel to the
            object's z axis, x is the object's x axis.

    Raises:
        ModelError: a direction has zero length, or `x` is parallel to `into`.
    """
    return Pose.looking(point, z=into, x=x)
