"""The margins of a chain that is answered as a forest: of grasps, loops and joints, in the layout of `Signals`.

If forces are not unique, margins are those of the smallest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from holdfast.forces.margins import conditions, joint_coordinates, margin_of_row, margins_of_joints
from holdfast.forces.row_wrenches import contact_wrenches
from holdfast.model.grasp_rows import GraspRow, grasp_rows
from holdfast.simulation.instant import Instant, LateInstant
from holdfast.simulation.margins import JOINT_QUANTITIES, Quantity, Signals, freedom_names, giving_way
from holdfast.simulation.mechanism_moment import MechanismMoment
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class MechanismSignals(Signals):
    """The layout and evaluation of the margins of a chain that is answered as a forest.

    Attributes:
        rows: the rows of the run, whatever is closed now.
    """

    rows: Sequence[GraspRow] = ()

    def __len__(self) -> int:
        return len(self.rows) + 3 * self.chain.joint_count

    @cached_property
    def closed(self) -> dict[int, GraspRow]:
        """The rows of the grasps and loops that are closed now, by their place."""
        now = {row.name: row for row in grasp_rows(self.chain)}
        return {i: now[row.name] for i, row in enumerate(self.rows) if row.name in now}

    @cached_property
    def holding(self) -> Array:
        """Whether each of the rows is closed now."""
        return np.isin(np.arange(len(self.rows)), [*self.closed])

    @cached_property
    def names(self) -> list[str]:
        """Name of each signal: the rows, then three times the joints as 'arm/joint'."""
        return [*(row.name for row in self.rows), *3 * freedom_names(self.chain)]

    @cached_property
    def quantities(self) -> list[Quantity]:
        """The quantity that each signal limits."""
        n = self.chain.joint_count
        grasps: list[Quantity] = ["grasp"] * len(self.rows)
        return grasps + [quantity for quantity in JOINT_QUANTITIES for _ in range(n)]

    @cached_property
    def limited_rows(self) -> dict[int, GraspRow]:
        """The closed grasps and loops with limits, by their place."""
        return {i: row for i, row in self.closed.items() if row.grasp is not None and conditions(row.grasp)}

    @cached_property
    def limited(self) -> Array:
        """Indices of the signals that have a limit; only these have to be evaluated."""
        grasps = [i in self.limited_rows for i in range(len(self.rows))]
        return np.flatnonzero(np.array([*grasps, *self.joint_limits.limited.flat]))

    def of_each(self, instants: Sequence[Instant]) -> Array:
        """Return all margins at several instants, (instants, rows + 3 n). O(rows + n), O(bodies) with limited loops."""
        q, qd, tau = (np.array(of_joints) for of_joints in zip(*(at.joints for at in instants), strict=True))
        found = np.array([self._of_rows(at) for at in instants]).reshape(len(instants), -1)
        return self.of_coordinates(joint_coordinates(self.chain, q), qd, tau, found)

    def of_arrays(self, x: Mapping[str, Array]) -> Array:
        """Return all margins of systems, (..., rows + 3 n), from their arrays by name."""
        none = np.zeros((*x["q"].shape[:-1], 0))
        found = x["margin"][..., self.limited_closures] if self.limited_rows else none
        return self.of_coordinates(joint_coordinates(self.chain, x["q"]), x["qd"], x["drive"], found)

    def of_coordinates(self, q: Array, qd: Array, tau: Array, of_rows: Array) -> Array:
        """Return all margins of systems, (..., rows + 3 n).

        Args:
            q: (..., n) coordinates of the joints.
            qd: (..., n) their rates.
            tau: (..., n) torques.
            of_rows: (..., limited rows) margins of the rows with limits.
        """
        grasps = np.full((*q.shape[:-1], len(self.rows)), np.inf)
        grasps[..., [*self.limited_rows]] = of_rows
        return np.concatenate([grasps, *margins_of_joints(self.joint_limits, q, qd, tau)], axis=-1)

    def undecided(self, x: Mapping[str, Array]) -> bool:
        """Return False: machine code finds the margins of the smallest forces, too."""
        return False

    @cached_property
    def limited_closures(self) -> list[int]:
        """The closures of the rows with limits."""
        return [self.chain.as_forest.closures[row.key] for row in self.limited_rows.values()]

    def _of_rows(self, at: Instant) -> Array | list[float]:
        """Return the margins of the rows with limits."""
        assert isinstance(at, MechanismMoment | LateInstant)
        if not self.limited_rows or at.closure_margins is None:
            return [margin_of_row(self.limited_rows[i], f) for i, f in self._wrenches(at).items()]
        return at.closure_margins[self.limited_closures]

    def wrenches(self, of_closures: Array) -> Array:
        """Return the wrenches of the run's grasps and loops, (..., rows, 6), from (..., closures, 6); zero if open."""
        found = np.zeros((*of_closures.shape[:-2], len(self.rows), 6))
        for i, row in self.closed.items():
            found[..., i, :] = of_closures[..., self.chain.as_forest.closures[row.key], :]
        return found

    def _wrenches(self, at: Instant) -> dict[int, Array]:
        """Return the wrenches of the rows with limits in contact axes."""
        limited = self.limited_rows
        return contact_wrenches(self.chain, at.state, self.wrenches(at.grasp_wrenches), limited) if limited else {}

    def description(self, at: Instant, signal: int) -> str:
        """Return a sentence on what happens when the margin reaches zero."""
        name, quantity = self.names[signal], self.quantities[signal]
        if quantity != "grasp":
            return f"joint '{name}' reaches its {quantity} limit"
        row = self.limited_rows[signal]
        assert row.grasp is not None
        what = "grasp" if row.key in self.chain.grasps else "loop"
        return f"{what} '{name}' {giving_way(row.grasp, self._wrenches(at)[signal])}"
