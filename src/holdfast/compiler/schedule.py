"""A schedule: stages, the arrays between them, and the order in which they run. Plain data.

Interpreter and machine code read the same schedule. All sizes are those of one system; batches
and lanes are the reader's affair.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from holdfast.compiler.program import Shape
from holdfast.compiler.stage import Stage, Wire

Role = Literal["input", "parameter", "output", "carried"]

# Numbers that a status may hold, 0 if all is well. From the first bad one on, guarded outputs are not-a-number.
FIRST_BAD = 3.0
NOT_FINITE = 4.0  # set by the machine code itself if a guarded output is not finite


class External(NamedTuple):
    """An array of the caller's.

    Attributes:
        shape: of one system.
        role: inputs change with every call, parameters seldom. What is carried is read and written: a
            schedule with such arrays may be repeated within one call (batches only).
    """

    shape: Shape
    role: Role

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return math.prod(self.shape)


class Internal(NamedTuple):
    """An array between stages.

    Attributes:
        items: how many items it has.
        size: numbers of each.
    """

    items: int
    size: int


@dataclass(frozen=True, eq=False)
class Group:
    """The items that one stage runs for.

    Attributes:
        stage: the stage.
        count: how many items there are.
        wires: by port.
        side_by_side: whether items may run at the same time.
    """

    stage: Stage
    count: int
    wires: Mapping[str, Wire]
    side_by_side: bool


class Call(NamedTuple):
    """One phase of a stage, run for items of its group in the order given."""

    group: str
    phase: int
    items: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Schedule:
    """A computation.

    Attributes:
        externals: the caller's arrays: inputs, then parameters, then outputs.
        internals: arrays between stages.
        groups: by name.
        prepare: calls that need parameters only.
        calls: the others.
        status: an output, (), that holds one of the numbers above; None if there is none.
        guarded: the outputs that it speaks of.
    """

    externals: Mapping[str, External]
    internals: Mapping[str, Internal]
    groups: Mapping[str, Group]
    prepare: tuple[Call, ...]
    calls: tuple[Call, ...]
    status: str | None = None
    guarded: tuple[str, ...] = ()

    def names(self, *roles: Role) -> tuple[str, ...]:
        """Return the external arrays of the given roles, in order."""
        return tuple(name for name, external in self.externals.items() if external.role in roles)

    @cached_property
    def operation_count(self) -> int:
        """Operations of all stages for one system, its parameters' included (signs and selections are free)."""
        run = {(call.group, item) for call in (*self.prepare, *self.calls) for item in call.items}
        return sum(self.groups[group].stage.operations for group, _ in run)
