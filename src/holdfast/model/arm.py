"""Serial arms, and anchors: arms without joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.fingerprint import PICTURE
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.visuals import Visuals
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, changed, frozen_property, making
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array


@called
@dataclass(frozen=True, eq=False)
class Arm(Frozen):
    """A serial chain of joints and links, ordered from base to tip.

    Attributes:
        joints: N >= 1 joints; joint k moves link k. A joint with several degrees of freedom is replaced by as many
            joints with one.
        links: N links; those between the parts of such a joint have no mass.
        tip: pose of the tip frame, which attaches to the object, relative to the last link.
        base: pose of the base frame in the world.
        name: name in messages.
        visuals: appearance according to its file, for the viewer; discarded if the number of links differs.
        notes: notes on what its file has and was not read, or was read differently, for reports.
    """

    joints: Sequence[Joint]
    links: Sequence[Link]
    tip: PoseField = field(default_factory=making(Pose.identity))
    base: PoseField = field(default_factory=making(Pose.identity))
    name: str = ""
    visuals: Visuals | None = field(default=None, metadata=PICTURE)
    notes: Sequence[str] = field(default=(), metadata=PICTURE)

    def __post_init__(self) -> None:
        label, put = self._check_frames(), object.__setattr__
        for part in ("joints", "links"):
            if not isinstance(getattr(self, part), Sequence):
                raise ModelError(f"{label}: {part}: expected a list, got {type(getattr(self, part)).__name__}")
            put(self, part, tuple(getattr(self, part)))
        for part, kind, members in (("joints", Joint, self.joints), ("links", Link, self.links)):
            for k, member in enumerate(members):
                if not isinstance(member, kind):
                    raise ModelError(f"{label}, {part}[{k}]: expected a {kind.__name__}, got {type(member).__name__}")
        if not self.joints:
            raise ModelError(
                f"{label}: expected at least one joint, got none; try holdfast.Anchor(pose), an arm without joints"
            )
        if len(self.joints) != len(self.links):
            raise ModelError(
                f"{label}: expected one link per joint, got {len(self.joints)} joints and {len(self.links)} links"
            )
        pairs = zip(self.joints, self.links, strict=True)
        put(self, "links", tuple(one for joint, link in pairs for one in _links(joint, link)))
        put(self, "joints", tuple(part for joint in self.joints for part in joint.parts))
        put(self, "visuals", fitting_visuals(self.visuals, len(self.links), label))
        put(self, "notes", checked_notes(self.notes, label))

    def _check_frames(self) -> str:
        """Check name, tip and base, and return the label of the arm in messages."""
        kind = type(self).__name__.lower()
        checks.name(self.name, f"{kind}: name")
        label = f"{kind} '{self.name}'" if self.name else kind
        object.__setattr__(self, "tip", checks.pose(self.tip, f"{label}: tip"))
        object.__setattr__(self, "base", checks.pose(self.base, f"{label}: base"))
        return label

    def __repr__(self) -> str:
        """Return the name, the number of joints and the base's position, on one line."""
        joints = f"{self.joint_count} joint{'' if self.joint_count == 1 else 's'}, " if self.joints else ""
        name = f" '{self.name}'" if self.name else ""
        return f"<{type(self).__name__}{name}: {joints}base at {checks.place(self.base.p)} m>"

    @property
    def joint_count(self) -> int:
        """Number of joints N."""
        return len(self.joints)

    @frozen_property
    def length(self) -> float:
        """Sum of the distances from joint to joint and to the tip, without strokes of sliding joints [m]."""
        return math.fsum(math.hypot(*p) for p in (*(j.placement.p for j in self.joints[1:]), self.tip.p))

    def at(self, base: Any) -> Arm:
        """Return the same arm with its base at another pose in the world (a Pose or wxyz_xyz)."""
        return replace(self, base=checks.pose(base, "base"))

    def standing_at(self, base: Pose) -> Arm:
        """Return the same arm with its base at a valid pose, for algorithms; nothing is checked or copied."""
        return changed(self, base=base)

    def of(self, joints: Sequence[Joint] | None = None, links: Sequence[Link] | None = None) -> Arm:
        """Return the same arm with other joints or links, of the same number; None keeps them."""
        return replace(
            self, joints=self.joints if joints is None else joints, links=self.links if links is None else links
        )

    def with_tip(self, tip: Any) -> Arm:
        """Return the same arm with another tip pose relative to the last link, for example that of a tool."""
        return replace(self, tip=checks.pose(tip, "tip"))

    @frozen_property
    def position_limits(self) -> Array:
        """(N, 2) lowest and highest joint positions [rad or m]."""
        return np.array([j.position_limits for j in self.joints]).reshape(-1, 2)

    @frozen_property
    def armature(self) -> Array:
        """(N,) inertia of the drives, reflected to the joints [kg m^2 or kg]."""
        return np.array([j.armature for j in self.joints])

    @frozen_property
    def damping(self) -> Array:
        """(N,) viscous damping [N m s/rad or N s/m]."""
        return np.array([j.damping for j in self.joints])

    @frozen_property
    def stiffness(self) -> Array:
        """(N,) stiffness of the joints' springs [N m/rad or N/m]."""
        return np.array([j.stiffness for j in self.joints])

    @frozen_property
    def rest(self) -> Array:
        """(N,) joint positions at which the springs are slack [rad or m]."""
        return np.array([j.rest for j in self.joints])


