"""Arms and the trunk on which they are mounted, from a robot's file; the trunk consists of the shared joints."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.link import Link
from holdfast.model.trunk import BASE, Trunk
from holdfast.spatial.inertia import turned, welded
from holdfast.spatial.vector import product


@dataclass(frozen=True, eq=False)
class ArmsOnTrunk:
    """Arms and the trunk on which they are mounted: `ClosedChain(arms, object, grasps, trunk=trunk, mounts=mounts)`.

    Attributes:
        trunk: the joints that arms share, with the names in the file; it begins with the root's body if that floats.
        arms: arms by name; the base of an arm in `mounts` is a pose relative to the trunk's link.
        mounts: name or index of that link by arm, or "base" for the floating body; arms with bases in the world are not
            included.
        locked: positions of locked joints within trunk and arms [rad or m], by name.
        notes: notes, with line numbers, on what was not read, or was interpreted differently from the file.
    """

    trunk: Trunk
    arms: Mapping[str, Arm]
    mounts: Mapping[str, str | int]
    locked: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def mounted_on(self, arm: Arm, at: Any = None) -> ArmsOnTrunk:
        """Return the arms and trunk mounted on the tip of another arm, such as a hand from a separate file. O(joints).

        The joints of the arm come first in the trunk; the floating body is welded to the arm's last link.

        Args:
            arm: the arm, with its base at its pose in the world.
            at: pose of the floating base relative to the arm's tip frame (a Pose or wxyz_xyz); by default that frame.

        Raises:
            ModelError: the base does not float, or the pose is invalid.
        """
        body, last, trunk = self.trunk.floating, arm.links[-1], self.trunk
        if body is None:
            raise ModelError(
                "mounted_on: expected a floating base, whose mass the arm can carry, got one in the world;"
                " try loading the robot with floating=True"
            )
        at = arm.tip if at is None else arm.tip @ checks.pose(at, "at")
        parts = [(last.mass, last.com, last.inertia)]
        parts += [(body.mass, at.p + product(at.R, body.com), turned(body.inertia, at.R))]
        hand = Link(*welded(parts), name=last.name, physical=last.physical and body.physical)
        joints = [replace(joint, placement=at @ joint.placement) for joint in trunk.joints[:1]] + [*trunk.joints[1:]]
        carried = {name: trunk.body(mount, name) for name, mount in self.mounts.items()}
        return replace(
            self,
            trunk=Trunk([*arm.joints, *joints], [*arm.links[:-1], hand, *trunk.links], arm.base),
            arms={name: one if carried[name] else one.at(at @ one.base) for name, one in self.arms.items()},
            mounts={name: arm.joint_count - 1 + k for name, k in carried.items()},
        )


class Branching(NamedTuple):
    """A branching of shared joints: two joints that each move several arms, and do not move each other.

    Attributes:
        joints: the two joints.
        arms: names of the arms that each of them moves.
    """

    joints: tuple[Any, Any]
    arms: tuple[list[str], list[str]]


def shared_counts(moving: Mapping[str, Sequence[Hashable]]) -> dict[str, int]:
    """Return for each arm the number of joints, from the base on, that it shares with another arm.

    Args:
        moving: by arm, the movable joints on the path to its tip, from the base outward.
    """
    return {
        name: max((_alike(steps, other) for key, other in moving.items() if key != name), default=0)
        for name, steps in moving.items()
    }


def branching(moving: Mapping[str, Sequence[Hashable]], counts: Mapping[str, int]) -> Branching | None:
    """Return a branching of the joints that arms share; None if these joints form a single chain."""
    shared = {name: [*steps[: counts[name]]] for name, steps in moving.items()}
    longest = max(shared.values(), key=len)
    for steps in shared.values():
        k = _alike(steps, longest)
        if k < len(steps):
            aside, ahead = ([name for name, path in shared.items() if step in path] for step in (steps[k], longest[k]))
            return Branching((steps[k], longest[k]), (aside, ahead))
    return None


def mount_name(trunk: Trunk, k: int) -> str | int:
    """Return the name of the trunk's link k for `mounts`, or k if the name is not unique."""
    name = trunk.links[k].name
    alone = [link.name for link in trunk.links].count(name) == 1
    return name if name and alone and name != BASE else k


def _alike(one: Sequence[Hashable], other: Sequence[Hashable]) -> int:
    """Return the number of joints that two paths have in common at their beginning."""
    return next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
