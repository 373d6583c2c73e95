"""Every public name, where a user finds it: at the top or in the namespace of its theme."""

from importlib import import_module
from typing import Any

THEMES = (
    "assembly", "calibration", "codegen", "compiled", "control", "dynamics", "forces", "gym", "identification",
    "interop", "io", "planning", "plot", "robots", "simulation", "sweeps", "world",
)  # fmt: skip


def names_of(theme: str) -> dict[str, Any]:
    """Return the public names of one namespace; "" is the top."""
    module = import_module(f"holdfast.{theme}".rstrip("."))
    names = getattr(module, "__all__", None) or [name for name in dir(module) if name[0] != "_"]
    return {name: getattr(module, name) for name in names if theme or name not in {*THEMES, "errors", "view"}}


PUBLIC = {f"{theme}.{name}".lstrip("."): value for theme in ("", *THEMES) for name, value in names_of(theme).items()}
