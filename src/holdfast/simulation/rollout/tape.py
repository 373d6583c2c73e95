"""Tapes: rollouts whose steps are stored, so that gradients can be propagated back through them.

Only the states are stored; the backward pass repeats the computations of each step. If the states would need too much
memory, only some of them are stored, and the steps between them are repeated with identical bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from holdfast.compiled.arrays import require_threads
from holdfast.control.sampled import SampledTorque
from holdfast.dynamics.projection_derivatives import OF_PROJECTION
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.model import checks
from holdfast.names import called
from holdfast.questions.arrays import state_fields
from holdfast.questions.derivatives import Derivatives, require_names
from holdfast.simulation.rollout.adjoint import BEFORE, AdjointKernel, adjoint_shapes
from holdfast.simulation.rollout.arguments import (
    LINK_ARGUMENTS,
    MOST_STEPS_OF_CALL,
    chain_arguments,
    fitting,
    kernel_arguments,
    step_lengths,
    stop_margins,
    whole_number,
)
from holdfast.simulation.rollout.systems import RolloutSystems, require_recorded
from holdfast.simulation.rollout.varied_step import LAW_PREFIX, MARGIN_RESULT, WORK_RESULT
from holdfast.simulation.runge_kutta import IMEX
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.simulation.rollout.rollout import Rollout

MOST_STORED = 2**30  # bytes: if the states need more memory, only some of them are stored
STEP_LENGTH, LAW_MEMORY = "step", "memory"
FORCES = (
    "grasp_wrench",
    "coupling_force",
    "base_wrench",
    "trunk_base_wrench",
    MARGIN_RESULT,
)  # these need not be unique


class StoredStep(NamedTuple):
    """A stored step.

    Attributes:
        given: the arguments of the step and the state at its start, with the names of the machine code.
        stiff: (systems,) whether the step was linearly implicit.
        went: (systems,) whether the system took the step; the others had stopped.
    """

    given: dict[str, Array]
    stiff: Array
    went: Array


@called
class Tape:
    """Stored steps of systems, for gradients; created by `Rollout.tape`.

    Attributes:
        rollout: the rollout that took the steps.
        systems: the systems at the end.
        steps: number of steps.
        every: number of steps between two stored states.
        records: the recorded arrays at the end of every step, by name, (steps, systems, ...).
    """

    def __init__(
        self,
        rollout: Rollout,
        systems: RolloutSystems,
        step: Any,
        steps: int,
        every: int | None,
        record: Sequence[str],
        schedule: Mapping[str, Any],
        options: Mapping[str, Any],
        given: Mapping[str, Any],
    ) -> None:
        """Take the steps; see `Rollout.tape`."""
        self.rollout, self.steps = rollout, whole_number("steps", steps, MOST_STEPS_OF_CALL)
        self._step, self._options, self._given = step, options, given
        self._schedule = self._scheduled(schedule, len(systems))
        carried = rollout.kernel.carried
        self._shapes = {n: carried[n] for n in (*state_fields(rollout.chain), "before", "held_rows") if n in carried}
        self._acting: tuple[dict[str, Array], dict[str, Array]] | None = None
        size = sum(math.prod(shape) for shape in self._shapes.values())
        fits = self.steps * len(systems) * size * 8 <= MOST_STORED
        default = 1 if fits else math.isqrt(self.steps - 1) + 1
        self.every = default if every is None else whole_number("every", every)
        self._came_from = systems.copy().started_from
        at, self._stored, self._starts = systems.copy(), list[StoredStep](), list[RolloutSystems]()
        buffers = self._buffers(len(systems)) if self.every == 1 else {}
        require_recorded(record)
        rows: dict[str, list[Array]] = {name: [] for name in record}
        for k in range(self.steps):
            if self.every > 1 and k % self.every == 0:
                self._starts.append(at.copy())
            if self.every == 1:
                self._stored.append(self._store(at, k, buffers, k))
            else:
                self._take(at, k)
            for name in record:
                rows[name].append(np.array(getattr(at, name)))
        self.systems, self.records = at, {name: np.array(x) for name, x in rows.items()}

    def __repr__(self) -> str:
        """Return the numbers of steps and systems, on one line."""
        return f"<Tape of {self.steps} steps of {len(self.systems)} systems, states kept every {self.every}>"

    def vjp(
        self,
        final: Mapping[str, Any] | None = None,
        along: Mapping[str, Any] | None = None,
        *,
        by: Sequence[str] | None = None,
        threads: int | None = None,
    ) -> Derivatives:
        """Return the gradients of sum(cotangent . result) over the results of all steps. O(steps) (O(n) + O(l)).

        These are the exact derivatives of the discrete steps, including their projections, at the stored states. The
        derivatives of poses refer to R -> exp(turn) R and a shift, (6,) [turn; shift], in cotangents and in gradients.
        A step that a stopped system did not take leaves its cotangents unchanged.

        Args:
            final: cotangents at the end, by name: q (systems, n), qd, object_pose (systems, 6), object_twist,
                floating_pose and floating_twist, the law's memory, and the work (systems, 4) since the start. Those
                and gradients of q are in the coordinates of qd, of which a spherical joint has three.
            along: cotangents at the end of every step, (steps, systems, ...): of the same arrays, of tau, of the
                margins of the grasps, margin (.., grasps), and of the results of forward dynamics: qdd, grasp_wrench
                (.., arms, 6), object_acceleration, contact_acceleration, base_wrench; of a chain with branches also
                coupling_force, and no contact_acceleration and base_wrench.
            by: the arguments of which gradients are returned: the arrays of the state and `memory` at the start,
                parameters of the law, object_wrench, gravity, object_mass, object_com, object_inertia, grasp_pose; if
                no base moves, base_pose and the length of a `step`; and, if the rollout was compiled with them,
                link_mass, link_com, link_inertia, link_wrench, and those of a trunk (trunk_link_mass ...). Of a chain
                with branches only gravity and the numbers of an only object are among them. By default the state and
                all parameters of the law. If the tape begins with systems from `Rollout.start` or `take_over`, the
                gradients refer to the states passed to these functions, before the projection onto the grasps.
            threads: as for `Rollout.step`.

        Returns:
            The gradients by name: (systems, ...), summed over the steps, or (steps, systems, ...) for arguments given
            step by step. `result` contains the systems at the end.

        Raises:
            StateError: a name or shape is wrong, a cotangent belongs to a system that never took a step, or no system
                has gradients that are numbers.
            MethodNotApplicable: a cotangent belongs to forces that are not unique.
        """
        chain, law = self.rollout.chain, self.rollout.law
        for name, x in (("final", final), ("along", along)):
            checks.instance(x, (Mapping, type(None)), f"tape: {name}", StateError)
        ends, passed = dict(final or {}), dict(along or {})
        state = tuple(state_fields(chain))
        memory = (LAW_MEMORY,) if len(law.memory) else ()
        require_names("tape: final", ends or state, (*state, *memory, WORK_RESULT))
        of_steps = ("tau", MARGIN_RESULT, WORK_RESULT, *self.rollout.kernel.code.varied.results_of(chain))
        require_names("tape: along", passed or state, (*state, *memory, *of_steps))
        require_threads(threads)
        require_names("tape: by", (*state, *law.parameters) if by is None else by, arguments_of(self.rollout))
        names = (*state, *law.parameters) if by is None else tuple(by)
        self._require_unique((*ends, *passed))
        code = {name: f"{LAW_PREFIX}{name}" if name in law.parameters else name for name in names}
        code |= {LAW_MEMORY: BEFORE} if LAW_MEMORY in names else {}
        return self._vjp(ends, passed, code, threads)

    def _vjp(
        self, final: Mapping[str, Any], along: Mapping[str, Any], by: Mapping[str, str], threads: int | None
    ) -> Derivatives:
        """Return the gradients; `by` contains the names of the machine code."""
        chain, count, kernel = self.rollout.chain, len(self.systems), self.rollout.kernel
        carried = (*state_fields(chain), *([BEFORE] if len(self.rollout.law.memory) else []))
        of = tuple(dict.fromkeys(name for name in (*along, *final) if name not in carried))
        at_end = tuple(name for name in of if name != WORK_RESULT)  # work is the sum over this step and all before it
        parameters = tuple(dict.fromkeys(name for name in by.values() if name not in carried))
        known = adjoint_shapes(kernel, (*carried, *parameters), of)
        cotangents = {name: np.zeros((count, *known[f"with.{name}"])) for name in (*carried, *of)}
        for name, x in final.items():
            cotangents[name] += checks.numbers(x, cotangents[name].shape, f"final: {name}", StateError)
        passed = {
            name: checks.numbers(x, (self.steps, *cotangents[name].shape), f"along: {name}", StateError)
            for name, x in along.items()
        }
        adjoints = {stiff: self._adjoint(stiff, (*carried, *parameters), of) for stiff in (False, True)}
        totals = {name: np.zeros((count, *known[f"found.{name}"])) for name in parameters}
        stepwise = {name: np.zeros((self.steps, *totals[name].shape)) for name in parameters if name in self._schedule}
        for k, step in self._backward():
            for name, x in passed.items():
                cotangents[name] += x[k]
            for stiff in (False, True):
                rows = np.flatnonzero(step.went & (step.stiff == stiff))
                if not len(rows):
                    continue
                found = _of_rows(adjoints[stiff], step.given, cotangents, rows, count, threads)
                for name in carried:
                    cotangents[name][rows] = found[name]
                for name in at_end:
                    cotangents[name][rows] = 0.0
                for name in parameters:
                    totals[name][rows] += found[name]
                    if name in stepwise:
                        stepwise[name][k, rows] = found[name]
        idle = np.flatnonzero([any(cotangents[name][i].any() for name in at_end) for i in range(count)])
        if len(idle):
            raise StateError(
                f"tape: along: expected results of systems that took a step, got cotangents of {', '.join(at_end)} of"
                f" system {idle[0]}, which took none; try zeros for it"
            )
        self._through_start(cotangents, totals, parameters, threads)
        found = (*totals.values(), *cotangents.values())
        if all(any(np.isnan(x[i]).any() for x in found) for i in range(count)):
            raise StateError(
                "tape: vjp: expected a law and a motion with derivatives, got gradients that are not numbers. A law"
                " within limits has kinks without a barrier: try cooperative_law(..., cost=ForceCost(barrier=1e-5));"
                " otherwise they overflow: try fewer steps"
            )
        whole = totals | stepwise | {name: cotangents[name] for name in carried}
        return Derivatives(self.systems, {name: whole[key] for name, key in by.items()})

    def _through_start(
        self, cotangents: dict[str, Array], totals: dict[str, Array], parameters: Sequence[str], threads: int | None
    ) -> None:
        """Propagate gradients, in place, back through the projection onto the grasps at the start of the systems."""
        came_from = self._came_from
        if came_from is None:
            return
        first = self._first()
        rows = np.flatnonzero(first.went)
        if not len(rows):
            return
        state, moving = tuple(came_from), tuple(name for name in parameters if name in OF_PROJECTION)
        closing = AdjointKernel.of_step(self.rollout.kernel, None, (*state, *moving), ())
        given = first.given | {f"last.{name}": x for name, x in came_from.items()}
        found = _of_rows(closing, given, {name: cotangents[name] for name in state}, rows, len(self.systems), threads)
        for name in state:
            cotangents[name][rows] = found[name]
        for name in moving:
            totals[name][rows] += found[name]

    # ---- steps ----

    def _buffers(self, count: int) -> dict[str, Array]:
        """Return memory for the states before the steps of one segment."""
        length = self.steps if self.every == 1 else min(self.every, self.steps)
        return {name: np.empty((length, count, *shape)) for name, shape in self._shapes.items()}

    def _store(self, at: RolloutSystems, k: int, buffers: Mapping[str, Array], row: int) -> StoredStep:
        """Take step k in place and return it, with the state before it stored in one row of the memory."""
        running = at.running
        at.set_step_length(step_lengths(self._step, len(at)))
        stiff = self.rollout.stiff(at)
        counts = {"last.count": at.arrays["count"].copy(), "begin": at.begin, "step": at.step_length}
        before = {f"last.{name}": x[row] for name, x in buffers.items()}
        for name in buffers:
            buffers[name][row] = at.arrays[name]
        inputs, parameters = self._take(at, k)
        return StoredStep(before | inputs | parameters | counts, stiff, running & at.running)

    def _take(self, at: RolloutSystems, k: int) -> tuple[dict[str, Array], dict[str, Array]]:
        """Take step k in place, and return its inputs and parameters."""
        rollout = self.rollout
        given = {name.removeprefix(LAW_PREFIX): x[k] for name, x in self._schedule.items()}
        if given or k == 0:
            rollout.step(at, self._step, steps=1, **self._options, **given, **(self._given if k == 0 else {}))
        else:  # the arguments have not changed
            least = stop_margins(self._options["least_margin"], self._options["stop_at_limits"])
            rollout.advance(at, 1, least, None, self._options["threads"])
        if given or k == 0 or self._acting is None:
            self._acting = kernel_arguments(rollout.kernel, at.call_inputs)
        return self._acting

    def _backward(self) -> Iterator[tuple[int, StoredStep]]:
        """Yield the steps from the last to the first."""
        if self.every == 1:
            yield from reversed(list(enumerate(self._stored)))
            return
        buffers = self._buffers(len(self.systems))
        for first, start in reversed(list(zip(range(0, self.steps, self.every), self._starts, strict=True))):
            at = start.copy()
            until = min(first + self.every, self.steps)
            yield from reversed([(k, self._store(at, k, buffers, k - first)) for k in range(first, until)])

    def _first(self) -> StoredStep:
        """Return the first step."""
        if self.every == 1:
            return self._stored[0]
        return self._store(self._starts[0].copy(), 0, self._buffers(len(self.systems)), 0)

    def _adjoint(self, stiff: bool, by: Sequence[str], of: Sequence[str]) -> AdjointKernel:
        tableau = IMEX if stiff else scheme_of(self.rollout.scheme)
        return AdjointKernel.of_step(self.rollout.kernel, tableau, by, of)

    # ---- arguments ----

    def _scheduled(self, schedule: Mapping[str, Any], count: int) -> dict[str, Array]:
        """Return the arguments given step by step, with the names of the machine code."""
        checks.instance(schedule, Mapping, "tape: schedule", StateError)
        shapes = self.rollout.law.parameters
        found = {}
        for name, given in schedule.items():
            require_names("tape: schedule", (name,), tuple(shapes))
            if len(np.shape(given)) == 0 or len(given) != self.steps:
                raise StateError(
                    f"schedule: {name}: expected {self.steps} rows, one a step, got shape {np.shape(given)}"
                )
            found[f"{LAW_PREFIX}{name}"] = [fitting(name, x, shapes[name], count) for x in given]
        return found

    def _require_unique(self, names: Sequence[str]) -> None:
        """Refuse cotangents of forces that are not unique.

        Raises:
            MethodNotApplicable: there is such a cotangent; the message names it.
        """
        for name in (*FORCES, *([WORK_RESULT] if self.rollout.base_motion else ())):
            if name in names and self.rollout.kernel.structure.options.held:
                raise MethodNotApplicable(
                    f"tape: along: {name}: expected forces that are unique, got a chain whose grasps hold it more than"
                    " once; a step returns one choice of them, which has no derivative"
                )


def arguments_of(rollout: Rollout) -> tuple[str, ...]:
    """Return what gradients through a rollout may be by."""
    kernel, law = rollout.kernel, rollout.law
    links = [name for name in LINK_ARGUMENTS if name in kernel.externals]
    of_bases = () if rollout.base_motion else (STEP_LENGTH, "base_pose")  # where and when bases move, both decide
    if isinstance(law.torque, SampledTorque):  # its samples are at fixed times
        of_bases = of_bases[1:]
    chains = [name for name in chain_arguments(kernel) if name != "base_pose"]
    if kernel.code.constant:
        of_bases = tuple(name for name in of_bases if name != "base_pose")
    memory = [LAW_MEMORY] if len(law.memory) else []
    return (*state_fields(rollout.chain), *memory, *law.parameters, *of_bases, *chains, *links)


def _of_rows(
    adjoint: AdjointKernel,
    given: Mapping[str, Array],
    cotangents: Mapping[str, Array],
    rows: Array,
    count: int,
    threads: int | None,
) -> dict[str, Array]:
    """Return the gradients of the systems with the given numbers."""
    if len(rows) == count:
        return adjoint.run(given, cotangents, count, threads)
    shapes = {name: e.shape for name, e in adjoint.externals.items()}
    some = {name: x[rows] if name in shapes and x.ndim > len(shapes[name]) else x for name, x in given.items()}
    return adjoint.run(some, {name: x[rows] for name, x in cotangents.items()}, len(rows), threads)
