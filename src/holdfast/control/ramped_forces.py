"""Grasp forces that pass from one wish to another: to squeeze before a lift, and to hand over before a release."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.compiler.program import Shape
from holdfast.control.law_parts import GraspForces, LawInput
from holdfast.control.paths import quintic
from holdfast.dynamics.constraint import length_scale
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED
from holdfast.spatial.scalar import Array

UNLOADED = 1e-3  # part of the load, or of 1 N, below which a grasp may open


@called
@dataclass(frozen=True, eq=False)
class RampedForces(GraspForces):
    """Grasp forces (1 - s) before + s after, with the quintic s of (t - begin) / duration.

    To squeeze, ramp from a small to a larger `InternalForce` and lift afterwards; to hand over, ramp from one
    `LoadShare` to another in which an arm carries and pushes nothing, and open its grasp once `unloaded` says so.

    Attributes:
        before: the grasp forces until `begin`.
        after: those from `begin` + `duration`.
        begin: time at which the ramp begins [s].
        duration: its duration [s].

    Raises:
        ModelError: a part is none of grasp forces or has a memory, or a time is out of range.
    """

    before: GraspForces = REQUIRED
    after: GraspForces = REQUIRED
    begin: float = 0.0
    duration: float = 1.0

    def __post_init__(self) -> None:
        for name in ("before", "after"):
            checks.instance(getattr(self, name), GraspForces, f"ramped forces: {name}")
        object.__setattr__(self, "begin", checks.number(self.begin, "ramped forces: begin"))
        object.__setattr__(self, "duration", checks.number(self.duration, "ramped forces: duration", above=0.0))

    def parameters(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return those of both parts."""
        return self.before.parameters(chain) | self.after.parameters(chain)

    def require(self, chain: ClosedChain) -> None:
        """Refuse a chain that one of the parts does not fit, and parts with a memory."""
        for part in (self.before, self.after):
            part.require(chain)
            if len(part.memory(chain)):
                name = type(part).__name__
                raise ModelError(
                    f"ramped forces: expected parts without memory, got {name}; try {name}(around=RampedForces(...))"
                )

    def wished(self, x: LawInput, acceleration: Array) -> Array:
        """Return the wrenches between those of the parts, (arms, 6)."""
        s, _, _ = quintic((x.t - self.begin) / self.duration)
        return (1.0 - s) * self.before.wished(x, acceleration) + s * self.after.wished(x, acceleration)


def unloaded(chain: ClosedChain, grasp_wrench: ArrayLike) -> dict[str, bool]:
    """Return by arm whether its grasp may open: its wrench is at most 1e-3 of the load, or of 1 N. O(l).

    The load is the sum of the forces of all grasps; moments count divided by the distance of the grasps from C.

    Args:
        chain: the chain.
        grasp_wrench: (arms, 6) wrenches as in `ForwardResult`.

    Raises:
        StateError: a shape is wrong, or squares of the wrenches overflow.
    """
    serial_chain(chain, "unloaded: chain")
    f = checks.numbers(grasp_wrench, (len(chain.arms), 6), "unloaded: grasp_wrench", StateError)
    length = length_scale([grasp.frame.p for grasp in chain.grasps.values()])
    with np.errstate(all="ignore"):  # what overflows is refused
        load = np.linalg.norm(f[:, 3:].sum(axis=0))
        sizes = np.hypot(*np.linalg.norm([f[:, :3] / length, f[:, 3:]], axis=2))
    checks.finite(np.array([load, *sizes]), "unloaded")
    return {name: bool(sizes[chain.names.index(name)] <= UNLOADED * max(1.0, load)) for name in chain.grasps}
