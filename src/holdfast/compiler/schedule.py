"""A schedule: stages, the arrays between them, and the order in which the stages run. It is plain data.

The interpreter and the code generators read the same schedule. All sizes are those of one system; code generators
add batches and lanes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from holdfast.compiler.program import Shape
from holdfast.compiler.stage import Stage, Wire

ExternalRole = Literal["input", "parameter", "output", "carried"]

# A status is 0 if there was no problem. If it is FIRST_BAD or larger, the guarded outputs are NaN.
FIRST_BAD = 3.0
NOT_FINITE = 4.0  # set by the machine code itself if a guarded output is not finite


class External(NamedTuple):
    """An array of the caller.

    Attributes:
        shape: the shape for one system.
        role: inputs change with every call, parameters seldom. A carried array is read and written; a schedule
            that has one can be repeated within one call of a batch.
    """

    shape: Shape
    role: ExternalRole

    @property
    def size(self) -> int:
        """The number of entries."""
        return math.prod(self.shape)


class Internal(NamedTuple):
    """An array between stages.

    Attributes:
        items: the number of items.
        size: the number of entries of each item.
    """

    items: int
    size: int


@dataclass(frozen=True, eq=False)
class Group:
    """The items that one stage runs for.

    Attributes:
        stage: the stage.
        count: the number of items.
        wires: the wire of every port, by port name.
        side_by_side: whether items may run at the same time, in lanes.
    """

    stage: Stage
    count: int
    wires: Mapping[str, Wire]
    side_by_side: bool


class Call(NamedTuple):
    """One phase of a group's stage, run for some items of the group in the given order."""

    group: str
    phase: int
    items: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Schedule:
    """A computation as calls of stages on arrays.

    Attributes:
        externals: the caller's arrays by name: inputs, then parameters, then outputs.
        internals: the arrays between stages, by name.
        groups: the groups by name.
        prepare: the calls that depend on parameters only.
        calls: the other calls, in order.
        status: the name of the output of shape () that holds the status, or None if there is none.
        guarded: the outputs that become NaN if the status is bad.
    """

    externals: Mapping[str, External]
    internals: Mapping[str, Internal]
    groups: Mapping[str, Group]
    prepare: tuple[Call, ...]
    calls: tuple[Call, ...]
    status: str | None = None
    guarded: tuple[str, ...] = ()

    def names(self, *roles: ExternalRole) -> tuple[str, ...]:
        """Return the external arrays of the given roles, in order."""
        return tuple(name for name, external in self.externals.items() if external.role in roles)

    @cached_property
    def operation_count(self) -> int:
        """The number of arithmetic operations of all stages for one system, including those of `prepare`."""
        run = {(call.group, item) for call in (*self.prepare, *self.calls) for item in call.items}
        return sum(self.groups[group].stage.operations for group, _ in run)
