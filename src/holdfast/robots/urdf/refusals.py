"""What keeps a way through a robot from being an arm: each refusal names the joint and what to pass."""

from __future__ import annotations

from collections.abc import Mapping

from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.folding import Fold, moving_branches
from holdfast.robots.urdf.locking import Locks
from holdfast.robots.urdf.robot import MOVING, UrdfJoint
from holdfast.robots.urdf.tree import Step


def refuse_unsupported(locks: Locks, steps: list[Step]) -> None:
    """Refuse joints on the way that an arm cannot have: several freedoms, or the motion of another."""
    for joint, down in steps:
        if not joint.is_fixed and joint.kind not in MOVING:
            end, link = ("base", joint.child) if down else ("tip", joint.child)
            raise joint.element.refuse(
                f"type: expected a joint of one freedom between base and tip, got {quoted(joint.kind)};"
                f" try {end}={quoted(link)}"
            )
        if joint.mimic is not None and locks.position(joint) is None:
            raise joint.element.refuse(
                f"mimic: expected joints that move independently, got one that follows"
                f" {quoted(joint.mimic.joint)}; try locked={{{quoted(joint.name)}: 0.0}}"
            )


def refuse_moving_branches(locks: Locks, folded: Fold, steps: list[Step]) -> None:
    """Refuse links that hang on the arm by joints that move."""
    passed = {step.joint.name for step in steps}
    for body in folded.bodies:
        loose = moving_branches(body, passed, locks)
        if odd := [joint for joint in loose if joint.kind not in MOVING]:
            raise odd[0].element.refuse(
                f"type: expected a joint that can be held, since it hangs on the arm, got {quoted(odd[0].kind)}"
            )
        if loose:
            raise loose[0].element.refuse(
                f"moves link {quoted(loose[0].child)}, which hangs on the arm but is not between base and tip;"
                f" {_advice(loose)}"
            )


def _advice(loose: list[UrdfJoint]) -> str:
    """Return what to pass so that these joints are held; those that follow another of them need nothing."""
    names = {joint.name for joint in loose}
    free = [joint.name for joint in loose if joint.mimic is None or joint.mimic.joint not in names]
    some = ", ".join(f"{quoted(name)}: 0.0" for name in free[:8]) + (", ..." if len(free) > 8 else "")
    follows_the_arm = any(joint.mimic is not None and joint.mimic.joint not in names for joint in loose)
    return f"try locked={{{some}}}" + ("" if follows_the_arm else " or lock_others=True")


def refuse_shared(locks: Locks, ways: Mapping[str, list[Step]]) -> None:
    """Refuse a joint that moves two arms."""
    owner: dict[str, str] = {}
    for name, steps in ways.items():
        for joint, _ in steps:
            if locks.pose(joint) is not None:
                continue
            if joint.name in owner:
                raise joint.element.refuse(
                    f"moves both arm '{owner[joint.name]}' and arm '{name}'; try locked={{{quoted(joint.name)}: 0.0}}"
                )
            owner[joint.name] = name
