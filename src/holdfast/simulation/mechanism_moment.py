"""A chain that is answered as a forest at one time of a run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from holdfast.dynamics.tree.forest_simulate import ForestAccount, ForestEngine, ForestSample
from holdfast.simulation.instant import Instant
from holdfast.simulation.mechanism_interpolant import ForestKnot
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class MechanismMoment(Instant):
    """A chain that is answered as a forest at one time; `result` and `power` are those of `sample.now`.

    Attributes:
        sample: its forest.
        engine: what has evaluated it.
        halfway: (n,) torques of the drives half-way through the step that ends here; None if they are not known.
        closure_margins: (closures,) margins of the closures, infinite without a limit [N]; None if not known.
    """

    sample: ForestSample = None  # pyright: ignore[reportAssignmentType]
    engine: ForestEngine = None  # pyright: ignore[reportAssignmentType]
    halfway: Array | None = None
    closure_margins: Array | None = None

    @cached_property
    def account(self) -> ForestAccount:
        """Its forces, which are the smallest if they are not unique, gaps and energies."""
        return self.engine.account(self.sample.given, self.sample.now)

    @property
    def grasp_wrenches(self) -> Array:
        """(closures, 6) wrenches at the closures."""
        return self.account.closure_wrench

    @property
    def velocities(self) -> Array:
        """(n_v,) rates of the forest."""
        return self.sample.given.qd

    @property
    def accelerations(self) -> Array:
        """(n_v,) accelerations of the forest."""
        return self.sample.now.qdd

    @cached_property
    def knot(self) -> ForestKnot:
        """The end of a step, for interpolation."""
        return ForestKnot.of(self.sample.given.forest, self.t, self.sample.given.q, self.velocities, self.accelerations)
