"""The base class of tasks: phases with their machine code, random values of episodes, and observations."""

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
    """A part of a task in which the set of closed grasps does not change.

    Attributes:
        rollout: the compiled integration steps.
        evaluation: the compiled observation, reward and termination.
    """

    rollout: Rollout
    evaluation: BatchText


class Task(ABC):
    """A task for one environment or many.

    Attributes:
        chain: arms, object and grasps.
        state: closed state in which episodes begin.
        step: h of the integration steps within a control step [s].
        steps_per_action: number of integration steps in a control step.
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
        """Number of entries of an action."""

    @property
    @abstractmethod
    def observed(self) -> Mapping[str, Array]:
        """Bounds of the parts of an observation, in order; each part is clipped to +- its bounds."""

    @property
    @abstractmethod
    def info_names(self) -> tuple[str, ...]:
        """Names of the numbers in `info`."""

    @property
    @abstractmethod
    def phases(self) -> Sequence[Phase]:
        """The phases in order; episodes begin in the first one."""

    @property
    @abstractmethod
    def episode_steps(self) -> int:
        """Number of control steps after which an episode is truncated."""

    @property
    def drawn(self) -> Mapping[str, Shape]:
        """Shapes of the random quantities of an episode, which can also be given as options of `reset`."""
        return {"mass_factor": (), "push": (6,)}

    def draw(self, generator: np.random.Generator) -> dict[str, Array]:
        """Return random values for an episode, by the names of `drawn`."""
        spread = self.mass_spread
        factor = np.array(1.0 + spread * generator.uniform(-1.0, 1.0))
        return {"mass_factor": factor, "push": self.push * generator.uniform(-1.0, 1.0, 6)}

    def start(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return initial states of episodes, (episodes, ...) each; see `Rollout.start`.

        Args:
            drawn: random values of the episodes, (episodes, ...) each.
            phase: index of the phase; for later phases, any state that satisfies the grasps is returned.
        """
        count = len(drawn["mass_factor"])
        fields = state_fields(self.chain).items()
        return {name: np.tile(getattr(self.state, field), (count, 1)) for name, field in fields}

    def load(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return payload and push of episodes as parameters of a phase's rollout, (episodes, ...) each."""
        body, factor = self.chain.held_object, drawn["mass_factor"]
        inertia = factor[:, None, None] * body.inertia
        return {"object_mass": factor * body.mass, "object_inertia": inertia, "object_wrench": drawn["push"]}

    def prepare(self, episodes: Episodes, rows: Array) -> None:
        """Apply the immediate effects of actions before a control step, for example on grasps.

        Args:
            episodes: the batch of episodes.
            rows: indices of the episodes to be stepped, whose actions are already set.
        """
        return

    def commanded(self, actions: Array) -> Array:
        """Return the entries of actions, (episodes, size), that are passed to the control law."""
        return actions

    @property
    def kept(self) -> Mapping[str, Shape]:
        """Shapes of the memory of an episode; `draw` returns its initial values."""
        return {}

    @property
    def frames(self) -> Mapping[str, Array]:
        """Arrays that all episodes share and that `evaluation` takes."""
        return {}

    def argument_shapes(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of the arguments of a phase's `evaluation`, by name."""
        every = shapes(self.chain)
        own = {name: every[name] for name in (*state_fields(chain), "grasp_wrench")}
        own |= {"margin": (len(chain.grasps),), "code": (), "t": (), "action": (self.action_size,)}
        return own | {**self.drawn, **self.kept}

    def result_shapes(self) -> dict[str, Shape]:
        """Return the shapes of the results of `evaluation`, by name."""
        size = sum(len(bound) for bound in self.observed.values())
        return {"observation": (size,), "reward": (), "terminated": ()} | dict.fromkeys(self.info_names, ())

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes for pickling; machine code is compiled again or loaded from the cache."""
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]

    def accepted(self, given: Any, count: int | None = None) -> Array:
        """Return an action, or (count, ...) actions, as an array.

        Raises:
            StateError: the shape is wrong, or a number is not finite.
        """
        shape = (self.action_size,) if count is None else (count, self.action_size)
        return checks.numbers(given, shape, "action", StateError)


def chain_and_state(chain: Any, state: Any, default: Any, what: str) -> tuple[ClosedChain, State]:
    """Return a task's chain and state, which are those of the default if neither is given.

    Raises:
        ModelError: only one of them is given, or one is of another type.
        StateError: the state does not belong to the chain.
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
