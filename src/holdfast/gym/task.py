"""What every task has: phases of machine code, what differs between episodes, and how it is observed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from holdfast.compiled.externals import shapes, state_fields
from holdfast.compiler.program import Shape
from holdfast.errors import ModelError, StateError
from holdfast.gym.batch_text import BatchText
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_fit

if TYPE_CHECKING:
    from holdfast.gym.episodes import Episodes


class Phase(NamedTuple):
    """Part of a task with one set of grasps.

    Attributes:
        rollout: its steps.
        look: what is observed, rewarded and over in it.
    """

    rollout: Rollout
    look: BatchText


class Task(ABC):
    """What is to be done, for one environment or many.

    Attributes:
        chain: arms, object and grasps.
        state: closed, where episodes begin.
        step: h of the steps within a control step [s].
        steps_per_action: how many of them an action is held for.
        mass_spread: the payload's mass lies within 1 +- this times the model's.
        push: (6,) largest constant wrench [moment; force] on the object about C, world axes [N m, N].
        stop_at_limits: whether a joint beyond a limit of position, rate or effort ends an episode.
    """

    chain: ClosedChain
    state: State
    step: float
    steps_per_action: int
    mass_spread: float
    push: Any
    stop_at_limits: bool

    @property
    @abstractmethod
    def action_size(self) -> int:
        """How many numbers an action has."""

    @property
    @abstractmethod
    def observed(self) -> Mapping[str, Array]:
        """Bounds of the parts of an observation, in order: each lies within +- them, beyond which it is clipped."""

    @property
    @abstractmethod
    def info_names(self) -> tuple[str, ...]:
        """Names of the numbers in `info`."""

    @property
    @abstractmethod
    def phases(self) -> Sequence[Phase]:
        """The phases in order; episodes begin in the first."""

    @property
    @abstractmethod
    def episode_steps(self) -> int:
        """Control steps until an episode is truncated."""

    @property
    def drawn(self) -> Mapping[str, Shape]:
        """Shapes of what is drawn for every episode, and may be given as options of `reset`."""
        return {"mass_factor": (), "push": (6,)}

    def draw(self, generator: np.random.Generator) -> dict[str, Array]:
        """Return what is drawn for an episode, by the names of `drawn`."""
        spread = self.mass_spread
        factor = np.array(1.0 + spread * generator.uniform(-1.0, 1.0))
        return {"mass_factor": factor, "push": self.push * generator.uniform(-1.0, 1.0, 6)}

    def start(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return the states in which episodes begin, (episodes, ...) each; see `Rollout.start`.

        Args:
            drawn: what was drawn for them, (episodes, ...) each.
            phase: by number; where it is not the first, any state in which its grasps hold.
        """
        count = len(drawn["mass_factor"])
        fields = state_fields(self.chain).items()
        return {name: np.tile(getattr(self.state, field), (count, 1)) for name, field in fields}

    def load(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return payload and push of episodes, as parameters of a phase's rollout, (episodes, ...) each."""
        body, factor = self.chain.held_object, drawn["mass_factor"]
        inertia = factor[:, None, None] * body.inertia
        return {"object_mass": factor * body.mass, "object_inertia": inertia, "object_wrench": drawn["push"]}

    def prepare(self, episodes: Episodes, rows: Array) -> None:
        """Change what an action changes at once, before a control step: grasps, for one.

        Args:
            episodes: those under way.
            rows: which of them are about to be stepped; their actions are set.
        """
        return

    def commanded(self, actions: Array) -> Array:
        """Return the part of actions, (episodes, size), that the control law takes."""
        return actions

    @property
    def kept(self) -> Mapping[str, Shape]:
        """Shapes of what episodes keep besides; `draw` says what it is at first."""
        return {}

    @property
    def frames(self) -> Mapping[str, Array]:
        """What all episodes share and a look takes."""
        return {}

    def looked_at(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return shapes of what is looked at in a phase, by name."""
        every = shapes(self.chain)
        own = {name: every[name] for name in (*state_fields(chain), "grasp_wrench")}
        own |= {"margin": (len(chain.grasps),), "code": (), "t": (), "action": (self.action_size,)}
        return own | {**self.drawn, **self.kept}

    def says(self) -> dict[str, Shape]:
        """Return shapes of what a look returns, by name."""
        size = sum(len(bound) for bound in self.observed.values())
        return {"observation": (size,), "reward": (), "terminated": ()} | dict.fromkeys(self.info_names, ())

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: the setting; machine code is compiled, or found on disk."""
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]

    def accepted(self, given: Any, count: int | None = None) -> Array:
        """Return an action, or (count, ...) of them, as numbers.

        Raises:
            StateError: another shape, or numbers that are not finite.
        """
        shape = (self.action_size,) if count is None else (count, self.action_size)
        return checks.numbers(given, shape, "action", StateError)


def chain_and_state(chain: Any, state: Any, default: Any, what: str) -> tuple[ClosedChain, State]:
    """Return a task's chain and state: the user's, or the default's where neither is given.

    Raises:
        ModelError: one of them alone, or something else.
        StateError: a state of another chain.
    """
    if chain is None and state is None:
        return default()
    if not isinstance(chain, ClosedChain):
        raise ModelError(f"{what}: chain: expected a ClosedChain beside a state, got {type(chain).__name__}")
    if not isinstance(state, State):
        raise ModelError(
            f"{what}: state: expected a closed State of the chain, got {type(state).__name__}; try"
            " chain, state = holdfast.assemble(...)"
        )
    require_fit(chain, state)
    return chain, state
