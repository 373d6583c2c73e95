"""The class `Rollout`, which advances many systems in machine code, including their control law."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from os import PathLike
from typing import Any

import numpy as np

from holdfast.compiled.arrays import require_threads
from holdfast.compiled.kernels import compiling
from holdfast.compiled.structure import Options
from holdfast.control.controller import ControlLaw
from holdfast.dynamics.grasp_gap import POSITION_TOLERANCE
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import without_contacts
from holdfast.names import called
from holdfast.questions.arrays import state_fields
from holdfast.simulation.environment import GivenInputs
from holdfast.simulation.rollout.arguments import (
    MOST_STEPS_OF_CALL,
    NO_STOPS,
    StopMargins,
    call_inputs,
    drift_limit,
    kernel_arguments,
    number,
    require_at_samples,
    require_systems,
    state_arguments,
    step_inputs,
    step_lengths,
    step_options,
    stop_margins,
    whole_number,
)
from holdfast.simulation.rollout.chain_kinds import kind_of
from holdfast.simulation.rollout.kernel import StepKernel
from holdfast.simulation.rollout.parts import contradicted, diverged, followed
from holdfast.simulation.rollout.record import RolloutArguments, RolloutRecord
from holdfast.simulation.rollout.recording import RecordOutput, recorded_rollout
from holdfast.simulation.rollout.starting import hold_rows, located, remembered, systems_at
from holdfast.simulation.rollout.systems import RolloutSystems, passive_rates
from holdfast.simulation.rollout.tape import Tape
from holdfast.simulation.rollout.traced_step import GRASP_OPEN, LIMITED, PASSES_SINGULAR, SLIPPED, TOO_LONG
from holdfast.simulation.rollout.user_functions import Motions, travelling_inputs, travelling_law, travelling_motion
from holdfast.simulation.rollout.ways import kernels_of, take_steps
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.simulation.stability import USED, surely_stable_step
from holdfast.spatial.scalar import Array

RECORDED = ("q", "qd", "object_pose", "object_twist", "grasp_wrench")


@called
class Rollout:
    """Advances many systems in machine code; created by `compile_rollout`.

    Attributes:
        chain: the chain.
        law: the control law.
        scheme: name of the Runge-Kutta scheme.
        generic_rank: rank of the grasp constraint away from singular configurations, or None while it is unknown.
        base_motion: motions of the moving bases, by arm name.
        inputs: wrenches that act in addition to those passed to calls; None for none.
        options: options of the machine code.
        kind: what rollouts of such chains have of their own.
        kernels: the machine code of a step, by the ways of `rollout.ways`.
    """

    def __init__(
        self,
        chain: ClosedChain,
        law: ControlLaw,
        scheme: str,
        generic_rank: int | None,
        base_motion: Motions,
        options: Options,
        inputs: GivenInputs | None = None,
    ) -> None:
        self.chain, self.law, self.scheme, self.generic_rank = chain, law, scheme, generic_rank
        self.base_motion, self.options, self.inputs = base_motion, options, inputs
        self.kind = kind_of(chain)
        self.kernels = kernels_of(self)
        none = np.zeros(chain.joint_count)
        self._stable_step = surely_stable_step(chain, none, scheme_of(scheme)) if self.kind.implicit else np.inf

    @property
    def kernel(self) -> StepKernel:
        """The machine code of a step of the scheme."""
        return next(iter(self.kernels.values()))

    def __repr__(self) -> str:
        """Return the scheme, the parameters of the law, and the chain."""
        given = ", ".join(self.law.parameters) or "none"
        return f"<Rollout by {self.scheme}, parameters of its law: {given}\n{self.chain!r}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the arguments that create the rollout again; its machine code is then compiled or loaded from disk."""
        law = travelling_law(self.law, self.chain)
        motions = {name: travelling_motion(name, motion) for name, motion in self.base_motion.items()}
        inputs = travelling_inputs(self.inputs, self.chain)
        return Rollout, (self.chain, law, self.scheme, self.generic_rank, motions, self.options, inputs)

    def start(
        self,
        q: Any,
        qd: Any,
        object_pose: Any = None,
        object_twist: Any = None,
        *,
        floating_pose: Any = None,
        floating_twist: Any = None,
        memory: Any = None,
        t: float = 0.0,
        threads: int | None = None,
        progress: bool | None = None,
        **given: Any,
    ) -> RolloutSystems:
        """Return systems at given states, projected onto the grasps, which the states must nearly satisfy.

        Args:
            q: (systems, n) or (n,) joint positions [rad or m].
            qd: joint rates, of the same shape.
            object_pose: (7,) wxyz_xyz; (k, 7) of k objects, None without any.
            object_twist: (6,) [omega; v of C], world axes; (k, 6) of k objects.
            floating_pose: (7,) wxyz_xyz of a trunk's floating base, if there is one.
            floating_twist: (6,) twist of its origin, world axes.
            memory: (m,) memory of the law; by default its initial memory.
            t: initial time [s].
            threads: as for `step`.
            progress: as for `holdfast.compile`.
            **given: parameters of the law and the chain, as for `step`; the systems keep them.

        Raises:
            StateError: a shape is wrong, or there are no systems.
        """
        every = (q, qd, object_pose, object_twist, floating_pose, floating_twist)
        systems = systems_at(self, state_arguments(self.chain, *every), memory, number("t", t))
        systems.keep_inputs(call_inputs(self.kernel, given, len(systems)), self.law, self.inputs)
        with nullcontext() if progress is None else compiling(self.chain, "steps", progress):
            return self._started(systems, threads)

    def take_over(self, systems: RolloutSystems, *, threads: int | None = None, **given: Any) -> RolloutSystems:
        """Return systems of another rollout with the same arms and object, with the grasps and the law of this one.

        Grasps that close exert the impulse that stops all relative velocities which the grasps do not allow, like
        `Attach` in `simulate`. A system in which a closing grasp is open by more than 1e-6 m or rad is stopped. Grasps
        that open release the object. Time, work and the status of stopped systems are kept. So are the law's memory, if
        it has the same size, and the arguments of earlier calls that also apply to this rollout. The worst margins are
        reset.

        Args:
            systems: systems from `start` or `step` of another rollout, which are not changed.
            threads: as for `step`.
            **given: as for `start`.

        Raises:
            StateError: the joints differ, or a shape is wrong.
        """
        require_systems(systems)
        joints, others = self.chain.joint_names(), systems.chain.joint_names()
        if joints != others:
            raise StateError(
                f"systems: expected those of a rollout with the joints {', '.join(joints)}, got {', '.join(others)}"
            )
        if self.chain.floats != systems.chain.floats:
            base = "a floating base" if self.chain.floats else "no floating base"
            raise StateError(f"systems: expected those of a rollout with {base}, as this one's chain has")
        before = systems.copy()
        stale = [] if list(systems.chain.grasps) == list(self.chain.grasps) else ["grasp_R", "grasp_p"]
        stale += ["base_R", "base_p"] if self.base_motion else []
        takes = {name: external.shape for name, external in self.kernel.externals.items() if name not in stale}
        kept = {name: x for name, x in before.call_inputs.items() if takes.get(name) == x.shape[1:]}
        states = {name: before.arrays[name] for name in state_fields(self.chain)}
        found = self.kernel.systems(states, remembered(self.law, before))
        for array, x in ((found[key], before.arrays.get(key)) for key in found):
            if x is not None and x.shape == array.shape:
                array[~before.running] = x[~before.running]
        made = RolloutSystems(self.chain, found, before.t, np.zeros(len(systems)))
        made.keep_inputs(kept | call_inputs(self.kernel, given, len(systems)), self.law, self.inputs)
        made = self._started(made, threads)
        for name in {"work", "resolution"} & made.arrays.keys() & before.arrays.keys():
            made.arrays[name][...] = before.arrays[name]
        apart = made.running & (made.drift[:, 0] > POSITION_TOLERANCE)
        for name in state_fields(self.chain):
            made.arrays[name][apart] = before.arrays[name][apart]
        made.arrays["code"][apart] = GRASP_OPEN
        return made

    def step(
        self,
        systems: RolloutSystems,
        step: Any,
        *,
        steps: int = 1,
        least_margin: float = -np.inf,
        stop_at_limits: bool = False,
        largest_drift: float | None = None,
        threads: int | None = None,
        **given: Any,
    ) -> RolloutSystems:
        """Advance systems in place by a number of steps, and return them.

        A system stops, and keeps its last good state, if the constraint becomes singular, a margin would fall below
        `least_margin`, a joint would exceed a limit, or the step is too long; its `status` gives the reason. When a
        step shows a slip, a limit or a singularity, it is repeated in halves and quarters, which costs a few steps. If
        these do not confirm it, the step is reported as too long. A step that may not follow the motion is repeated in
        halves. If these differ, the system goes on as UNRESOLVED, and is TOO_LONG if it diverges.

        Args:
            systems: systems from `start`.
            step: step h [s], one for all systems or (systems,).
            steps: number of steps.
            least_margin: least accepted margin of every one-sided contact at the end of every step [N]; 0 stops systems
                that slip.
            stop_at_limits: whether a system stops if a joint is beyond a limit of its position, rate or effort at the
                end of a step.
            largest_drift: largest position gap that a step may leave before projection; for systems with a larger gap
                the step is divided into equal parts, as in `simulate` [m or rad]. None: steps are not divided.
            threads: as for `CompiledChain.forward_dynamics`; the results do not depend on it.
            **given: parameters of the law, shared or (systems, ...); object_wrench (6,), gravity,
                object_mass, object_com, object_inertia, base_pose, grasp_pose; and link_wrench,
                link_mass, link_com, link_inertia if they were compiled in, as in `CompiledChain.forward_dynamics`. An
                argument that is not given keeps its last value, from `start` or from a step, or that of the chain.

        Raises:
            StateError: a shape is wrong, a name is unknown, or the step is not positive.
        """
        require_systems(systems)
        steps = whole_number("steps", steps, MOST_STEPS_OF_CALL)
        require_threads(threads)
        least, limit = stop_margins(least_margin, stop_at_limits), drift_limit(largest_drift)
        lengths, new = step_lengths(step, len(systems)), call_inputs(self.kernel, given, len(systems))
        inputs, parameters = kernel_arguments(self.kernel, systems.call_inputs | new)
        self.kernel.require_own(systems.arrays)  # all checks come before the first change
        require_at_samples(self.law, systems, lengths)
        systems.set_step_length(lengths)
        systems.started_from = None
        if systems.keep_inputs(new, self.law, self.inputs):  # the slopes were evaluated with other torques
            inputs |= step_inputs(systems, NO_STOPS)
            self.kernel.run(systems.arrays, inputs, parameters, 1, threads, slopes_only=True)
        return self.advance(systems, steps, least, limit, threads)

    def advance(
        self, systems: RolloutSystems, steps: int, least: StopMargins, limit: float | None, threads: int | None
    ) -> RolloutSystems:
        """Take steps in place, with the step lengths and the arguments stored in the systems; see `step`."""
        going, take = systems.running, partial(self.advance_unconfirmed, threads=threads)
        followed(systems, steps, take, least, limit, scheme_of(self.scheme).order)
        stopped = going & ~systems.running
        if stopped.any():
            systems.arrays["code"][stopped & diverged(systems)] = TOO_LONG
            stopped &= np.isin(systems.arrays["code"], (SLIPPED, LIMITED, PASSES_SINGULAR))
        if stopped.any():
            take = partial(take, steps=1, least=NO_STOPS)
            wrong = contradicted(systems.copy(stopped), systems.freed(stopped), least, take)
            systems.arrays["code"][np.flatnonzero(stopped)[wrong]] = TOO_LONG
        return systems

    def run(
        self,
        systems: RolloutSystems,
        duration: float,
        step: float,
        *,
        every: int = 1,
        record: Sequence[str] = RECORDED,
        least_margin: float = -np.inf,
        stop_at_limits: bool = False,
        largest_drift: float | None = None,
        threads: int | None = None,
        progress: bool | Callable[[float], object] | None = None,
        folder: str | PathLike[str] | None = None,
        overwrite: bool = False,
        **given: Any,
    ) -> RolloutRecord:
        """Advance systems by a duration, and return their recorded arrays.

        With `folder`, records are appended to files there while the rollout runs, at least every 5 seconds, and memory
        does not grow with their number. `holdfast.io.load_record` reads the folder at any time, also after the process
        was killed.

        Args:
            systems: systems from `start`, which are not changed.
            duration: duration, a whole number of steps [s].
            step: step h [s].
            every: number of steps between two records.
            record: names of the arrays to record, which are attributes of `RolloutSystems`.
            least_margin: as for `step`.
            stop_at_limits: as for `step`.
            largest_drift: as for `step`.
            threads: as for `step`.
            progress: as for `simulate`; a function is called with the time that has passed [s].
            folder: the folder to which records are appended; None keeps them in memory.
            overwrite: whether an earlier record in this folder is replaced.
            **given: as for `step`.

        Raises:
            StateError: a shape or name is wrong, the duration is not a whole number of steps, or the systems have
                different times.
            ResultError: the folder is in use or cannot be written.
        """
        require_systems(systems)
        options = step_options(least_margin, stop_at_limits, largest_drift)
        h, duration = float(step_lengths(step, 1)[0]), number("duration", duration)
        arguments = RolloutArguments(self, systems.copy(), h, whole_number("every", every), options, duration)
        return recorded_rollout(arguments, RecordOutput(record, folder, overwrite, progress), given, threads)

    def tape(
        self,
        systems: RolloutSystems,
        step: Any,
        *,
        steps: int,
        every: int | None = None,
        record: Sequence[str] = (),
        schedule: Mapping[str, Any] | None = None,
        least_margin: float = -np.inf,
        stop_at_limits: bool = False,
        threads: int | None = None,
        **given: Any,
    ) -> Tape:
        """Take steps and store them, so that gradients can be propagated back through them; see `Tape.vjp`.

        Args:
            systems: systems from `start`, which are not changed.
            step: step h [s], one for all systems or (systems,).
            steps: number of steps.
            every: number of steps between two stored states; the steps between them are repeated in the backward pass.
                None: 1, or about sqrt(steps) if the states would take more than a GiB.
            record: names of the arrays to record at the end of every step, which are attributes of `RolloutSystems`.
            schedule: parameters of the law that change from step to step, by name, (steps, ...) or (steps, systems,
                ...).
            least_margin: as for `step`.
            stop_at_limits: as for `step`.
            threads: as for `step`.
            **given: as for `step`.

        Raises:
            MethodNotApplicable: the chain has `touching`, since steps with a touch have no derivative.
            StateError: a shape or name is wrong.
        """
        without_contacts(self.chain, "rollout: tape")
        require_systems(systems)
        options = {"least_margin": least_margin, "stop_at_limits": stop_at_limits, "threads": threads}
        return Tape(self, systems, step, steps, every, record, schedule or {}, options, given)

    def _started(self, systems: RolloutSystems, threads: int | None) -> RolloutSystems:
        """Return the systems projected onto the grasps and evaluated there."""
        require_threads(threads)
        given = {name: systems.arrays[name].copy() for name in state_fields(self.chain)}
        if self.generic_rank is None and (rank := self.kind.rank(self, systems)) is not None:
            self.generic_rank = rank
            self.kernels = kernels_of(self)
        close = partial(self.advance_unconfirmed, h=systems.step_length, steps=1, least=NO_STOPS, threads=threads)
        if "held_rows" in self.kernel.carried:
            hold_rows(self, systems, close)
        close(systems)
        for name in ("work", "count"):
            systems.arrays[name][...] = 0.0
        systems.started_from = given
        return systems

    def stiff(self, systems: RolloutSystems) -> Array:
        """Return which systems take linearly implicit steps, because explicit ones would be unstable, (systems,).

        The criterion is that of `simulate`. A step as short as `_stable_step` is stable in every configuration at rest,
        where friction is steepest.
        """
        scheme = scheme_of(self.scheme)
        if scheme.implicit or systems.step_length.max() <= self._stable_step:
            return np.zeros(len(systems), dtype=bool)
        return systems.step_length * passive_rates(systems, partial(located, self)) > USED * scheme.stability_interval

    def advance_unconfirmed(
        self, systems: RolloutSystems, h: Array, steps: int, least: StopMargins, threads: int | None, wait: bool = False
    ) -> None:
        """Take steps, without confirming what stops; with `wait`, not those that may not follow the motion."""
        systems.set_step_length(h)
        take_steps(self, systems, steps, least, threads, wait)
