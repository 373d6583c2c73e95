"""What compiled forward dynamics returns: arrays in one block of memory, to be written again and again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiler.bound import aligned
from holdfast.compiler.schedule import External
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

# Statuses as the machine code numbers them; see compiled/object_stages.turning_point.
OK, INDETERMINATE, UNDECIDED, SINGULAR, INVALID = range(5)
_STATUSES = np.array(
    [Status.OK, Status.INDETERMINATE_FORCES, Status.INDETERMINATE_FORCES, Status.SINGULAR, Status.INVALID]
)


class CompiledResult(ForwardResult):
    """A `ForwardResult` whose arrays are written by machine code; of one system, or of a batch.

    For a batch every array has a leading axis, and `rank`, `status`, `mobility`, `condition` are
    arrays too. Where the forces are not unique (`INDETERMINATE_FORCES`) they are one solution, not
    the smallest one. Given as `out=`, a result is written over.

    Attributes:
        arrays: the results by name, as the machine code writes them.
        memory: the block they lie in.
        batch: how many systems, or None for one without a leading axis.
    """

    def __init__(self, chain: ClosedChain, externals: Mapping[str, External], batch: int | None) -> None:
        put = object.__setattr__
        shapes = {name: e.shape for name, e in externals.items() if e.role == "output"}
        shapes = {name: shape if batch is None else (batch, *shape) for name, shape in shapes.items()}
        memory, arrays, start = aligned(sum(math.prod(shape) for shape in shapes.values())), {}, 0
        for name, shape in shapes.items():
            end = start + math.prod(shape)
            arrays[name] = memory[start:end].reshape(shape)
            start = end
        put(self, "memory", memory)
        put(self, "arrays", arrays)
        put(self, "batch", batch)
        put(self, "chain", chain)
        put(self, "method", "sequential")
        for name in ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench"):
            put(self, name, arrays[name])

    arrays: dict[str, Array]
    memory: Array
    batch: int | None

    @property
    def rank(self) -> Any:  # type: ignore[override]
        """Independent rows of the grasp constraint."""
        found = self.arrays["rank"]
        with np.errstate(invalid="ignore"):
            return int(found) if self.batch is None else found.astype(np.int64)

    @property
    def mobility(self) -> Any:  # type: ignore[override]
        """Dimension of the velocities that the grasps allow."""
        return self.chain.joint_count + 6 + self.chain.contact_freedom_count - self.rank

    @property
    def status(self) -> Any:  # type: ignore[override]
        """How the answer is to be read; an array of `Status` for a batch."""
        return _STATUSES[self.arrays["status"].astype(np.intp)]

    @property
    def condition(self) -> Any:  # type: ignore[override]
        """Inverse of the smallest scaled pivot that was kept."""
        found = self.arrays["condition"]
        return float(found) if self.batch is None else found

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickles the result as a `ForwardResult` of plain arrays."""
        return _unpickled, (self.chain, self.batch, {name: np.array(x) for name, x in self.arrays.items()})


def _unpickled(chain: ClosedChain, batch: int | None, arrays: Mapping[str, Array]) -> CompiledResult:
    externals = {name: External(x.shape if batch is None else x.shape[1:], "output") for name, x in arrays.items()}
    result = CompiledResult(chain, externals, batch)
    for name, x in arrays.items():
        result.arrays[name][...] = x
    return result
