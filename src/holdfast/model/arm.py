"""Arms, serial or with branches, and anchors: arms without joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from holdfast.errors import MethodNotApplicable, ModelError
from holdfast.model import checks
from holdfast.model.closure import Closure, checked_loops
from holdfast.model.coupling import Coupling, checked_couplings
from holdfast.model.fingerprint import OMITTED, PICTURE
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.visuals import Visuals
from holdfast.names import called
from holdfast.spatial.frozen import Converted, Frozen, FrozenDict, changed, frozen_property, making
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array

LinkFrames = Mapping[str, tuple[int, Pose]]  # link and pose on it, by name
IN_SERIES: Any = ()  # Any, because type checkers do not accept a tuple as a `Converted`


@called
@dataclass(frozen=True, eq=False)
class Arm(Frozen):
    """A serial chain of joints and links, ordered from base to tip, or a tree of them if `parents` says so.

    A gripper's fingers, or the rods of a parallelogram, are branches of an arm. What a chain with such an arm can be
    asked is in docs/how_to/branches.md.

    Attributes:
        joints: N >= 1 joints; joint k moves link k. A joint with several degrees of freedom is replaced by as many
            joints with one.
        links: N links; those between the parts of such a joint have no mass.
        tip: pose of the tip frame, which attaches to the object, relative to the last link.
        base: pose of the base frame in the world.
        name: name in messages.
        visuals: appearance according to its file, for the viewer; discarded if the number of links differs.
        notes: notes on what its file has and was not read, or was read differently, for reports.
        parents: per joint, the link on which it stands: the index or the name of an earlier one, or None for the base.
            By default every joint stands on the link before. An arm with branches has no tip.
        frames: by name, further frames on its links, as (link, pose in the link's frame), for grasps and closures.
        couplings: linear relations between its joints, by their names, for example of mimic joints.
        loops: by name, closures between its links, for example of a parallelogram. Their ends are names of links or
            frames; None is the base.
    """

    joints: Sequence[Joint]
    links: Sequence[Link]
    tip: PoseField = field(default_factory=making(Pose.identity))
    base: PoseField = field(default_factory=making(Pose.identity))
    name: str = ""
    visuals: Visuals | None = field(default=None, metadata=PICTURE)
    notes: Sequence[str] = field(default=(), metadata=PICTURE)
    parents: Converted[tuple[int | None, ...], Sequence[int | str | None]] = field(default=IN_SERIES, metadata=OMITTED)
    frames: Converted[LinkFrames, Mapping[str, tuple[int | str, Pose]]] = field(
        default_factory=making(dict), metadata=OMITTED
    )
    couplings: Sequence[Coupling] = field(default=(), metadata=OMITTED)
    loops: Mapping[str, Closure] = field(default_factory=dict, metadata=OMITTED)

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
        last = np.cumsum([len(joint.parts) for joint in self.joints]) - 1  # the link that each joint moves in the end
        put(self, "frames", self._checked_frames(label, last.tolist()))
        put(self, "parents", self._checked_parents(label, last.tolist()))
        if self.parents and not (np.array_equal(self.tip.R, np.eye(3)) and not self.tip.p.any()):
            raise ModelError(
                f"{label}: tip: expected none for an arm with branches, which may end in several; try"
                " frames={'tip': (link, pose)}"
            )
        pairs = zip(self.joints, self.links, strict=True)
        put(self, "links", tuple(one for joint, link in pairs for one in _links(joint, link)))
        put(self, "joints", tuple(part for joint in self.joints for part in joint.parts))
        put(self, "loops", checked_loops(self.loops, label))
        for name, loop in self.loops.items():
            for end in (loop.a, loop.b):
                _ = end is None or self.frame(end, f"{label}: loop '{name}'")
        put(self, "couplings", checked_couplings(self.couplings, label))
        known = [joint.name for joint in self.joints]
        for name in (name for coupling in self.couplings for name in coupling.terms):
            if known.count(name) != 1:
                raise ModelError(
                    f"{label}: coupling: no joint '{name}'.{checks.did_you_mean(name, filter(None, known))}"
                )
        put(self, "visuals", fitting_visuals(self.visuals, len(self.links), label))
        put(self, "notes", checked_notes(self.notes, label))

    def _checked_parents(self, label: str, last: list[int]) -> tuple[int | None, ...]:
        """Return the parent of every part of every joint; nothing for a serial arm."""
        if not isinstance(self.parents, Sequence) or isinstance(self.parents, str):
            raise ModelError(f"{label}: parents: expected a list, got {type(self.parents).__name__}")
        if not self.parents:
            return ()
        if len(self.parents) != len(self.joints):
            raise ModelError(
                f"{label}: parents: expected one per joint, got {len(self.parents)} for {len(self.joints)} joints"
            )
        found: list[int | None] = []
        for k, (joint, given) in enumerate(zip(self.joints, self.parents, strict=True)):
            on = None
            if given is not None:
                at = self._link(given, f"{label}: parents[{k}]")
                if at >= k:
                    raise ModelError(f"{label}: parents[{k}]: expected an earlier link, 0 .. {k - 1}, got {given!r}")
                on = last[at]
            found += [on, *range(len(found), len(found) + len(joint.parts) - 1)]
        return () if found == [None, *range(len(found) - 1)] else tuple(found)

    def _checked_frames(self, label: str, last: list[int]) -> FrozenDict:
        """Return the further frames, with links by their indices."""
        if not isinstance(self.frames, Mapping):
            raise ModelError(f"{label}: frames: expected (link, pose) by name, got {type(self.frames).__name__}")
        found = {}
        for name, given in self.frames.items():
            checks.name(name, f"{label}: name of a frame")
            if not isinstance(given, tuple | list) or len(given) != 2:
                raise ModelError(f"{label}: frame '{name}': expected (link, pose), got {checks.short(given)}")
            what = f"{label}: frame '{name}'"
            found[name] = (last[self._link(given[0], what)], checks.pose(given[1], what))
        return FrozenDict(found)

    def _link(self, link: Any, what: str) -> int:
        """Return the index of a link that is given by its index or name."""
        names = [one.name for one in self.links]
        if isinstance(link, str):
            if names.count(link) == 1 and link:
                return names.index(link)
            known = checks.did_you_mean(link, filter(None, names))
            raise ModelError(f"{what}: {names.count(link) or 'no'} links '{link}'.{known}")
        if not isinstance(link, int | np.integer) or isinstance(link, bool) or not 0 <= link < len(names):
            raise ModelError(f"{what}: expected a link, by its name or 0 .. {len(names) - 1}, got {checks.short(link)}")
        return int(link)

    def frame(self, name: Any, what: str) -> tuple[int, Pose]:
        """Return the link on which a named frame is, and its pose there; a link's own name is that of its frame.

        Args:
            name: name of a frame or a link, or a link's index.
            what: what is attached there, for messages.

        Raises:
            ModelError: there is no such frame; the message suggests one.
        """
        if isinstance(name, str) and name in self.frames:
            return self.frames[name]
        within = f" in arm '{self.name}'" if self.name else ""
        if isinstance(name, str) and name not in [link.name for link in self.links]:
            known = [*self.frames, *filter(None, (link.name for link in self.links))]
            raise ModelError(f"{what}: no link or frame '{name}'{within}.{checks.did_you_mean(name, known)}")
        return self._link(name, f"{what}{within}"), Pose.identity()

    @property
    def is_serial(self) -> bool:
        """Whether its joints are in series, independent, and have one degree of freedom each."""
        return not (self.parents or self.couplings or self.loops or any(joint.type.quaternion for joint in self.joints))

    @property
    def parent_of(self) -> tuple[int | None, ...]:
        """Per joint with one part, the index of the link on which it stands; None for the base."""
        serial: tuple[int | None, ...] = (None, *range(len(self.joints)))[:-1]
        return self.parents or serial

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


def serial_arm(value: Any, what: str) -> None:
    """Check that a value is an arm whose joints are in series and have one degree of freedom each.

    Raises:
        ModelError: it is no arm.
        MethodNotApplicable: it has branches or a spherical joint; the message says what to try.
    """
    checks.instance(value, Arm, what)
    if not value.is_serial:
        coupled = "couplings or loops" if value.couplings or value.loops else "a spherical joint"
        has = "branches" if value.parents else coupled
        raise MethodNotApplicable(
            f"{what}: expected a serial arm, got one with {has}; try it in a ClosedChain, for forward_dynamics"
        )


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
    parents: Converted[tuple[int | None, ...], Sequence[int | str | None]] = field(
        default=IN_SERIES, init=False, metadata=OMITTED
    )
    frames: Converted[LinkFrames, Mapping[str, tuple[int | str, Pose]]] = field(
        default_factory=making(dict), init=False, metadata=OMITTED
    )
    couplings: Sequence[Coupling] = field(default=(), init=False, metadata=OMITTED)
    loops: Mapping[str, Closure] = field(default_factory=dict, init=False, metadata=OMITTED)

    def __post_init__(self) -> None:
        for name in ("joints", "links", "parents", "couplings"):
            object.__setattr__(self, name, ())
        for name in ("frames", "loops"):
            object.__setattr__(self, name, FrozenDict())
        self._check_frames()

    def of(self, joints: Sequence[Joint] | None = None, links: Sequence[Link] | None = None) -> Anchor:
        """Return the anchor itself, because it has no joints or links to replace."""
        return self
