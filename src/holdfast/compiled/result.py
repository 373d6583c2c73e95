"""What compiled forward dynamics returns: arrays in one block of memory, to be written again and again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiler.schedule import External
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

# Statuses as the machine code numbers them; see `forward_schedule.status_of_rank`.
OK, INDETERMINATE, UNDECIDED, SINGULAR, INVALID = range(5)
_STATUSES = np.array(
    [Status.OK, Status.INDETERMINATE_FORCES, Status.INDETERMINATE_FORCES, Status.SINGULAR, Status.INVALID]
)


class ResultLayout:
    """Which arrays a result has, one after the other in its memory.

    Attributes:
        shapes: by name, of one system.
        sizes: how many numbers each has.
        starts: where each begins.
        total: how many numbers there are.
    """

    def __init__(self, externals: Mapping[str, External]) -> None:
        self.shapes = {name: e.shape for name, e in externals.items() if e.role == "output"}
        self.sizes = np.array([math.prod(shape) for shape in self.shapes.values()], dtype=np.int64)
        ends = np.cumsum(self.sizes)
        self.starts, self.total = ends - self.sizes, int(ends[-1])
        self._places = dict(zip(self.shapes, zip(self.starts.tolist(), ends.tolist(), strict=True), strict=True))

    def view(self, name: str, memory: Array, batch: int | None) -> Array:
        """Return one array of a result."""
        start, end = self._places[name]
        if batch is None:
            return memory[start:end].reshape(self.shapes[name])
        return memory[start * batch : end * batch].reshape(batch, *self.shapes[name])


class CompiledResult(ForwardResult):
    """A `ForwardResult` whose arrays are written by machine code; of one system, or of a batch.

    For a batch every array has a leading axis, and `rank`, `status`, `mobility`, `condition` are
    arrays too. Where the forces are not unique (`INDETERMINATE_FORCES`) they are one solution, not
    the smallest one. Given as `out=`, a result is written over.

    Attributes:
        layout: where its arrays are
        memory: in one block,
        address: which begins here.
        batch: how many systems, or None for one without a leading axis.
    """

    layout: ResultLayout
    memory: Array
    address: int
    batch: int | None
    __deepcopy__: Any = None  # unlike other results it is written again, and a copy is one of its own

    def __init__(self, chain: ClosedChain, layout: ResultLayout, batch: int | None) -> None:
        memory = np.empty(layout.total * (1 if batch is None else batch))
        self.__dict__.update(
            chain=chain, layout=layout, batch=batch, method="sequential", memory=memory, address=memory.ctypes.data
        )

    def __getattr__(self, name: str) -> Array:
        """Return an array of results, made when first asked for."""
        if name.startswith("__") or name not in self.layout.shapes:
            raise AttributeError(f"a result has no '{name}'")
        return self.__dict__.setdefault(name, self.array(name))

    def array(self, name: str) -> Array:
        """Return an array as the machine code writes it: numbers, also for rank, status and condition."""
        return self.layout.view(name, self.memory, self.batch)

    @property
    def rank(self) -> Any:  # type: ignore[override]
        """Independent rows of the grasp constraint."""
        found = self.array("rank")
        return int(found) if self.batch is None else found.astype(np.int64)

    @property
    def mobility(self) -> Any:  # type: ignore[override]
        """Dimension of the velocities that the grasps allow."""
        return self.chain.velocity_count + self.chain.contact_freedom_count - self.rank

    @property
    def base_acceleration(self) -> Array | None:  # type: ignore[override]
        """(6,) true acceleration of a floating base; None without one."""
        return self._of_trunk("floating_acceleration")

    @property
    def trunk_base_wrench(self) -> Array | None:  # type: ignore[override]
        """(6,) of the base on the trunk about the base origin; None without a trunk."""
        return self._of_trunk("trunk_base_wrench")

    def _of_trunk(self, name: str) -> Array | None:
        return self.array(name) if name in self.layout.shapes else None

    @property
    def status(self) -> Any:  # type: ignore[override]
        """How the answer is to be read; an array of `Status` for a batch."""
        return _STATUSES[self.array("status").astype(np.intp)]

    @property
    def condition(self) -> Any:  # type: ignore[override]
        """How near the chain is to a singular configuration, see `ForwardResult`; infinite at one."""
        found = np.where(self.array("status") == SINGULAR, np.inf, self.array("condition"))
        return float(found) if self.batch is None else found

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes the result again from a copy of its numbers."""
        return _unpickled, (self.chain, self.layout, self.batch, self.memory)


def _unpickled(chain: ClosedChain, layout: ResultLayout, batch: int | None, memory: Array) -> CompiledResult:
    result = CompiledResult(chain, layout, batch)
    result.memory[...] = memory
    return result
