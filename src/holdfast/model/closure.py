"""Closures: constraints between two bodies, of any grasp kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.grasp import Grasp
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, FrozenDict, making
from holdfast.spatial.pose import Pose, PoseField


@called
@dataclass(frozen=True, eq=False)
class Closure(Frozen):
    """A constraint between two bodies, or a body and the world: any grasp kind.

    Body b is what a grasp holds, and body a what holds it: the wrench f is that of a on b, about the contact point.

    Attributes:
        a: the first body; None for the world. In the `loops` of a `ClosedChain`: a link or frame of an arm as
            "arm/link", a body of the trunk as "trunk/link", or an object by its name; in those of an `Arm`: one of its
            links or frames; in a `Forest`: its index.
        b: the second body, in whose frame the contact frame of the grasp is given, likewise.
        grasp: the kind of constraint, with the contact frame in the axes of b.
        tip: pose of the frame on a that attaches to it, in the axes of a.
        name: name in messages.
    """

    a: Any
    b: Any
    grasp: Grasp
    tip: PoseField = field(default_factory=making(Pose.identity))
    name: str = ""

    def __post_init__(self) -> None:
        checks.name(self.name, "closure: name")
        checks.instance(self.a, (int, np.integer, str, type(None)), "closure: a")
        checks.instance(self.b, (int, np.integer, str), "closure: b")
        checks.instance(self.grasp, Grasp, "closure: grasp")
        object.__setattr__(self, "tip", checks.pose(self.tip, "closure: tip"))
        if self.grasp.of_kind.bushing is not None:
            raise ModelError("closure: grasp: a bushing is no constraint; try its wrench as an external one")


def checked_loops(given: Any, what: str) -> FrozenDict:
    """Return closures by name.

    Raises:
        ModelError: they are no mapping of closures.
    """
    if not isinstance(given, Mapping) or not all(isinstance(one, Closure) for one in given.values()):
        raise ModelError(f"{what}: loops: expected a Closure by name, got {checks.short(given)}")
    for name in given:
        checks.name(name, f"{what}: name of a loop")
    return FrozenDict(given)
