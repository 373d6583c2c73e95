"""Anchors: arms without joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.spatial.converted import making
from holdfast.spatial.pose import Pose, PoseField


@dataclass(frozen=True, eq=False, repr=False)
class Anchor(Arm):
    """An arm without joints: by its grasp the object is pinned to the world, to a body of a trunk or to a moving place.

    It stands where an arm stands, `ClosedChain(arms={"pin": Anchor(pose)}, grasps={"pin": Grasp("ball", ...)})`, and is
    answered by the wrench of the grasp and by that of its base, which is the same wrench about the base's origin. It
    moves as arms' bases do: in a mounted chain with its body, else as `Inputs.base_twists` says or, in a run, as
    `base_motion` does; then it does work. It has no part in q, and does not yield: Lambda = 0 and alpha(0) is known.

    Attributes:
        base: pose of the anchor in the world, or in the axes of the trunk's link that it is mounted on.
        name: for messages.
        tip: where it touches, in its base's axes: at its base unless something else is said.
        joints, links: none.
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
        """Return the anchor, which has no joints and no links to be replaced."""
        return self
