"""The arms of a URDF file."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

from holdfast.model.arm import Arm
from holdfast.robots.urdf.chain import urdf_chain
from holdfast.robots.urdf.several import urdf_chains


def load_urdf(
    path_or_text: str | PathLike[str],
    *,
    base: str | None = None,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    lock_others: bool = False,
    mount: Any = None,
    physical: bool = True,
    xacro_args: Mapping[str, str] | None = None,
    trust_xacro: bool = False,
) -> Arm:
    """Return the arm between two links of a URDF file. O(links).

    Links that are fixed to one another become one. What hangs on the base does not matter
    and is left out; what hangs on the arm belongs to it, so joints off the way from base
    to tip (fingers, another arm) must be held. `urdf_chain` tells what became of each link.

    Joints keep the file's sign, axis, limits, damping and friction. The base need not be
    the root: joints may be passed from child to parent. A rate or effort limit of 0, and a
    range of 0, count as not given. Angles within 1e-12 rad of a multiple of pi/2 are taken
    as that multiple. A link without <inertial> is massless, and must be fixed to one that
    has mass.

    Args:
        path_or_text: a file, the text itself, or a `.xacro` file (see `read_urdf`).
        base: name of the link that stands still; default: the root.
        tip: name of the link whose frame is the tip; default: the only end link.
        locked: positions to hold joints at [rad or m], by name. A joint that mimics a held
            one is held with it.
        lock_others: hold every joint that hangs on the arm at 0, or at its limit nearest to 0.
        mount: pose of the base link in the world (a Pose or wxyz_xyz); default: the world.
        physical: False accepts principal moments that no mass distribution has.
        xacro_args: values of the file's <xacro:arg> by name.
        trust_xacro: whether to expand a `.xacro` file, which runs the Python in it.

    Raises:
        SceneError: what is wrong or cannot be an arm, with file, line and element, and what to try.
        ModelError: a mount that is no pose.
        MissingExtra: a `.xacro` file without xacrodoc.
    """
    return urdf_chain(
        path_or_text,
        base=base,
        tip=tip,
        locked=locked,
        lock_others=lock_others,
        mount=mount,
        physical=physical,
        xacro_args=xacro_args,
        trust_xacro=trust_xacro,
    ).arm


def load_urdf_arms(
    path_or_text: str | PathLike[str],
    arms: Mapping[str, tuple[str, str]],
    *,
    locked: Mapping[str, float] | None = None,
    lock_others: bool = False,
    mount: Any = None,
    physical: bool = True,
    xacro_args: Mapping[str, str] | None = None,
    trust_xacro: bool = False,
) -> dict[str, Arm]:
    """Return several arms of one robot, each where it stands on it. O(arms links).

        load_urdf_arms("robot.urdf", {"left": ("torso", "left_hand"), "right": ("torso", "right_hand")})

    Links that stand still may be shared. A joint that moves two arms, or an arm's base, must be
    held: `lock_others` holds those that are on no arm's way, a torso below both bases for one, at 0
    or at their limit nearest to 0; `locked` holds any, where it says. One refusal lists them all.

    Args:
        path_or_text: a file, the text itself, or a `.xacro` file (see `read_urdf`).
        arms: names of base and tip link, by arm.
        locked: as for `load_urdf`, for all arms.
        lock_others: as for `load_urdf`.
        mount: pose of the file's root link in the world (a Pose or wxyz_xyz); default: the world.
        physical: as for `load_urdf`.
        xacro_args: as for `load_urdf`.
        trust_xacro: as for `load_urdf`.

    Raises:
        SceneError, ModelError, MissingExtra: as for `load_urdf`.
    """
    chains = urdf_chains(
        path_or_text,
        arms,
        locked=locked,
        lock_others=lock_others,
        mount=mount,
        physical=physical,
        xacro_args=xacro_args,
        trust_xacro=trust_xacro,
    )
    return {name: chain.arm for name, chain in chains.items()}
