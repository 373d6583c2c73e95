"""A batch of episodes of one task: a single environment has one, a vector environment has many."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.gym.task import SEEN_CONTACTS, Phase, Task
from holdfast.model import checks
from holdfast.questions.arrays import state_fields
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import RolloutStatus, RolloutSystems, status_codes
from holdfast.spatial.scalar import Array

STATUS_NAMES = np.array([status.name for status in RolloutStatus], dtype=object)

LARGEST_OPTION = 1e9  # in SI units, as in scenes: far beyond what means anything, and its powers are numbers


class Episodes:
    """A batch of episodes of a task, each of which is stepped by the machine code of its current phase.

    The course of an episode depends only on its random values and its actions; it is identical to the bit whatever
    the number of other episodes in the batch.

    Attributes:
        task: the task.
        count: number of episodes.
        threads: as for `Rollout.step`.
        drawn: random values of the episodes, (count, ...) each.
        steps: (count,) control steps taken so far.
        phase: (count,) index of the current phase.
        actions: (count, size) last actions.
        systems: rollout systems of each phase, with a row for every episode.
        seen: results of the last `evaluation` of the task, (count, ...) each.
    """

    def __init__(self, task: Task, count: int, threads: int | None = None) -> None:
        """Compile the task; no episode is begun.

        Raises:
            StateError: the task's chain cannot be stepped from its state.
        """
        self.task, self.count, self.threads = task, count, threads
        middle = task.draw(np.random.default_rng(0))
        self.drawn = {name: np.tile(x, (count, *[1] * x.ndim)) for name, x in middle.items()}
        self.steps, self.phase = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self.actions = np.zeros((count, task.action_size))
        self.seen = {name: np.zeros((count, *shape)) for name, shape in task.result_shapes().items()}
        self.systems = [self._started(number, np.arange(count)) for number in range(len(task.phases))]

    def begin(
        self, rows: Array, generators: Sequence[np.random.Generator], options: Mapping[str, Any] | None = None
    ) -> None:
        """Restart some of the episodes.

        Args:
            rows: their indices.
            generators: a random number generator for each of them.
            options: values to use instead of random ones, by the names of `Task.drawn`; one value, or a row for every
                episode of the batch.

        Raises:
            StateError: an option is unknown to the task or has the wrong shape, or a payload is impossible.
        """
        given = self._options(options)
        for row, generator in zip(rows, generators, strict=True):
            for name, x in self.task.draw(generator).items():
                self.drawn[name][row] = given[name][row] if name in given else x
        self.steps[rows], self.phase[rows], self.actions[rows] = 0, 0, 0.0
        self.systems[0].reset(rows, self._started(0, rows))
        self._evaluate(rows)

    def step(self, rows: Array, actions: Array) -> None:
        """Take a control step in some of the episodes.

        Args:
            rows: their indices.
            actions: (rows, size) their actions.
        """
        self.actions[rows] = actions
        self.task.prepare(self, rows)
        for number, phase in enumerate(self.task.phases):
            some = rows[self.phase[rows] == number]
            if len(some):
                self._advance(phase, self.systems[number], some)
        self.steps[rows] += 1
        self._evaluate(rows)

    @property
    def terminated(self) -> Array:
        """(count,) whether each episode has terminated."""
        return self.seen["terminated"] > 0.5

    @property
    def truncated(self) -> Array:
        """(count,) whether each episode has reached its time limit without terminating."""
        return (self.steps >= self.task.episode_steps) & ~self.terminated

    @property
    def info(self) -> dict[str, Array]:
        """Additional results of the last evaluation, (count,) each; `status` is that of the rollout."""
        info = {name: self.seen[name].copy() for name in self.task.info_names}
        codes = np.zeros(self.count, dtype=int)
        for number, systems in enumerate(self.systems):
            codes = np.where(self.phase == number, status_codes(systems), codes)
        return info | {"status": STATUS_NAMES[codes]}

    def _options(self, options: Mapping[str, Any] | None) -> dict[str, Array]:
        """Return the values given instead of random ones, with a row for every episode."""
        given = {} if options is None else options
        if not isinstance(given, Mapping):
            raise StateError(f"options: expected a mapping from a name to a value, got {type(given).__name__}")
        found, shapes = {}, self.task.drawn
        for name, value in given.items():
            if name not in shapes:
                raise StateError(f"options: no '{name}'.{checks.did_you_mean(str(name), shapes)}")
            x = checks.numbers(value, None, f"options: {name}", StateError)
            if x.shape not in (shapes[name], (self.count, *shapes[name])):
                expected = checks.shapes_with_rows(shapes[name], self.count)
                raise StateError(f"options: {name}: expected shape {expected}, got {x.shape}")
            if x.size and np.abs(x).max() > LARGEST_OPTION:
                got = checks.short(value)
                raise StateError(f"options: {name}: expected numbers up to {LARGEST_OPTION:g}, got {got}")
            found[name] = np.broadcast_to(x, (self.count, *shapes[name]))
        return found

    def take_over(self, rows: Array, phase: int) -> None:
        """Move some episodes from the previous phase into a phase, which opens and closes grasps.

        Args:
            rows: their indices.
            phase: index of the new phase.
        """
        rollout, systems = self.task.phases[phase].rollout, self.systems[phase - 1].copy(rows)

        def take_over(some: Array, given: Any) -> RolloutSystems:
            return rollout.take_over(systems.copy(some), **given, threads=self.threads)

        self.systems[phase].reset(rows, in_rows(rollout, len(rows), self._given(phase, rows), take_over))
        self.phase[rows] = phase

    def _given(self, phase: int, rows: Array) -> dict[str, Array]:
        """Return the arguments of a phase's rollout, with a row for each of some episodes."""
        drawn = {name: x[rows] for name, x in self.drawn.items()}
        return self.task.load(drawn, phase) | {"action": self.task.commanded(self.actions[rows])}

    def _started(self, phase: int, rows: Array) -> RolloutSystems:
        """Return rollout systems at the beginning of episodes, with all arguments given row by row."""
        rollout, given = self.task.phases[phase].rollout, self._given(phase, rows)
        given |= self.task.start({name: x[rows] for name, x in self.drawn.items()}, phase)
        fresh = in_rows(rollout, len(rows), given, lambda _, own: rollout.start(**own, threads=self.threads))
        if not fresh.running.all():
            row = int(np.flatnonzero(~fresh.running)[0])
            raise StateError(
                f"environment {rows[row]}: expected a state and a payload from which the chain can move, got one of"
                f" which a rollout says: {fresh.status[row].value}; try holdfast.diagnose(chain, state)"
            )
        return fresh

    def _advance(self, phase: Phase, systems: RolloutSystems, rows: Array) -> None:
        """Take a control step with the systems of some episodes, using their actions."""
        every, task = len(rows) == self.count, self.task
        part = systems if every else systems.copy(rows)
        part.under = ()  # always recompute the slopes, so that a step's bits depend only on state and action
        options: Any = {"least_margin": 0.0, "stop_at_limits": task.stop_at_limits, "threads": self.threads}
        phase.rollout.step(
            part, task.step, steps=task.steps_per_action, action=task.commanded(self.actions[rows]), **options
        )
        if not every:
            systems.reset(rows, part)

    def _evaluate(self, rows: Array) -> None:
        """Evaluate observation, reward and termination of some episodes, each in its phase."""
        for number, phase in enumerate(self.task.phases):
            some = rows[self.phase[rows] == number]
            if not len(some):
                continue
            arrays = self.systems[number].arrays
            contacts = SEEN_CONTACTS if self.task.chain.touching is not None else ()
            names = (*state_fields(self.task.chain), "grasp_wrench", "margin", "code", *contacts)
            every = slice(None) if len(some) == self.count else some
            given = {name: arrays[name][every] for name in names} | dict(self.task.frames)
            given |= {name: x[every] for name, x in self.drawn.items()}
            t = self.steps[every] * (self.task.step * self.task.steps_per_action)
            found = phase.evaluation(len(some), given | {"t": t, "action": self.actions[every]}, self.threads)
            for name, x in found.items():
                self.seen[name][every] = x


def in_rows(
    rollout: Rollout, count: int, given: Mapping[str, Array], make: Callable[[Array, Any], RolloutSystems]
) -> RolloutSystems:
    """Make rollout systems in one call or, if the rollout selects constraint rows, in one call for each system.

    The selection is tried on the first system of a call, so that the bits of the other systems may depend on it.

    Args:
        rollout: the rollout.
        count: number of systems.
        given: arguments with a row for each system.
        make: function that makes the systems of some rows from their numbers and their arguments.
    """
    if count == 1 or "held_rows" not in rollout.kernel.carried:
        return make(np.arange(count), given)
    numbers = [np.array([row]) for row in range(count)]
    every = [make(some, {name: x[some] for name, x in given.items()}) for some in numbers]
    found = every[0].copy(np.zeros(count, dtype=int))
    for name, x in found.call_inputs.items():
        found.call_inputs[name] = np.tile(x, (count, *[1] * (x.ndim - 1))) if len(x) == 1 else x
    for row, one in enumerate(every):
        found.reset([row], one)
    return found
