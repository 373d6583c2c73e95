"""Robots by name from the package `robot_descriptions`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from holdfast.errors import MissingExtra, SceneError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.robots.notes import show_notes
from holdfast.robots.urdf import urdf_chain


def load_robot_description(
    name: str, *, xacro_args: Mapping[str, str] | None = None, trust_xacro: bool = False, **options: Any
) -> Arm:
    """Return an arm by name, for example `load_robot_description("panda_description", tip="panda_hand", ...)`.

    Args:
        name: a name in `robot_descriptions`.
        xacro_args: values for the <xacro:arg> elements, if the description is a xacro file.
        trust_xacro: whether to expand a xacro file, which runs the Python code in it.
        **options: base, tip, locked, lock_others, mount and physical of `load_urdf`.

    Warns:
        ModelWarning: as for `load_urdf`.

    Raises:
        SceneError: the name is unknown, or the description cannot be fetched; and as for `load_urdf`.
        MissingExtra: the extra `robots` is not installed.
    """
    chain = urdf_chain(robot_description_path(name, xacro_args=xacro_args, trust_xacro=trust_xacro), **options)
    show_notes(chain.arm.notes)
    return chain.arm


def robot_description_path(name: str, *, xacro_args: Mapping[str, str] | None = None, trust_xacro: bool = False) -> str:
    """Return the path of a description's URDF file, for `load_urdf_arms`, `load_urdf_trunk` and `urdf_chain`.

    The package downloads a description when it is first used, and stores it. Xacro files are expanded into its cache.

    Args:
        name: a name in `robot_descriptions`, with or without `_description`.
        xacro_args: values for the <xacro:arg> elements, if the description is a xacro file.
        trust_xacro: whether to expand a xacro file, which runs the Python code in it.

    Raises:
        SceneError: the name is unknown, or the description cannot be fetched or expanded.
        MissingExtra: the extra `robots` is not installed.
    """
    try:
        known = import_module("robot_descriptions").DESCRIPTIONS
        paths = import_module("robot_descriptions._xacro")
    except ImportError as cause:
        raise MissingExtra(
            f"robot '{name}': needs robot_descriptions >= 3.3; try pip install 'holdfast[robots]'"
        ) from cause
    full = name if name in known else f"{name}_description"
    if full not in known or not known[full].has_urdf:
        with_urdf = [other for other, description in known.items() if description.has_urdf]
        raise SceneError(f"robot_descriptions: no URDF named '{name}'.{checks.did_you_mean(full, with_urdf)}")
    try:
        module = import_module(f"robot_descriptions.{full}")
        if not hasattr(module, "URDF_PATH") and trust_xacro is not True:
            raise SceneError(
                f"robot_descriptions: '{full}' is a xacro file, and expanding it runs the Python code in it; if"
                " you trust those who published it, try trust_xacro=True"
            )
        return paths.get_urdf_path(module, xacro_args=dict(xacro_args) if xacro_args else None)
    except SceneError:
        raise
    except Exception as cause:  # git, network, file system, xacro
        reason = re.sub(r"\s+", " ", f"{type(cause).__name__}: {cause}")[:300]
        raise SceneError(
            f"robot_descriptions: '{full}' is not available: {reason}; it needs the network once"
            " (kept in $ROBOT_DESCRIPTIONS_CACHE or ~/.cache/robot_descriptions), or pass the path of a URDF"
        ) from cause
