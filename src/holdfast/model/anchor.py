"""Anchors: arms without joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.names import called
from holdfast.spatial.converted import making
from holdfast.spatial.pose import Pose, PoseField


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
