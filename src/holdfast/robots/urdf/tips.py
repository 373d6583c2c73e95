"""Which links an arm begins and ends at when the caller does not say."""

from __future__ import annotations

from collections.abc import Container

from holdfast.errors import SceneError
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.robots.urdf.tree import known_link


def ends(robot: UrdfRobot, base: str | None, tip: str | None, locked: Container[str]) -> tuple[str, str]:
    """Return base and tip: the root, and the only end link beyond a moving joint, unless given.

    Raises:
        SceneError: an unknown link, or no or several tips to choose from, with their names.
    """
    start = robot.root if base is None else known_link(robot, base, "base")
    if tip is not None:
        return start, known_link(robot, tip, "tip")
    counts = _moving_joints(robot, start, locked)
    tips = [link for link, count in counts.items() if count and not robot.joints_below[link]]
    if not tips:
        raise robot.element.refuse(
            f"tip: no moving joint below base {quoted(start)}; try another base, or name the tip"
        )
    if len(tips) > 1:
        raise _choice(robot, start, sorted(tips, key=lambda link: -counts[link]), counts)
    return start, tips[0]


def _moving_joints(robot: UrdfRobot, start: str, locked: Container[str]) -> dict[str, int]:
    """Return how many joints that move lie between a link and each link below it, itself included."""
    counts, waiting = {start: 0}, [start]
    while waiting:
        link = waiting.pop()
        for joint in robot.joints_below[link]:
            counts[joint.child] = counts[link] + (not joint.is_fixed and joint.name not in locked)
            waiting.append(joint.child)
    return counts


def _choice(robot: UrdfRobot, start: str, tips: list[str], counts: dict[str, int]) -> SceneError:
    """Return the refusal that lists the tips, longest arms first, and where they part."""
    shown = [f"{quoted(link)} ({counts[link]})" for link in tips[:12]]
    if len(tips) > 12:
        shown.append(f"{len(tips) - 12} more")
    fork = _fork(robot, start, tips)
    parting = f"; they part at {quoted(fork)} ({counts[fork]})" if counts[fork] else ""
    best = fork if 0 < counts[fork] < counts[tips[0]] else tips[0]
    return robot.element.refuse(
        f"tip: expected a link's name, since there are several ends (with so many joints): {', '.join(shown)}"
        f"{parting}; try tip={quoted(best)}"
    )


def _fork(robot: UrdfRobot, start: str, tips: list[str]) -> str:
    """Return the last link that is on the way from the start to every tip."""
    on_the_way = {start}
    for link in tips:
        while link not in on_the_way:
            on_the_way.add(link)
            link = robot.joint_above[link].parent
    fork = start
    while len(onward := [j.child for j in robot.joints_below[fork] if j.child in on_the_way]) == 1:
        fork = onward[0]
    return fork
