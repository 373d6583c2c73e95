"""Ready-made arms, by name, from published data only."""

from __future__ import annotations

from collections.abc import Callable

from holdfast.model.arm import Arm
from holdfast.robots.panda import PANDA_HOME, panda
from holdfast.spatial.scalar import Array

ROBOTS: dict[str, Callable[..., Arm]] = {"panda": panda}
HOME: dict[str, Array] = {"panda": PANDA_HOME}

__all__ = ["HOME", "PANDA_HOME", "ROBOTS", "panda"]
