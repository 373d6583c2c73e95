"""Grasps: how an arm's tip is attached to the object (paper, Appendix A)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

GraspKind = Literal["rigid", "hinge", "softfinger", "ball"]

# Contact-axes components of a wrench [mx, my, mz, fx, fy, fz] that the grasp transmits:
# the rows of K, and with it the velocity rows.
TRANSMITTED: dict[str, tuple[int, ...]] = {
    "rigid": (0, 1, 2, 3, 4, 5),
    "hinge": (1, 2, 3, 4, 5),
    "softfinger": (2, 3, 4, 5),
    "ball": (3, 4, 5),
}
# Contact axes about which the object may turn against the tip: the columns of h.
FREE: dict[str, tuple[int, ...]] = {"rigid": (), "hinge": (0,), "softfinger": (0, 1), "ball": (0, 1, 2)}


@dataclass(frozen=True)
class Friction:
    """A one-sided contact: it can only press, and holds within a friction cone.

    Attributes:
        mu: friction coefficient, > 0.
        torsion_radius: e [m]; a soft finger holds |m_n| <= e mu f_n without tangential force.
        half_length: L [m]; half the length of a hinge's edge.
    """

    mu: float
    torsion_radius: float | None = None
    half_length: float | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "mu", checks.number(self.mu, "friction: mu", above=0.0))
        for name in ("torsion_radius", "half_length"):
            if getattr(self, name) is not None:
                put(self, name, checks.number(getattr(self, name), f"friction: {name}", above=0.0))


@dataclass(frozen=True, eq=False)
class Grasp:
    """The attachment of one arm's tip frame to the contact frame on the object.

    The contact frame's z axis is the normal INTO the object: an arm that presses has
    f.z >= 0. A hinge turns about the frame's x axis, a soft finger about x and y.

    Attributes:
        kind: "rigid", "hinge", "softfinger" or "ball".
        frame: pose of the contact frame in object axes.
        contact: None for a two-sided grasp, or a `Friction` for a one-sided one.
    """

    kind: GraspKind
    frame: Pose = field(default_factory=Pose.identity)
    contact: Friction | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(GraspKind):
            raise ModelError(
                f"grasp: kind: expected one of {', '.join(get_args(GraspKind))}, got {self.kind!r}."
                + checks.did_you_mean(str(self.kind), get_args(GraspKind))
            )
        object.__setattr__(self, "frame", checks.pose(self.frame, "grasp: frame"))
        if self.contact is not None:
            self._check_contact(self.contact)

    def _check_contact(self, contact: Friction) -> None:
        needs = {"softfinger": "torsion_radius", "hinge": "half_length"}.get(self.kind)
        if self.kind == "rigid":
            raise ModelError("grasp: a rigid grasp is two-sided; expected contact=None, got Friction")
        if not isinstance(contact, Friction):
            raise ModelError(f"grasp: contact: expected None or Friction, got {type(contact).__name__}")
        for name in ("torsion_radius", "half_length"):
            if (getattr(contact, name) is not None) != (name == needs):
                verb = "needs" if name == needs else "has no"
                raise ModelError(f"grasp: a {self.kind} contact {verb} {name}")

    @property
    def transmitted(self) -> tuple[int, ...]:
        """Components of a contact-axes wrench that the grasp transmits; their number is 6 - n_g."""
        return TRANSMITTED[self.kind]

    @property
    def free(self) -> tuple[int, ...]:
        """Contact axes of free rotation; their number is n_g."""
        return FREE[self.kind]

    @property
    def transmission(self) -> Array:
        """K in contact axes, (6 - n_g, 6)."""
        return np.eye(6)[list(self.transmitted)]
