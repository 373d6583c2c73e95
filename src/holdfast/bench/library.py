"""Other libraries, loaded when they are needed: all of them are optional, and none has types."""

from __future__ import annotations

import importlib
from typing import Any


def pinocchio() -> Any:
    """Return the module of Pinocchio's Python package.

    Raises:
        ImportError: it is not installed.
    """
    return importlib.import_module("pinocchio")


def mujoco() -> Any:
    """Return the module of MuJoCo's Python package.

    Raises:
        ImportError: it is not installed.
    """
    return importlib.import_module("mujoco")