def fitting_visuals(visuals: Any, links: int, label: str) -> Visuals | None:
    """Return the visuals if they belong to a base and `links` links; otherwise None.

    Raises:
        ModelError: the argument is not of type Visuals.
    """
    checks.instance(visuals, (Visuals, type(None)), f"{label}: visuals")
    return visuals if visuals is not None and len(visuals.bodies) == links + 1 else None


def checked_notes(notes: Any, label: str) -> tuple[str, ...]:
    """Return notes as a tuple.

    Raises:
        ModelError: the argument is no list of strings.
    """
    listed: tuple[Any, ...] = tuple(notes) if isinstance(notes, Sequence) and not isinstance(notes, str) else (None,)
    if not all(isinstance(note, str) for note in listed):
        raise ModelError(f"{label}: notes: expected a list of strings, got {checks.short(notes)}")
    return listed


def _links(joint: Joint, link: Link) -> tuple[Link, ...]:
    """Return the links that follow the parts of a joint of several freedoms; all but the last are massless."""
    return *(Link(0.0) for _ in joint.parts[1:]), link


@called
@dataclass(frozen=True, eq=False, repr=False)
class Anchor(Arm):
    """An arm without joints, whose grasp attaches the object to the world, to a body of a trunk or to a moving frame.

    It is used like an arm: `ClosedChain(arms={"pin": Anchor(pose)}, grasps={"pin": Grasp("ball", ...)})`. The results
    contain the wrench of its grasp and that of its base, which is the same wrench about the base's origin. Its base
    moves like those of arms: with the trunk's body on which it is mounted, or as prescribed by `Inputs.base_twists` or,
    in a run, by `base_motion`; it then does work. It has no entries in q, and its mobility is zero: Lambda = 0, and
    alpha(0) is known.

    Attributes:
        base: pose of the anchor in the world, or relative to the trunk's link on which it is mounted.
        name: name in messages.
        tip: pose of the tip frame relative to the base; by default the base frame.
        joints: empty.
        links: empty.
    """

    joints: Sequence[Joint] = field(default=(), init=False)
    links: Sequence[Link] = field(default=(), init=False)
    tip: PoseField = field(default_factory=making(Pose.identity), kw_only=True)
    base: PoseField = field(default_factory=making(Pose.identity))
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", ())
        object.__setattr__(self, "links", ())
        self._check_frames()

    def of(self, joints: Sequence[Joint] | None = None, links: Sequence[Link] | None = None) -> Anchor:
        """Return the anchor itself, because it has no joints or links to replace."""
        return self
