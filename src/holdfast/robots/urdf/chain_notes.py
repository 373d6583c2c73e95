"""The notes on a chain: on its links and joints, on couplings that have no effect on it, and on its tip."""

from __future__ import annotations

from collections.abc import Collection, Container, Sequence

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.tip_direction import tip_advice, tip_angle
from holdfast.robots.urdf.bodies import FoldedChain
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.path import Locks
from holdfast.robots.urdf.robot import MOVING_KINDS, WORLD_LINK, UrdfJoint, UrdfRobot

SAME_PLACE = 1e-6  # [m] distance below which the origins of two frames are at the same place
UPRIGHT = 0.1  # [rad] largest angle between z and the direction to the tip


def read_within(locks: Locks, folded: FoldedChain) -> tuple[dict[str, float], list[str], list[str]]:
    """Return the positions of locked joints within a chain and its base, the notes on its links and joints, and frames.

    Those are links without mass and shape. They are noted, too, but there is no need to warn of them.
    """
    robot = locks.robot
    inside = {name: robot.links[name] for links in (folded.on_base, *folded.moving) for name in links}
    within = [joint for joint in robot.joints.values() if joint.parent in inside and joint.child in inside]
    locked = {j.name: q for j in within if not j.is_fixed and (q := locks.position(j)) is not None}
    notes = [note for part in (robot, *inside.values(), *within) for note in part.notes]
    moving = [robot.links[name] for links in folded.moving for name in links]
    massless = [link.element for link in moving if link.inertial is None]
    shaped = [element for element in massless if any(map(element.first, ("visual", "collision")))]
    said = {element: element.message("no <inertial>, taken as massless") for element in massless}
    faults = [joint.fault for joint in robot.joints.values() if joint.fault is not None]
    notes += [f"{fault}; not read, since the joint does not move here" for fault in dict.fromkeys(faults)]
    notes += [*map(said.pop, shaped), *_locked_notes(locks, within)]
    return locked, notes, [*said.values()]


def _locked_notes(locks: Locks, within: list[UrdfJoint]) -> list[str]:
    """Return notes on joints whose lock is no plain answer to `lock_others`."""
    notes = []
    for joint in within:
        if joint.kind not in MOVING_KINDS and not joint.is_fixed and locks.passes_over(joint):
            notes.append(joint.element.message(f"{joint.kind}, locked in the pose of its <origin>"))
        elif joint.mimic is None or joint.name in locks.given or (q := locks.position(joint)) is None:
            continue
        elif joint.mimic.joint not in locks.robot.joints:
            notes.append(joint.element.message(f"mimic: no joint {quoted(joint.mimic.joint)}; locked at {q:g}"))
        elif joint.name in locks.on_path:
            why = f"since it mimics {quoted(joint.mimic.joint)}, which is locked"
            notes.append(joint.element.message(f"locked at {q:g}, {why}"))
    return notes


def tip_note_of(robot: UrdfRobot, arm: Arm, tip: str, folded: FoldedChain) -> str:
    """Return the note on a tip whose z axis does not point out of the hand, with better links at this place, or ''."""
    if not (advice := tip_advice(arm)):
        return ""
    better = [
        f"tip={quoted(name)}"
        for name, at in folded.bodies[-1].links.items()
        if np.allclose(at.p, arm.tip.p, rtol=0, atol=SAME_PLACE) and tip_angle(arm.with_tip(at)) < UPRIGHT
    ]
    others = f", or {' or '.join(better[:3])}, a frame at the same place" if better else ""
    return robot.links[tip].element.message(f"as a tip: {advice}{others}")


def coupling_notes(
    robot: UrdfRobot, bodies: Sequence[Collection[str]], joints: Container[str], floats: bool = False
) -> list[str]:
    """Return notes on couplings without effect, whose ends are on one moving body.

    Args:
        robot: the robot.
        bodies: names of the links of each body; the first is the base.
        joints: names of the joints that move.
        floats: whether the base is a free body.

    Raises:
        SceneError: a coupling acts on a body that moves.
    """
    at = {link: k for k, links in enumerate(bodies) for link in links}
    world = -2 if floats else 0
    notes = []
    for coupling in robot.couplings:
        places = {world if link == WORLD_LINK and link not in at else at.get(link, -1) for link in coupling.links}
        moving = {k for k in places if k > 0 or (floats and k == 0)}
        acts = any(joint in joints for joint in coupling.joints)
        if acts or (moving and len(places) > 1) or len(coupling.links | coupling.joints) < 2:
            ends = " and ".join(quoted(one) for one in sorted(coupling.links or coupling.joints)) or "no known link"
            raise coupling.element.refuse(
                f"closes a loop, which a serial arm cannot contain: it couples {ends}; try locking the joints between"
                " them (locked=, lock_others=True), or deleting it if no arm passes through it"
            )
        if moving:
            notes.append(
                coupling.element.message("not read, since it has no effect between links that are locked together")
            )
    return notes
