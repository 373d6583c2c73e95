"""Trunks, moving structures on which several arms are mounted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm, checked_notes, fitting_visuals
from holdfast.model.fingerprint import PICTURE
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.visuals import Visuals
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, frozen_property, making
from holdfast.spatial.pose import Pose, PoseField

TRUNK = "trunk"  # name of its joints in flat arrays, which no arm may have
BASE = "base"  # name of the floating body as a mount for arms


def bodies_of(trunk: Trunk | None) -> tuple[Link, ...]:
    """Return the bodies of a trunk from the base outward; none without one."""
    return () if trunk is None else trunk.bodies


@called
@dataclass(frozen=True, eq=False)
class Trunk(Frozen):
    """A serial chain of joints and links on which arms are mounted: a torso, an arm with a hand, a floating base.

    Attributes:
        joints: its joints from the base outward; joint k moves link k. A trunk with a floating base needs none.
        links: its links, one per joint.
        base: pose of its base frame in the world; not used with a floating base, whose pose is part of the state.
        floating: the free body with which the trunk begins, for example a spacecraft; None for a base in the world.
        visuals: appearance, as for an `Arm`.
        notes: notes on its file, as for an `Arm`.
    """

    joints: Sequence[Joint] = ()
    links: Sequence[Link] = ()
    base: PoseField = field(default_factory=making(Pose.identity))
    floating: Link | None = None
    visuals: Visuals | None = field(default=None, metadata=PICTURE)
    notes: Sequence[str] = field(default=(), metadata=PICTURE)

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.floating, Link | None):
            raise ModelError(f"trunk: floating: expected a Link or None, got {type(self.floating).__name__}")
        put(self, "base", checks.pose(self.base, "trunk: base"))
        put(self, "notes", checked_notes(self.notes, TRUNK))
        for part in ("joints", "links"):
            if not isinstance(getattr(self, part), Sequence):
                raise ModelError(f"trunk: {part}: expected a list, got {type(getattr(self, part)).__name__}")
        if not self.joints and not self.links:
            if self.floating is None:
                raise ModelError("trunk: expected at least one joint or a floating base, got neither")
            put(self, "joints", ())
            put(self, "links", ())
            put(self, "visuals", fitting_visuals(self.visuals, 0, TRUNK))
            return
        serial = Arm(self.joints, self.links, base=self.base, name=TRUNK)  # checks and splits joints
        put(self, "joints", serial.joints)
        put(self, "links", serial.links)
        put(self, "visuals", fitting_visuals(self.visuals, len(serial.links), TRUNK))

    def __repr__(self) -> str:
        """Return the number of joints and the base, on one line."""
        base = f"base at {checks.place(self.base.p)} m" if self.floating is None else "a floating base"
        return f"<Trunk: {self.joint_count} joint{'' if self.joint_count == 1 else 's'}, {base}>"

    @frozen_property
    def serial(self) -> Arm | None:
        """Its joints and links as an arm whose tip is the last link's frame; None without joints."""
        return Arm(self.joints, self.links, base=self.base, name=TRUNK) if self.joints else None

    @property
    def joint_count(self) -> int:
        """Number of its joints with one degree of freedom, without a floating base."""
        return len(self.joints)

    @property
    def bodies(self) -> tuple[Link, ...]:
        """The bodies on which arms can be mounted, from the base outward, beginning with a floating body."""
        return (*([] if self.floating is None else [self.floating]), *self.links)

    def split(self, bodies: Sequence[Link]) -> tuple[Link | None, tuple[Link, ...]]:
        """Return the floating body, None without one, and the links, of bodies in the order of `bodies`."""
        first = len(bodies) - len(self.links)
        return bodies[0] if first else None, tuple(bodies[first:])

    @property
    def freedoms(self) -> int:
        """Number of its degrees of freedom: six for a floating base, and one per joint."""
        return self.joint_count + (6 if self.floating is not None else 0)

    def body(self, mount: Any, what: str) -> int:
        """Return the index in `bodies` of the body that `mount` names: a link's name or index, or "base".

        Args:
            mount: a value of `ClosedChain.mounts`.
            what: what is mounted there, for messages.

        Raises:
            ModelError: there is no such body; the message lists the bodies.
        """
        before = len(self.bodies) - len(self.links)
        names = [link.name for link in self.links]
        if mount == BASE and self.floating is not None:
            return 0
        if isinstance(mount, str) and names.count(mount) == 1:
            return before + names.index(mount)
        if isinstance(mount, int | np.integer) and not isinstance(mount, bool) and 0 <= mount < len(self.links):
            return before + int(mount)
        known = [*([BASE] if before else []), *filter(None, names)]
        listed = ", ".join(map(repr, known)) or "none with a name"
        raise ModelError(
            f"{what}: expected a link of the trunk, by its name ({listed}) or by its index"
            f" 0 .. {len(self.links) - 1}, got {checks.short(mount)}"
        )
