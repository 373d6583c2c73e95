"""What can be asked of a URDF file: joints to lock, a mount, and how it is read."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from os import PathLike
from typing import Any, TypedDict

from holdfast.errors import CallError
from holdfast.model import checks
from holdfast.names import did_you_mean
from holdfast.robots.urdf.path import Locks, PassedJoint, checked_locks
from holdfast.robots.urdf.reader import read_urdf
from holdfast.robots.urdf.refusals import refuse_unsupported
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.robots.urdf.source import UrdfSource
from holdfast.spatial.pose import Pose


class UrdfOptions(TypedDict, total=False):
    """The keywords that `load_urdf`, `load_urdf_arms`, `load_urdf_trunk`, `urdf_chain` and `urdf_chains` share."""

    locked: Mapping[str, float] | None
    lock_others: bool
    mount: Any
    physical: bool
    xacro_args: Mapping[str, str] | None
    trust_xacro: bool
    packages: Mapping[str, str | PathLike[str]] | None


def read_robot(path_or_text: str | PathLike[str] | UrdfSource, options: UrdfOptions) -> UrdfRobot:
    """Return the links and joints in a file.

    Raises:
        CallError: there is no such option.
        SceneError, MissingExtra: as for `load_urdf`.
    """
    known = UrdfOptions.__annotations__
    if unknown := options.keys() - known.keys():
        hint = did_you_mean(min(unknown), known)
        raise CallError(f"URDF: got an unexpected keyword argument '{min(unknown)}'.{hint}")
    return read_urdf(
        path_or_text,
        xacro_args=options.get("xacro_args"),
        trust_xacro=options.get("trust_xacro", False),
        packages=options.get("packages"),
    )


def locks_of(robot: UrdfRobot, paths: Collection[list[PassedJoint]], options: UrdfOptions) -> Locks:
    """Return the joints that the options lock; those on the paths to the tips must be joints of arms."""
    passed = frozenset(step.joint.name for path in paths for step in path)
    locks = Locks(robot, checked_locks(robot, options.get("locked")), bool(options.get("lock_others")), passed)
    for path in paths:
        refuse_unsupported(locks, path)
    return locks


def mount_of(options: UrdfOptions) -> Pose:
    """Return the option `mount` as a pose; by default the world frame."""
    mount = options.get("mount")
    return Pose.identity() if mount is None else checks.pose(mount, "mount")
