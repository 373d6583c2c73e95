"""Gymnasium environments that run one episode of a task at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.gym.carry import CarryTask
from holdfast.gym.episodes import Episodes
from holdfast.gym.hand_over import HandOverTask
from holdfast.gym.place_on_table import PlaceOnTableTask
from holdfast.gym.task import Task
from holdfast.model import checks
from holdfast.names import called
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.scalar import Array
from holdfast.state import State


class TaskEnv(gymnasium.Env[Array, Array]):
    """An environment that runs the episodes of a task one after the other.

    Attributes:
        task: the task.
        episodes: the current episode, a batch of one.
        observation_space: float64, within the bounds of `task.observed`.
        action_space: float64, from -1 to 1.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own)
    kind: ClassVar[type[Task]]

    def __init__(self, task: Task | None = None, *, render_mode: str | None = None, **setting: Any) -> None:
        """Make an environment for a task, or for a new task with these attributes."""
        self.task = task_of(self.kind, task, setting)
        require_no_rendering(render_mode)
        self.observation_space, self.action_space = spaces(self.task)
        self.episodes, self._ready = Episodes(self.task, 1), False

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode, and return its first observation and info.

        Args:
            seed: seed of the random values; None continues with the present generator.
            options: values to use instead of random ones, by the names of `task.drawn`.

        Raises:
            StateError: an option is unknown to the task, or the payload is impossible.
        """
        require_seed(seed)
        super().reset(seed=seed)
        self.episodes.begin(np.array([0]), [self.np_random], options)
        self._ready = True
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Take a control step; return observation, reward, terminated, truncated and info.

        Args:
            action: (size,), clipped to [-1, 1].

        Raises:
            StateError: the action has another shape or is not finite, or no episode is under way.
        """
        chosen = self.task.accepted(action)
        if not self._ready:
            raise StateError("step: expected an episode under way, got none, or one that is over; try reset()")
        self.episodes.step(np.array([0]), chosen[None])
        terminated, truncated = bool(self.episodes.terminated[0]), bool(self.episodes.truncated[0])
        self._ready = not (terminated or truncated)
        return self._observation(), float(self.episodes.seen["reward"][0]), terminated, truncated, self._info()

    def render(self) -> None:
        """Raise an error, as environments cannot render.

        Raises:
            MethodNotApplicable: always; the message says how to draw a state.
        """
        raise MethodNotApplicable(f"render: {NOT_RENDERED}")

    @property
    def state(self) -> State:
        """The present state."""
        return systems_of(self.episodes, 0).state(0)

    def _observation(self) -> Array:
        return self.episodes.seen["observation"][0].copy()

    def _info(self) -> dict[str, Any]:
        return {name: x[0].item() if x.dtype != object else x[0] for name, x in self.episodes.info.items()}


@called
class Carry(TaskEnv):
    """Carry an object along a path with no more internal force than is needed to hold it; see `CarryTask`.

        env = hf.gym.Carry(chain=chain, state=state, largest_internal=60.0)
        env = gymnasium.make("holdfast/Carry-v0")  # after `import holdfast.gym`

    The arguments are a `CarryTask`, or its attributes by name; `render_mode` must be None.

    Raises:
        ModelError, StateError: the task is not a `CarryTask`, or an attribute is invalid; the message names it.
    """

    kind = CarryTask


@called
class HandOver(TaskEnv):
    """Hand an object from one arm to another; see `HandOverTask`.

        env = hf.gym.HandOver(chain=chain, state=state, giver="left", receiver="right")
        env = gymnasium.make("holdfast/HandOver-v0")  # after `import holdfast.gym`

    The arguments are a `HandOverTask`, or its attributes by name; `render_mode` must be None.

    Raises:
        ModelError, StateError: the task is not a `HandOverTask`, or an attribute is invalid; the message names it.
    """

    kind = HandOverTask


@called
class PlaceOnTable(TaskEnv):
    """Place an object on a table; see `PlaceOnTableTask`.

        env = hf.gym.PlaceOnTable(displacement=[0.05, 0.05, 0.0])
        env = gymnasium.make("holdfast/PlaceOnTable-v0")  # after `import holdfast.gym`

    The arguments are a `PlaceOnTableTask`, or its attributes by name; `render_mode` must be None.

    Raises:
        ModelError, StateError: the task is not a `PlaceOnTableTask`, or an attribute is invalid; the message names it.
    """

    kind = PlaceOnTableTask


def task_of(kind: type[Any], task: Any, setting: Mapping[str, Any]) -> Any:
    """Return the given task, or a new one of the given kind with the attributes in `setting`.

    Raises:
        ModelError: the task is of another kind, both a task and attributes are given, or an attribute is unknown.
    """
    what, known = kind.__name__, [f.name for f in fields(kind)]
    for name in setting:
        if name not in known:
            raise ModelError(f"{what}: no setting '{name}'.{checks.did_you_mean(name, known)}")
    if task is None:
        return kind(**setting)
    checks.instance(task, kind, "task")
    if setting:
        raise ModelError(f"task: expected none beside {', '.join(setting)}; try {what}(...) with all of them")
    return task


def spaces(task: Task) -> tuple[Box, Box]:
    """Return the spaces of a task's observations and actions."""
    high = np.concatenate(list(task.observed.values()))
    return Box(-high, high, dtype=np.float64), Box(-1.0, 1.0, (task.action_size,), dtype=np.float64)


def systems_of(episodes: Episodes, row: int) -> RolloutSystems:
    """Return the rollout system of one episode."""
    return episodes.systems[episodes.phase[row]].copy([row])


def require_seed(seed: Any) -> None:
    """Refuse what seeds no generator.

    Raises:
        StateError: it is neither None nor an integer >= 0.
    """
    whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if seed is not None and not (whole and seed >= 0):
        raise StateError(f"seed: expected None or an integer >= 0, got {checks.short(seed)}")


def require_no_rendering(render_mode: str | None) -> None:
    """Refuse any render mode other than None."""
    if render_mode is not None:
        raise MethodNotApplicable(f"render_mode: expected None, got {checks.short(render_mode)}; {NOT_RENDERED}")


NOT_RENDERED = "environments draw nothing; try holdfast.simulate(...).show() or plot() on `env.state`"
