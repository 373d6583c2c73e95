"""Several arms out of one robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Unpack

from holdfast.robots.urdf.chain import UrdfChain, UrdfOptions, chain_along, mounted
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.locking import Locks, checked_locks
from holdfast.robots.urdf.reading import read_urdf
from holdfast.robots.urdf.refusals import refuse_shared
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.robots.urdf.tree import known_link, way
from holdfast.spatial.pose import Pose


def urdf_chains(
    path_or_text: str | PathLike[str], arms: Mapping[str, tuple[str, str]], **options: Unpack[UrdfOptions]
) -> dict[str, UrdfChain]:
    """Return what `load_urdf_arms` loads, with what became of every link, and notes. O(arms links).

    Args:
        path_or_text: as for `load_urdf_arms`.
        arms: as for `load_urdf_arms`.
        **options: as for `load_urdf_arms`.

    Raises:
        SceneError, ModelError, MissingExtra: as for `load_urdf_arms`.
    """
    robot = read_urdf(path_or_text, xacro_args=options.get("xacro_args"), trust_xacro=options.get("trust_xacro", False))
    held = checked_locks(robot, options.get("locked"))
    ends_of = _ends_of_arms(robot, arms)
    ways = {name: way(robot, base, tip) for name, (base, tip) in ends_of.items()}
    passed = frozenset(step.joint.name for steps in ways.values() for step in steps)
    locks = Locks(robot, held, bool(options.get("lock_others")), passed)
    refuse_shared(locks, ways)
    mount = mounted(options)
    mounts = {name: mount @ _standing(locks, name, base) for name, (base, _) in ends_of.items()}
    return {name: chain_along(locks, base, ways[name], mounts[name], options) for name, (base, _) in ends_of.items()}


def _ends_of_arms(robot: UrdfRobot, arms: Mapping[str, tuple[str, str]]) -> dict[str, tuple[str, str]]:
    """Return base and tip link of each arm, checked."""
    if not isinstance(arms, Mapping) or not arms:
        raise robot.element.refuse("arms: expected (base, tip) by name, such as {'left': ('torso', 'left_hand')}")
    found = {}
    for name, pair in arms.items():
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise robot.element.refuse(
                f"arm '{name}': expected the names of base and tip link, got {quoted(str(pair))}"
            )
        base, tip = (
            known_link(robot, link, f"arm '{name}': {end}") for link, end in zip(pair, ("base", "tip"), strict=True)
        )
        found[name] = (base, tip)
    return found


def _standing(locks: Locks, name: str, base: str) -> Pose:
    """Return the pose of an arm's base link in the root link's frame; joints between them must be held by name."""
    at, given = Pose.identity(), replace(locks, others=False)
    for joint, _ in way(locks.robot, locks.robot.root, base):
        across = given.pose(joint)
        if across is None:
            raise joint.element.refuse(
                f"moves the base {quoted(base)} of arm '{name}'; try locked={{{quoted(joint.name)}: 0.0}}"
            )
        at = at @ across
    return at
