"""Gymnasium vector environments that step many episodes of a task in one batch of machine code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from holdfast.compiled.arrays import require_threads
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.gym.carry import CarryTask
from holdfast.gym.environments import NOT_RENDERED, require_no_rendering, require_seed, spaces, systems_of, task_of
from holdfast.gym.episodes import Episodes
from holdfast.gym.hand_over import HandOverTask
from holdfast.gym.place_on_table import PlaceOnTableTask
from holdfast.gym.task import Task
from holdfast.model import checks
from holdfast.names import called
from holdfast.simulation.rollout.arguments import whole_number
from holdfast.spatial.scalar import Array
from holdfast.state import State

Infos = dict[str, Any]


class TaskVectorEnv(VectorEnv[Array, Array, Array]):
    """A vector environment, whose results are identical to the bit to those of as many single environments.

    Attributes:
        task: the task.
        episodes: the batch of episodes.
        autoreset_mode: when an episode that has ended is reset.
    """

    kind: ClassVar[type[Task]]

    def __init__(
        self,
        num_envs: int = 1,
        task: Task | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        render_mode: str | None = None,
        **setting: Any,
    ) -> None:
        """Make environments for a task, or for a new task with these attributes."""
        self.num_envs = whole_number("num_envs", num_envs)
        self.task = task_of(self.kind, task, setting)
        require_no_rendering(render_mode)
        self.autoreset_mode = mode_of(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = spaces(self.task)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        require_threads(threads)
        self.episodes = Episodes(self.task, self.num_envs, threads)
        self._generators: list[np.random.Generator] = []
        self._seeds: list[int] = []
        self._started, self._over = np.zeros(self.num_envs, dtype=bool), np.zeros(self.num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Array, Infos]:
        """Begin episodes; return the observations of all environments and the infos of those that were reset.

        Args:
            seed: a seed for each environment, or the seed of the first one, which increases by one from each to the
                next; None continues with the present generators.
            options: values to use instead of random ones, by the names of `task.drawn`, one value or a row for each
                environment; `reset_mask` (num_envs,) selects the environments to reset, all by default.

        Raises:
            StateError: the number of seeds or the shape of the mask is wrong, or an option is unknown to the task.
        """
        given = {} if options is None else options
        checks.instance(given, Mapping, "options", StateError)
        rows = self._masked(given.get("reset_mask"))
        self._seed(seed, rows)
        self._begin(rows, {name: x for name, x in given.items() if name != "reset_mask"})
        return self._observations(), self._infos(rows)

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, Infos]:
        """Take a control step; return observations, rewards, terminations, truncations and infos.

        Args:
            actions: (num_envs, size), clipped to [-1, 1].

        Raises:
            StateError: the actions have another shape or are not finite, no episode is under way, or an episode has
                ended and is not reset automatically.
        """
        chosen = self.task.accepted(actions, self.num_envs)
        if not self._started.all():
            raise StateError("step: expected episodes under way, got none; try reset()")
        over, every = self._over, np.arange(self.num_envs)
        if self.autoreset_mode is AutoresetMode.DISABLED and over.any():
            raise StateError(
                f"step: expected episodes under way, got one that is over: environment {np.flatnonzero(over)[0]}; try"
                " reset(options={'reset_mask': terminations | truncations})"
            )
        again = every[over] if self.autoreset_mode is AutoresetMode.NEXT_STEP else every[:0]
        going = every[~over] if len(again) else every
        if len(going):
            self.episodes.step(going, chosen[going])
        now = self.episodes
        reward, terminated, truncated = now.seen["reward"].copy(), now.terminated, now.truncated
        if len(again):
            self._begin(again)
            reward[again], terminated[again], truncated[again] = 0.0, False, False
        self._over = terminated | truncated
        infos: Infos = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            ended = every[self._over]
            infos |= self._final(ended)
            self._begin(ended)
        return self._observations(), reward, terminated, truncated, infos | self._infos(every)

    def render(self) -> None:
        """Raise an error, as environments cannot render.

        Raises:
            MethodNotApplicable: always; the message says how to draw a state.
        """
        raise MethodNotApplicable(f"render: {NOT_RENDERED}")

    def state(self, number: int) -> State:
        """Return the state of one environment.

        Args:
            number: index of the environment, from 0.

        Raises:
            StateError: there is no such environment.
        """
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < self.num_envs:
            raise StateError(f"number: expected one from 0 to {self.num_envs - 1}, got {checks.short(number)}")
        return systems_of(self.episodes, int(number)).state(0)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The random number generators of the environments."""
        self._seed(None, np.arange(self.num_envs))
        return tuple(self._generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each environment's random number generator."""
        self._seed(None, np.arange(self.num_envs))
        return tuple(self._seeds)

    def _masked(self, mask: Any) -> Array:
        """Return the indices of the environments to reset."""
        if mask is None:
            return np.arange(self.num_envs)
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            raise StateError(
                f"options: reset_mask: expected an array of {self.num_envs} truth values, at least one of them true,"
                f" got {checks.short(mask)}"
            )
        return np.flatnonzero(mask)

    def _seed(self, seed: Any, rows: Array) -> None:
        """Make generators with new seeds for some environments, and generators for all that have none yet."""
        if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
            seed = [int(seed) + k for k in range(self.num_envs)]
        seeds = [None] * self.num_envs if seed is None else list(seed) if isinstance(seed, Sequence) else seed
        if not isinstance(seeds, list) or len(seeds) != self.num_envs:
            raise StateError(f"seed: expected None, an integer, or {self.num_envs} of them, got {checks.short(seed)}")
        for one in seeds:
            require_seed(one)
        if not self._generators:
            self._generators, self._seeds = map(list, zip(*(seeding.np_random(None) for _ in seeds), strict=True))
        for row in rows.tolist():
            if seeds[row] is not None:
                self._generators[row], self._seeds[row] = seeding.np_random(seeds[row])

    def _begin(self, rows: Array, options: Mapping[str, Any] | None = None) -> None:
        self.episodes.begin(rows, [self._generators[row] for row in rows], options)
        self._started[rows], self._over[rows] = True, False

    def _observations(self) -> Array:
        return self.episodes.seen["observation"].copy()

    def _infos(self, rows: Array) -> Infos:
        """Return the infos of some environments in the layout of Gymnasium, with zeros or None for the others."""
        there = np.zeros(self.num_envs, dtype=bool)
        there[rows] = True
        found: Infos = {}
        for name, x in self.episodes.info.items():
            found[name] = np.full_like(x, None if x.dtype == object else 0.0)
            found[name][rows] = x[rows]
            found[f"_{name}"] = there.copy()
        return found

    def _final(self, rows: Array) -> Infos:
        """Return the final observations and infos of episodes that have ended."""
        there, last = np.zeros(self.num_envs, dtype=bool), np.full(self.num_envs, None, dtype=object)
        there[rows] = True
        for row in rows:
            last[row] = self.episodes.seen["observation"][row].copy()
        return {"final_obs": last, "_final_obs": there, "final_info": self._infos(rows), "_final_info": there.copy()}


@called
class CarryVector(TaskVectorEnv):
    """Many environments of `Carry` in one batch; see `CarryTask`.

        envs = hf.gym.CarryVector(256, chain=chain, state=state, autoreset_mode="SameStep")
        envs = gymnasium.make_vec("holdfast/Carry-v0", num_envs=256)  # after `import holdfast.gym`

    The arguments are the number of environments, a `CarryTask` or its attributes by name, an `AutoresetMode` (NEXT_STEP
    by default) and `threads` as for `Rollout.step`; `render_mode` must be None.

    Raises:
        ModelError, StateError: the task is not a `CarryTask`, or an attribute is invalid; the message names it.
    """

    kind = CarryTask


@called
class HandOverVector(TaskVectorEnv):
    """Many environments of `HandOver` in one batch; see `HandOverTask`.

        envs = hf.gym.HandOverVector(256, autoreset_mode="SameStep")
        envs = gymnasium.make_vec("holdfast/HandOver-v0", num_envs=256)  # after `import holdfast.gym`

    The arguments are the number of environments, a `HandOverTask` or its attributes by name, an `AutoresetMode`
    (NEXT_STEP by default) and `threads` as for `Rollout.step`; `render_mode` must be None.

    Raises:
        ModelError, StateError: the task is not a `HandOverTask`, or an attribute is invalid; the message names it.
    """

    kind = HandOverTask


@called
class PlaceOnTableVector(TaskVectorEnv):
    """Many environments of `PlaceOnTable` in one batch; see `PlaceOnTableTask`.

        envs = hf.gym.PlaceOnTableVector(256, autoreset_mode="SameStep")
        envs = gymnasium.make_vec("holdfast/PlaceOnTable-v0", num_envs=256)  # after `import holdfast.gym`

    The arguments are the number of environments, a `PlaceOnTableTask` or its attributes by name, an `AutoresetMode`
    (NEXT_STEP by default) and `threads` as for `Rollout.step`; `render_mode` must be None.

    Raises:
        ModelError, StateError: the task is not a `PlaceOnTableTask`, or an attribute is invalid; the message names it.
    """

    kind = PlaceOnTableTask


def mode_of(value: AutoresetMode | str) -> AutoresetMode:
    """Return an autoreset mode, which can be given by its value.

    Raises:
        ModelError: there is no such mode.
    """
    try:
        return AutoresetMode(value)
    except ValueError as cause:
        known = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise ModelError(
            f"autoreset_mode: expected an AutoresetMode, or one of {known}, got {checks.short(value)}"
        ) from cause
