"""Chains that simulation is tried on, by name."""

from __future__ import annotations

from collections.abc import Callable

from holdfast import ClosedChain, State
from tests.control.two_pandas import two_pandas
from tests.systems import planar_parallelogram, well_conditioned_system
from tests.systems.as_chain import as_chain
from tests.systems.stewart_platform import stewart_platform


def _mixture(*grasps: str) -> tuple[ClosedChain, State]:
    """Return arms of seven joints that hold by these grasps and move."""
    options = {"moving_base": False, "extras": False, "joint_speed": 0.5, "gravity": (0.0, 0.0, -9.81)}
    p = as_chain(well_conditioned_system(2, grasps=list(grasps), joints=[7] * len(grasps), **options))
    return p.chain, p.state


def _platform() -> tuple[ClosedChain, State]:
    """Return a Stewart platform in motion."""
    p = as_chain(stewart_platform(0, joint_speed=0.3))
    return p.chain, p.state


def _parallelogram() -> tuple[ClosedChain, State]:
    """Return a planar parallelogram that swings about its upright position, never flat."""
    p = as_chain(planar_parallelogram(0.6, crank_rate=0.0) | {"gravity": [0.0, 9.81, 0.0]})
    return p.chain, p.state


PROBLEMS: dict[str, Callable[[], tuple[ClosedChain, State]]] = {
    "pandas": two_pandas,
    "hinges": lambda: _mixture("hinge", "hinge"),
    "balls": lambda: _mixture("ball", "ball", "ball"),
    "soft fingers": lambda: _mixture("softfinger", "softfinger"),
    "rigid, hinge, ball": lambda: _mixture("rigid", "hinge", "ball"),
    "soft finger, ball, hinge": lambda: _mixture("softfinger", "ball", "hinge"),
    "Stewart platform": _platform,
    "parallelogram": _parallelogram,
}
