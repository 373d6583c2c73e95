"""Arms and the trunk that they stand on, out of a robot's file: the joints that several arms share are the trunk."""

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
    """Arms and the trunk that they stand on: `ClosedChain(arms, object, grasps, trunk=trunk, mounts=mounts)`.

    Attributes:
        trunk: the joints that arms share, in the file's names; begins with the root's body if that floats.
        arms: by name; the base of an arm in `mounts` is a pose in the axes of the trunk's link that it stands on.
        mounts: that link's name or index by arm, "base" for the body that floats; those in the world are missing.
        locked: where joints within trunk and arms are held [rad or m], by name.
        notes: what was read differently from what the file states, or not at all, with its line.
    """

    trunk: Trunk
    arms: Mapping[str, Arm]
    mounts: Mapping[str, str | int]
    locked: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def mounted_on(self, arm: Arm, at: Any = None) -> ArmsOnTrunk:
        """Return the same on the tip of another arm, such as a hand from a file of its own. O(joints).

        The arm's joints come first in the trunk; the body that floated is welded to its last link.

        Args:
            arm: the arm, where it stands in the world.
            at: pose of the base that floated in the arm's tip frame (a Pose or wxyz_xyz); default: on it.

        Raises:
            ModelError: a base that does not float, or a pose that is none.
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
    """Where a trunk branches: two joints, of which each moves several arms and neither moves the other.

    Attributes:
        joints: the two.
        arms: names of the arms that each moves.
    """

    joints: tuple[Any, Any]
    arms: tuple[list[str], list[str]]


def shared_counts(moving: Mapping[str, Sequence[Hashable]]) -> dict[str, int]:
    """Return how many of its joints, from the base on, each arm shares with another.

    Args:
        moving: by arm, the joints that move on the way to its tip, base outward.
    """
    return {
        name: max((_alike(steps, other) for key, other in moving.items() if key != name), default=0)
        for name, steps in moving.items()
    }


def branching(moving: Mapping[str, Sequence[Hashable]], counts: Mapping[str, int]) -> Branching | None:
    """Return where joints that arms share lie beside the longest row of such joints; None if they are one row."""
    shared = {name: [*steps[: counts[name]]] for name, steps in moving.items()}
    longest = max(shared.values(), key=len)
    for steps in shared.values():
        k = _alike(steps, longest)
        if k < len(steps):
            aside, ahead = ([name for name, path in shared.items() if step in path] for step in (steps[k], longest[k]))
            return Branching((steps[k], longest[k]), (aside, ahead))
    return None


def mount_name(trunk: Trunk, k: int) -> str | int:
    """Return what `mounts` calls the trunk's link k: its name where that tells it from all others, else k."""
    name = trunk.links[k].name
    alone = [link.name for link in trunk.links].count(name) == 1
    return name if name and alone and name != BASE else k


def _alike(one: Sequence[Hashable], other: Sequence[Hashable]) -> int:
    """Return how many joints two paths have in common before they part."""
    return next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
