"""A robot's tree of links and joints as text."""

from __future__ import annotations

from holdfast.robots.urdf.robot import UrdfRobot

_INDENT = 2
_DEEPEST = 40  # levels that are shown by indentation; long chains stay readable


def urdf_tree(robot: UrdfRobot) -> str:
    """Return one line a link, children indented below parents, with the joint that moves it.

        base
          shoulder   joint1: revolute, -2.9 to 2.9 rad, 2.2 rad/s, 87 N m

    O(links).
    """
    lines, waiting = [], [(robot.root, 0)]
    while waiting:
        link, depth = waiting.pop()
        lines.append(" " * (_INDENT * min(depth, _DEEPEST)) + link + _moved_by(robot, link))
        waiting += [(joint.child, depth + 1) for joint in reversed(robot.joints_below[link])]
    return "\n".join(lines)


def _moved_by(robot: UrdfRobot, link: str) -> str:
    """Return the joint above a link and its limits, as far as the file gives them."""
    joint = robot.joint_above.get(link)
    if joint is None:
        return ""
    length, force = ("m", "N") if joint.kind == "prismatic" else ("rad", "N m")
    low, high = joint.position_limits
    said = [joint.kind]
    if low > -float("inf") or high < float("inf"):
        said.append(f"{low:g} to {high:g} {length}")
    if joint.rate_limit < float("inf"):
        said.append(f"{joint.rate_limit:g} {length}/s")
    if joint.effort_limit < float("inf"):
        said.append(f"{joint.effort_limit:g} {force}")
    if joint.mimic is not None:
        said.append(f"follows {joint.mimic.joint}")
    return f"   {joint.name}: {', '.join(said)}"
