"""The result of compiled forward dynamics: arrays in one block of memory, which later calls can overwrite."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import accumulate
from typing import Any

import numpy as np

from holdfast.compiler.kernel import address_of, aligned
from holdfast.compiler.schedule import External
from holdfast.dynamics.contact.pressing import STATUSES
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import unknown_attribute
from holdfast.spatial.scalar import Array

# The numbers of the statuses in machine code; see `forward_schedule.status_of_rank`.
OK, INDETERMINATE, UNDECIDED, SINGULAR, INVALID = range(5)
_STATUSES = np.array(
    [Status.OK, Status.INDETERMINATE_FORCES, Status.INDETERMINATE_FORCES, Status.SINGULAR, Status.INVALID]
)
_TOUCH_STATUSES = np.array([*STATUSES])


_LINE = 8  # a cache line [doubles]
_LONG_ROW = 64  # rows of so many numbers begin at a cache line


class ResultLayout:
    """The arrays of a result, which are consecutive in its memory.

    Attributes:
        shapes: the shape of each array for one system, by name.
        strides: the distance from one system's numbers to the next one's in each array of a batch [doubles]. Rows of
            many numbers begin at cache lines, so that they can be written past the caches.
        starts: the offset of each array [doubles] for one system.
        total: the number of doubles of all arrays for one system.
    """

    def __init__(self, externals: Mapping[str, External]) -> None:
        self.shapes = {name: e.shape for name, e in externals.items() if e.role == "output"}
        sizes = {name: math.prod(shape) for name, shape in self.shapes.items()}
        strides = {n: size if size < _LONG_ROW else -(-size // _LINE) * _LINE for n, size in sizes.items()}
        order = sorted(strides, key=lambda name: sizes[name] < _LONG_ROW)  # those that begin at cache lines come first
        starts = dict(zip(order, accumulate([strides[name] for name in order], initial=0), strict=False))
        self._places = {name: (starts[name], sizes[name], strides[name]) for name in self.shapes}
        self.starts, self.strides = [starts[name] for name in self.shapes], list(strides.values())
        self.total = sum(self.strides)

    def view(self, name: str, memory: Array, batch: int | None) -> Array:
        """Return one array of a result."""
        (start, size, stride), shape = self._places[name], self.shapes[name]
        if batch is None:
            return memory[start : start + size].reshape(shape)
        rows = memory[start * batch : (start + stride) * batch].reshape(batch, stride)
        return rows[:, :size].reshape(batch, *shape)


class Results:
    """The block of memory to which machine code writes the results of one system or a batch.

    Attributes:
        chain: the chain, or the forest.
        layout: the positions of its arrays in memory.
        memory: the block of memory that holds all arrays.
        batch: the number of systems, or None for one system without a leading axis.
    """

    chain: Any
    layout: ResultLayout
    memory: Array
    batch: int | None

    def __init__(self, chain: Any, layout: ResultLayout, batch: int | None, memory: Array | None = None) -> None:
        if memory is None:
            # Zeros, because the builtin looks for infinite numbers in the whole block of one system, gaps included.
            memory = np.zeros(layout.total) if batch is None else aligned(layout.total * batch, np.empty)
        self.__dict__.update(chain=chain, layout=layout, batch=batch, memory=memory)

    @property
    def address(self) -> int:
        """The address of the memory."""
        return address_of(self.memory)

    def array(self, name: str) -> Array:
        """Return an array as the machine code writes it: floats, even for rank and status."""
        return self.layout.view(name, self.memory, self.batch)


class StatusResults(Results):
    """Results with a status, of one system or a batch, whose arrays are written by machine code."""

    __deepcopy__: Any = None  # allows real copies, because unlike other results these may be overwritten

    def __getattr__(self, name: str) -> Array:
        """Return an array of results, made when first asked for."""
        if name.startswith("__") or name not in self.layout.shapes:
            raise unknown_attribute(self, name)
        return self.__dict__.setdefault(name, self.array(name))

    @property
    def status(self) -> Any:
        """The status of the solution; for a batch, an array of `Status`."""
        return _STATUSES[self.array("status").astype(np.intp)]

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle or copy the result from its numbers."""
        return type(self), (self.chain, self.layout, self.batch, self.memory.copy())


class SolvedResults(StatusResults):
    """Results with rank, status and condition, of one system or a batch, whose arrays are written by machine code."""

    @property
    def rank(self) -> Any:
        """The number of independent rows of the constraint."""
        found = self.array("rank")
        return int(found) if self.batch is None else found.astype(np.int64)

    @property
    def condition(self) -> Any:
        """A measure of the distance to a singular configuration (see `ForwardResult`); infinite at one."""
        found = np.where(self.array("status") == SINGULAR, np.inf, self.array("condition"))
        return float(found) if self.batch is None else found


class CompiledResult(SolvedResults, ForwardResult):  # pyright: ignore[reportIncompatibleVariableOverride]
    """A `ForwardResult` of one system or a batch, whose arrays are written by machine code.

    For a batch every array has a leading axis, and `rank`, `status`, `mobility` and `condition` are arrays as well.
    If the forces are not unique (`INDETERMINATE_FORCES`), they are one of the solutions, not the one of least norm.
    A call with `out=result` overwrites the result.
    """

    chain: ClosedChain
    method = "sequential"

    @property
    def mobility(self) -> Any:  # type: ignore[override]
        """The dimension of the space of velocities that the grasps allow."""
        return self.chain.velocity_count + self.chain.contact_freedom_count - self.rank

    @property
    def base_acceleration(self) -> Array | None:  # type: ignore[override]
        """(6,) acceleration of a floating base without the gravity offset; None if there is no floating base."""
        return self._if_any("floating_acceleration")

    @property
    def trunk_base_wrench(self) -> Array | None:  # type: ignore[override]
        """(6,) wrench of the base on the trunk about the base origin; None without a trunk."""
        return self._if_any("trunk_base_wrench")

    @property
    def touch_force(self) -> Any:  # type: ignore[override]
        """(k, 3) force of the world on the object at every candidate, world axes; None without `touching`."""
        return self._if_any("touch_force")

    @property
    def touch_gap(self) -> Any:  # type: ignore[override]
        """(k,) distances; None without `touching`."""
        return self._if_any("touch_gap")

    @property
    def touch_mode(self) -> Any:  # type: ignore[override]
        """(k,) numbers of `ContactMode`; None without `touching`."""
        found = self._if_any("touch_mode")
        return None if found is None else found.astype(np.int64)

    @property
    def touch_status(self) -> Any:  # type: ignore[override]
        """OK or UNRESOLVED (for a batch, an array), as uniqueness is not decided; None without `touching`."""
        found = self._if_any("touch_status")
        return None if found is None else _TOUCH_STATUSES[found.astype(np.intp)]

    @property
    def touch_residual(self) -> Any:  # type: ignore[override]
        """Violation of the laws of contact, relative to the accelerations; None without `touching`."""
        found = self._if_any("touch_residual")
        return found if found is None or self.batch is not None else float(found)

    def _if_any(self, name: str) -> Array | None:
        return self.array(name) if name in self.layout.shapes else None
