"""Segments of runs of chains that are answered as forests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from holdfast.dynamics.impulse import forest_attach
from holdfast.dynamics.tree.forest_gaps import require_closed
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.errors import MethodNotApplicable
from holdfast.forces.margins import conditions
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import grasp_rows, row_name
from holdfast.simulation.balance import Sums
from holdfast.simulation.checkpoint import Origin
from holdfast.simulation.events import Attach, Event, Happened, happen
from holdfast.simulation.margins import Policy
from holdfast.simulation.mechanism_margins import MechanismSignals
from holdfast.simulation.mechanism_sample import mechanism_recorded, mechanism_sample
from holdfast.simulation.sample import Samples
from holdfast.simulation.segment import Segment
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class MechanismSegment(Segment):
    """The part of a run of a chain that is answered as a forest, in which the same grasps are closed; see `Segment`."""

    finds_singular: ClassVar[bool] = False

    @cached_property
    def signals(self) -> MechanismSignals:
        """The margins of the run's grasps and loops, and of the joints."""
        later = attached_later(self.settings.events)
        return MechanismSignals(self.environment.chain, grasp_rows(self.settings.environment.chain, later))

    def require_closed(self, start: Origin) -> None:
        """Refuse a start that violates a grasp, loop or coupling.

        Raises:
            StateError: naming it.
        """
        given = mechanism_arguments(self.environment.chain, start.state)
        require_closed(given.motion({}), given.q, given.qd)

    def rank_near(self, start: Origin) -> int:
        """Return the rank of the constraint at the start."""
        return self.at(start).result.rank

    def too_fast(self, t: float, state: State) -> str | None:
        """Return None: whether steps follow the motion is asked of each of them (`simulation.resolution`)."""
        return None

    def happen(self, event: Event, chain: ClosedChain, state: State, inputs: Inputs) -> Happened:
        """Return the chain and the state just after an event, and the entry for the log."""
        chain, state, one = happen(event, chain, state, inputs, forest_attach)
        found, none = dict(zip(chain.as_forest.closures, one.impulses, strict=False)), (0.0,) * 6
        by_row = tuple(found.get(row.key, none) for row in self.signals.rows) if one.impulses else ()
        return chain, state, replace(one, impulses=by_row)

    def recorded(self, samples: Samples, sums: Sums) -> Trajectory:
        """Return the run of several samples."""
        found = self.stepper.accounts(samples.t, samples.arrays)
        return mechanism_recorded(self.signals, found, samples, sums, self.settings.recording.names)

    def sample(self, at: Any, gaps: Gaps, sums: Sums, times: Array, margins: Array, happened: Any) -> Trajectory:
        """Return the run of one sample."""
        names = self.settings.recording.names
        return mechanism_sample(self.signals, at, gaps, sums, times, margins, names, happened)


def attached_later(events: list[Event]) -> list[str]:
    """Return the names of the rows of the grasps that events close."""
    return list(dict.fromkeys(row_name(event.arm) for event in events if isinstance(event, Attach)))


def require_openable(chain: ClosedChain, policy: Policy) -> None:
    """Refuse to open loops, which stay closed for good.

    Raises:
        MethodNotApplicable: naming one with a contact or wrench limits.
    """
    if policy.on_slip != "release":
        return
    for row in grasp_rows(chain):
        if row.key not in chain.grasps and row.grasp is not None and conditions(row.grasp):
            raise MethodNotApplicable(
                f"on_slip: expected 'stop' or 'record' for a chain whose loop '{row.name}' has limits, since loops"
                " cannot be released"
            )
