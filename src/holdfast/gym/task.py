"""The base class of tasks: phases with their machine code, random values, checks of attributes, default chains."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import cached_property
from inspect import signature
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from holdfast.assembly.assemble import assemble
from holdfast.compiled.traced_chain import Given, traced
from holdfast.compiler.kernel import BatchKernel
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External
from holdfast.control.controller import ControlLaw, held_torques
from holdfast.control.sampled import initial_memories, require_steps, sampled
from holdfast.errors import ModelError, StateError
from holdfast.forces.margins import joint_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Friction, Grasp, GraspName, contact_frame
from holdfast.model.held_object import HeldObject
from holdfast.model.serial_chain import serial_chain
from holdfast.model.world.solids import HalfSpace
from holdfast.model.world.touching import Touching, corners
from holdfast.progress import busy
from holdfast.questions.arrays import shapes, state_fields
from holdfast.robots.panda import panda
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.spatial.frozen import FrozenDict, frozen_property, read_only
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_fit

if TYPE_CHECKING:
    from holdfast.gym.episodes import Episodes

TENTH = 0.1  # default torque at an action of 1, as a fraction of the effort limit
STREAMS = 10**9  # number of streams of random numbers from which episodes draw theirs
SEEN_CONTACTS = ("touch_force", "touch_gap")  # what an evaluation is given of contacts with the world
UNLIMITED = 10.0  # N m or N: default torque at an action of 1 without an effort limit


class BatchFunction:
    """A function from named arrays to named arrays, written like a control law and compiled at its first call.

    The results of a system are identical to the bit whatever the size of the batch.

    Attributes:
        function: the function for one system; it can also be called with numbers.
        inputs: shapes of its arguments, by name.
        outputs: shapes of its results, by name.
    """

    def __init__(
        self, function: Callable[[Given], Mapping[str, Any]], inputs: Mapping[str, Shape], outputs: Mapping[str, Shape]
    ) -> None:
        self.function, self.inputs, self.outputs = function, dict(inputs), dict(outputs)
        externals = {name: External(shape, "input") for name, shape in inputs.items()}
        externals |= {name: External(shape, "output") for name, shape in outputs.items()}
        self._kernel = BatchKernel(
            externals, lambda: traced(externals, function), shown=lambda: busy(None, "compiling a task")
        )

    def __call__(self, count: int, given: Mapping[str, Array], threads: int | None = None) -> dict[str, Array]:
        """Return the results of the function for every system, (count, *shape) each.

        Args:
            count: number of systems.
            given: arguments by name, (count, *shape) each, or (*shape) if all systems share it.
            threads: as for `Rollout.step`.
        """
        arrays = {name: np.asarray(given[name], dtype=float, order="C") for name in self.inputs}
        found = {name: np.empty((count, *shape)) for name, shape in self.outputs.items()}
        self._kernel.run_arrays(arrays | found, count, threads)
        return found


class Phase(NamedTuple):
    """A part of a task in which the set of closed grasps does not change.

    Attributes:
        rollout: the compiled integration steps.
        evaluation: the compiled observation, reward and termination.
    """

    rollout: Rollout
    evaluation: BatchFunction


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
        sampling: arguments of `control.sampled` for the control law, by name; None for a law that acts all the time.
    """

    chain: ClosedChain
    state: State
    step: float
    steps_per_action: int
    mass_spread: float
    push: Any
    stop_at_limits: bool
    sampling: Mapping[str, Any] | None

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

    @cached_property
    def phases(self) -> Sequence[Phase]:
        """The phases in order; episodes begin in the first one. Every task has its own."""
        raise NotImplementedError

    @property
    @abstractmethod
    def episode_steps(self) -> int:
        """Number of control steps after which an episode is truncated."""

    @property
    def drawn(self) -> Mapping[str, Shape]:
        """Shapes of the random quantities of an episode, which can also be given as options of `reset`."""
        return {"mass_factor": (), "push": (6,)} | ({"noise_stream": ()} if self._noisy else {})

    def draw(self, generator: np.random.Generator) -> dict[str, Array]:
        """Return random values for an episode, by the names of `drawn`."""
        spread = self.mass_spread
        factor = np.array(1.0 + spread * generator.uniform(-1.0, 1.0))
        found = {"mass_factor": factor, "push": self.push * generator.uniform(-1.0, 1.0, 6)}
        return found | ({"noise_stream": np.array(float(generator.integers(STREAMS)))} if self._noisy else {})

    def start(self, drawn: Mapping[str, Array], phase: int) -> dict[str, Array]:
        """Return initial states of episodes, (episodes, ...) each; see `Rollout.start`.

        Args:
            drawn: random values of the episodes, (episodes, ...) each.
            phase: index of the phase; for later phases, any state that satisfies the grasps is returned.
        """
        count = len(drawn["mass_factor"])
        fields = state_fields(self.chain).items()
        found = {name: np.tile(getattr(self.state, field), (count, 1)) for name, field in fields}
        if not self._noisy:
            return found
        streams = drawn["noise_stream"]
        if (streams < 0.0).any() or (streams % 1.0).any():
            raise StateError(f"options: noise_stream: expected an integer >= 0, got {checks.short(streams)}")
        return found | {"memory": initial_memories(self.phases[phase].rollout.law, streams)}

    @property
    def _noisy(self) -> bool:
        return bool(self.sampling and self.sampling.get("noise"))

    def sampled(self, law: ControlLaw, chain: ClosedChain) -> ControlLaw:
        """Return the control law of a phase, sampled as `sampling` says."""
        return law if self.sampling is None else sampled(law, chain, **self.sampling)

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

    @frozen_property
    def frames(self) -> Mapping[str, Array]:
        """Arrays that all episodes share and that `evaluation` takes."""
        return {}

    def argument_shapes(self, chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of the arguments of a phase's `evaluation`, by name."""
        every = shapes(self.chain)
        own = {name: every[name] for name in (*state_fields(chain), "grasp_wrench")}
        if chain.touching is not None:
            own |= {name: every[name] for name in SEEN_CONTACTS}
        own |= {"margin": (len(chain.grasps),), "code": (), "t": (), "action": (self.action_size,)}
        return own | {**self.drawn, **self.kept}

    def result_shapes(self) -> dict[str, Shape]:
        """Return the shapes of the results of `evaluation`, by name."""
        size = sum(len(bound) for bound in self.observed.values())
        return {"observation": (size,), "reward": (), "terminated": ()} | dict.fromkeys(self.info_names, ())

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes for pickling; machine code is compiled again or loaded from the cache."""
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]

    def _check_common(self, what: str, default: Callable[[], tuple[ClosedChain, State]]) -> None:
        """Check and convert in place the attributes that all tasks have.

        Args:
            what: name of the task, for messages.
            default: function that returns the chain and the state of a task for which neither is given.

        Raises:
            ModelError: an attribute is invalid, or only one of chain and state is given; the message names it.
            StateError: the state does not belong to the chain.
        """
        put = object.__setattr__
        chain, state = default() if self.chain is None and self.state is None else (self.chain, self.state)
        if not isinstance(chain, ClosedChain):
            raise ModelError(f"{what}: chain: expected a ClosedChain beside a state, got {type(chain).__name__}")
        serial_chain(chain, f"{what}: chain")
        if not isinstance(state, State):
            raise ModelError(
                f"{what}: state: expected a closed State of the chain, got {type(state).__name__}; try"
                " chain, state = holdfast.assemble(...)"
            )
        require_fit(chain, state)
        put(self, "chain", chain)
        put(self, "state", state)
        self._check_numbers(what, ("step", "tolerance", "tolerance_angle"), above=0.0)
        self._check_numbers(what, ("effort_cost", "failure_cost", "mass_spread"), at_least=0.0)
        steps = self.steps_per_action
        if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or steps < 1:
            raise ModelError(f"{what}: steps_per_action: expected an integer >= 1, got {checks.short(steps)}")
        if self.mass_spread >= 1.0:
            got = f"{self.mass_spread:g}"
            raise ModelError(f"{what}: mass_spread: expected less than 1, as masses are positive, got {got}")
        put(self, "push", spread(self.push, 6, f"{what}: push"))
        checks.instance(self.stop_at_limits, (bool, np.bool_), f"{what}: stop_at_limits")
        if self.sampling is not None:
            checks.instance(self.sampling, Mapping, f"{what}: sampling")
            put(self, "sampling", FrozenDict(self.sampling))
            known = list(signature(sampled).parameters)[2:]  # after the law and the chain
            for name in self.sampling:
                if name not in known:
                    raise ModelError(f"{what}: sampling: no {checks.short(name)}.{checks.did_you_mean(name, known)}")
            if "sample_time" not in self.sampling:
                raise ModelError(f"{what}: sampling: expected a sample_time, got none; try {{'sample_time': 1e-3}}")
            require_steps(self.sampled(held_torques(chain.joint_count), chain), self.step)

    def _check_numbers(self, what: str, names: Sequence[str], **bounds: float) -> None:
        """Check attributes that are numbers, and convert them to floats in place; see `checks.number`."""
        for name in names:
            object.__setattr__(self, name, checks.number(getattr(self, name), f"{what}: {name}", **bounds))

    def _control_steps(self, duration: float) -> int:
        """Return the number of control steps in a duration, at least one."""
        return max(1, round(duration / (self.step * self.steps_per_action)))

    def accepted(self, given: Any, count: int | None = None) -> Array:
        """Return an action, or (count, ...) actions, as an array.

        Raises:
            StateError: the shape is wrong, or a number is not finite.
        """
        shape = (self.action_size,) if count is None else (count, self.action_size)
        return checks.numbers(given, shape, "action", StateError)


def spread(value: Any, count: int, what: str) -> Array:
    """Return largest deviations from a mean, (count,), none of which may be negative."""
    x = checks.numbers(value, (count,), what)
    if (x < 0.0).any():
        raise ModelError(f"{what}: expected numbers >= 0, each a largest deviation to both sides, got {x.min():g}")
    return x


def torques(value: Any, chain: ClosedChain, what: str) -> Array:
    """Return the torques at an action of 1, (n,) [N m or N]: a tenth of the effort limits if none are given."""
    if value is not None:
        return spread(value, chain.joint_count, f"{what}: joint_torque")
    limits = joint_limits(chain).effort
    return read_only(np.where(np.isfinite(limits), TENTH * limits, UNLIMITED))


def two_fingers() -> tuple[ClosedChain, State]:
    """Return two arms that press a 3 kg box between rubber fingers."""
    return _two_pandas(HeldObject.box(3.0, 0.3, 0.2, 0.2), "softfinger", Friction(mu=0.8, torsion_radius=0.02))


def two_hands() -> tuple[ClosedChain, State]:
    """Return two arms with rigid grasps of a 1 kg box, so that each could hold it alone."""
    return _two_pandas(HeldObject.box(1.0, 0.3, 0.1, 0.1), "rigid", None)


def over_a_table() -> tuple[ClosedChain, State]:
    """Return two arms with rigid grasps of a 1 kg box, 5 cm above a table that its lower corners may touch."""
    chain, state = two_hands()
    below = {name: p for name, p in corners(0.3, 0.1, 0.1).items() if np.asarray(p)[2] < 0.0}
    table = HalfSpace(offset=float(state.object_frame.p[2]) - 0.1, friction=0.5)
    return replace(chain, touching=Touching(below, {"table": table})), state


def _two_pandas(box: HeldObject, kind: GraspName, contact: Friction | None) -> tuple[ClosedChain, State]:
    """Return two Pandas with armature that face each other, and that hold a box 0.3 m long at its ends."""
    bases = {"left": (1, 0, 0, 0, -0.55, 0, 0), "right": (0, 0, 0, 1, 0.55, 0, 0)}
    ends = {"left": contact_frame([-0.15, 0, 0], into=[1, 0, 0]), "right": contact_frame([0.15, 0, 0], into=[-1, 0, 0])}
    arms = {name: panda(base, armature=0.3) for name, base in bases.items()}
    grasps = {name: Grasp(kind, frame, contact=contact) for name, frame in ends.items()}
    return assemble(arms, box, grasps, object_pose=(1, 0, 0, 0, 0, 0, 0.72))
