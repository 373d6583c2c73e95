"""Several arms out of one robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Unpack

from holdfast.robots.urdf.chain import UrdfChain, UrdfOptions, chain_of, mounted
from holdfast.robots.urdf.document import quoted
from holdfast.robots.urdf.folding import fold
from holdfast.robots.urdf.locking import Locks, checked_locks, resting_position
from holdfast.robots.urdf.reading import read_urdf
from holdfast.robots.urdf.refusals import hanging, refuse_loose, refuse_unsupported, shared, under_bases
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
    for steps in ways.values():
        refuse_unsupported(locks, steps)
    bases = {name: base for name, (base, _) in ends_of.items()}
    loose = [*shared(locks, ways), *under_bases(locks, bases)]
    resting = {joint.name: resting_position(joint) for joint, _ in loose}
    held_too = replace(locks, given={**resting, **held})  # so that one refusal tells what would still move then
    folds = {name: fold(base, ways[name], held_too) for name, base in bases.items()}
    loose += [one for name, folded in folds.items() for one in hanging(held_too, folded, ways[name])]
    refuse_loose(locks, loose)
    mount, chains = mounted(options), {}
    for name, base in bases.items():
        at, notes = _standing(locks, base)
        chain = chain_of(locks, base, folds[name], ways[name], mount @ at, options)
        chains[name] = replace(chain, notes=(*notes, *chain.notes))
    return chains


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


def _standing(locks: Locks, base: str) -> tuple[Pose, list[str]]:
    """Return the pose of an arm's base link in the root link's frame, and notes on joints below it held unasked."""
    at, notes = Pose.identity(), []
    for joint, _ in way(locks.robot, locks.robot.root, base):
        across, q = locks.pose(joint), locks.position(joint)
        assert across is not None
        at = at @ across
        if q is not None and joint.name not in locks.given:
            notes.append(joint.element.said(f"held at {q:g}, since it moves the base {quoted(base)}"))
    return at, notes
