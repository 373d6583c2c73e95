"""`holdfast.compile_rollout`: many systems stepped in machine code, control law included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.faults import faulty, largest_positions
from holdfast.compiled.verdict import generic_rank, system
from holdfast.compiler.schedule import External
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.advance import BROKEN, SINGULAR, SLIPPED, TOO_LONG
from holdfast.simulation.rollout.arguments import acting, fitting, number, paces, require_free_names, told, whole_steps
from holdfast.simulation.rollout.confirmation import contradicted
from holdfast.simulation.rollout.kernel import StepKernel
from holdfast.simulation.rollout.law import ControlLaw, held_torques
from holdfast.simulation.rollout.rows import STATE
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.traced_law import travelling
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

HALVINGS = 50  # of a step, when the instant of a slip is sought
RECORDED = ("q", "qd", "object_pose", "object_twist", "grasp_wrench")


def compile_rollout(
    chain: ClosedChain, law: ControlLaw | None = None, *, scheme: str = "rk4", generic_rank: int | None = None
) -> Rollout:
    """Compile steps of a chain under a control law to machine code of this computer.

    A step is the scheme's stages, two Newton rounds back onto the grasps in position, then in
    velocity, in the kinetic metric; bases stand still.

    Args:
        chain: arms, object and grasps.
        law: torques; without one they are given to every call as `tau`, and held for each step.
        scheme: `rk4`, or `midpoint`: half the evaluations, second order.
        generic_rank: rank of the grasp constraint away from singular configurations; found from the
            first systems if not given.

    Raises:
        ModelError: no such scheme, or one that estimates errors; a parameter of the law has a taken name.
        CompileError: (when first started) the law does what cannot be traced; the line is named.
    """
    if scheme_of(scheme).adaptive:
        raise ModelError(f"rollout: scheme: expected 'rk4' or 'midpoint', got '{scheme}'; it is for `simulate`")
    if not isinstance(law, ControlLaw | None):
        raise ModelError(
            f"rollout: law: expected a ControlLaw or None, got {type(law).__name__}; try ControlLaw(function)"
        )
    if not isinstance(chain, ClosedChain):
        raise ModelError(f"rollout: chain: expected a ClosedChain, got {type(chain).__name__}")
    if law is not None:
        require_free_names(law.parameters)
    return Rollout(chain, law or held_torques(chain.joint_count), scheme, generic_rank)


@dataclass(frozen=True, eq=False)
class RolloutRecord(Frozen):
    """Systems at the recorded times; the first axis of every array is the time, the second the system.

    Attributes:
        t: (records,) [s].
        arrays: what was asked for, by name, (records, systems, ...); of a system that stands still,
            its last good state.
        systems: at the end.
        stopped: (systems,) when each stopped [s], infinite if it did not; the instant of a slip
            is refined within its step.
    """

    t: Array
    arrays: Mapping[str, Array]
    systems: RolloutSystems
    stopped: Array

    def __getitem__(self, name: str) -> Array:
        """Return a recorded array."""
        if name not in self.arrays:
            raise KeyError(f"'{name}' was not recorded.{checks.did_you_mean(name, self.arrays)}")
        return self.arrays[name]


class Rollout:
    """Steps of many systems as machine code; made by `compile_rollout`.

    Attributes:
        chain: the chain.
        law: the control law.
        scheme: the Runge-Kutta scheme's name.
        generic_rank: rank of the grasp constraint in general, or None while it is not known.
    """

    def __init__(self, chain: ClosedChain, law: ControlLaw, scheme: str, generic_rank: int | None) -> None:
        self.chain, self.law, self.scheme, self.generic_rank = chain, law, scheme, generic_rank
        self._kernel = StepKernel(chain, law, scheme_of(scheme), -1 if generic_rank is None else generic_rank)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes the rollout again: machine code is compiled, or found on disk."""
        return Rollout, (self.chain, travelling(self.law, self.chain), self.scheme, self.generic_rank)

    def start(
        self,
        q: Any,
        qd: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        memory: Any = None,
        t: float = 0.0,
        threads: int = 1,
        **given: Any,
    ) -> RolloutSystems:
        """Return systems at given states, brought onto the grasps (they must nearly hold).

        Args:
            q: (systems, n), or (n,) shared by all; as the other states [rad or m].
            qd: joint rates.
            object_pose: (7,) wxyz_xyz.
            object_twist: (6,) [omega; v of C], world axes.
            memory: (m,) of the law; by default as it says.
            t: the time they are at [s].
            threads: how many share the systems.
            **given: the law's parameters and the chain's, as for `step`; the systems keep them.

        Raises:
            StateError: wrong shapes, or no system at all.
        """
        systems = self._given(q, qd, object_pose, object_twist, memory, number("t", t))
        said = told(self._kernel, given, len(systems))
        inputs, parameters = acting(self._kernel, said)
        first = systems.copy()
        self._run(systems, inputs, parameters, 1, threads, -np.inf)
        if self.generic_rank is None and self._know_rank(systems, parameters):
            systems = first
            self._run(systems, inputs, parameters, 1, threads, -np.inf)
        for name in ("work", "count"):
            systems.arrays[name][...] = 0.0
        systems.tell(said, self.law)
        return systems

    def step(
        self,
        systems: RolloutSystems,
        step: Any,
        *,
        steps: int = 1,
        least_margin: float = -np.inf,
        threads: int = 1,
        **given: Any,
    ) -> RolloutSystems:
        """Advance systems in place by a number of steps, and return them.

        A system that cannot, because the constraint is singular, a margin would fall below
        `least_margin`, or the step is too long, stands still from then on; see `fate`. A slip or a singularity
        that the step does not show in halves and quarters, at the cost of a few steps, is a step too long.

        Args:
            systems: what `start` returned.
            step: h [s]; one for all, or (systems,).
            steps: how many.
            least_margin: of every one-sided contact at every step's end [N]; 0 stops slipping systems.
            threads: how many share the systems; no bit depends on it.
            **given: the law's parameters, shared or (systems, ...); object_wrench (6,), gravity,
                object_mass, object_com, object_inertia, base_pose, grasp_pose as in
                `CompiledChain.forward_dynamics`. What is not given stays as the systems were told last,
                in `start` or in a step; before that it is the chain's.

        Raises:
            StateError: wrong shapes, unknown names, a step that is not positive.
        """
        if not isinstance(steps, int | np.integer) or steps < 1:
            raise StateError(f"steps: expected an integer >= 1, got {steps!r}")
        going = systems.running
        self._advance(systems, paces(step, len(systems)), int(steps), least_margin, threads, given)
        stopped = going & np.isin(systems.arrays["code"], (SLIPPED, SINGULAR))
        if stopped.any():
            wrong = contradicted(
                systems.copy(stopped),
                _free(systems, stopped),
                least_margin,
                lambda some, h: self._advance(some, h, 1, -np.inf),
            )
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
        threads: int = 1,
        **given: Any,
    ) -> RolloutRecord:
        """Advance systems by a duration and return them at every so many steps.

        Args:
            systems: what `start` returned; left as they are.
            duration: a whole number of steps [s].
            step: h [s].
            every: steps from one record to the next.
            record: names of the arrays to record: attributes of `RolloutSystems`.
            least_margin: as for `step`.
            threads: as for `step`.
            **given: as for `step`.

        Raises:
            StateError: wrong shapes or names, a duration that is no whole number of steps, or systems
                that are not all at one time.
        """
        step = float(paces(step, 1)[0])
        steps = whole_steps(number("duration", duration), step)
        if not isinstance(every, int | np.integer) or every < 1:
            raise StateError(f"every: expected an integer >= 1, got {every!r}")
        for name in record:
            if not isinstance(getattr(RolloutSystems, name, None), property):
                known = [n for n, x in vars(RolloutSystems).items() if isinstance(x, property)]
                raise StateError(f"record: no array '{name}'.{checks.did_you_mean(name, known)}")
        at, begin = systems.copy(), _common_time(systems)
        done = np.minimum(np.arange(0, steps + int(every), int(every)), steps)
        kept = {name: [np.array(getattr(at, name))] for name in record}
        for some_steps in np.diff(done):
            self.step(at, step, steps=some_steps, least_margin=least_margin, threads=threads, **given)
            for name, rows in kept.items():
                rows.append(np.array(getattr(at, name)))
        stopped = np.where(at.running, np.inf, at.t)
        slipped = systems.running & (at.arrays["code"] == SLIPPED)
        if slipped.any():
            stopped[slipped] = self._slip_times(at, slipped, step, least_margin)
        return RolloutRecord(begin + done * step, {name: np.array(rows) for name, rows in kept.items()}, at, stopped)

    def _given(self, q: Any, qd: Any, object_pose: Any, object_twist: Any, memory: Any, t: float) -> RolloutSystems:
        """Return systems at users' states as they are, faulty ones marked as such."""
        shapes = {name: self._kernel.carried[name] for name in STATE}
        state = {
            name: arrays.floats(name, x, shapes[name])
            for name, x in zip(STATE, (q, qd, object_pose, object_twist), strict=True)
        }
        count = arrays.batch_of(state, {name: External(shape, "input") for name, shape in shapes.items()})
        if count == 0:
            raise StateError("rollout: expected at least one system, got arrays without rows")
        count = count or 1
        bad = faulty(state, {name: len(s) for name, s in shapes.items()}, largest_positions(self.chain), count)
        remembered = None if memory is None else fitting("memory", memory, (len(self.law.memory),), count)
        found = self._kernel.systems(state, remembered, count)
        bad = np.zeros(count, dtype=bool) if bad is None else bad
        pose = found["object_pose"]
        pose[~bad, :4] /= np.linalg.norm(pose[~bad, :4], axis=1, keepdims=True)
        found["code"][bad] = BROKEN
        return RolloutSystems(self.chain, found, np.full(count, t), np.zeros(count))

    def _slip_times(self, at: RolloutSystems, rows: Array, step: float, least_margin: float) -> Array:
        """Return when systems slip, by halving the step that would go too far."""
        begin = _free(at, rows)
        low, high = np.zeros(len(begin)), np.full(len(begin), step)
        for _ in range(HALVINGS):
            middle, trial = 0.5 * (low + high), begin.copy()
            self._advance(trial, middle, 1, least_margin)
            low, high = np.where(trial.running, middle, low), np.where(trial.running, high, middle)
        return begin.t + low

    def _advance(
        self,
        systems: RolloutSystems,
        step: Array,
        steps: int,
        least_margin: float,
        threads: int = 1,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Take steps in place, and believe what they show."""
        said = told(self._kernel, given or {}, len(systems))
        inputs, parameters = acting(self._kernel, systems.told | said)
        self._run(systems, inputs, parameters, steps, threads, least_margin, step, said)

    def _run(
        self,
        systems: RolloutSystems,
        inputs: Mapping[str, Array],
        parameters: Mapping[str, Array],
        steps: int,
        threads: int,
        least_margin: float,
        pace: Array | None = None,
        said: Mapping[str, Array] | None = None,
    ) -> None:
        """Take steps of the pace, or one of length zero; whatever is refused is refused before anything is changed."""
        if not isinstance(threads, int | np.integer) or threads < 1:
            raise StateError(f"threads: expected an integer >= 1, got {threads!r}")
        least = np.array(number("least_margin", least_margin, infinite=True))
        self._kernel.require_own(systems.arrays)
        changed = False
        if pace is not None:
            systems.at_pace(pace)
            changed = systems.tell(said or {}, self.law)
        own = {"begin": systems.begin, "step": systems.pace, "held": np.array(0.0), "least_margin": least}
        if changed:  # where the step begins to lead was found under other torques
            self._kernel.renew(systems.arrays, {**inputs, **own}, parameters, int(threads))
        self._kernel.run(systems.arrays, {**inputs, **own}, parameters, steps, int(threads))

    def _know_rank(self, systems: RolloutSystems, parameters: Mapping[str, Array]) -> bool:
        """Find the generic rank, near a system whose rank is low if all are; return whether one's is lower."""
        if not systems.running.any():
            return False
        found = np.where(systems.running, systems.arrays["rank"], -1.0)
        row, most = int(np.argmax(found)), int(found.max())
        if most < self.chain.constraint_row_count:
            at = {name: systems.arrays[name] for name in STATE} | self._kernel.parameters | dict(parameters)
            most = generic_rank(*system(self.chain, at, row), most)
        self.generic_rank = most
        self._kernel.parameters["generic_rank"] = np.array(float(most))
        return bool((found[systems.running] < most).any())


def _free(systems: RolloutSystems, rows: Array) -> RolloutSystems:
    """Return copies of some systems that go on from where they stand."""
    found = systems.copy(rows)
    found.arrays["code"][...] = 0.0
    return found


def _common_time(systems: RolloutSystems) -> float:
    """Return the time at which all systems are that go on."""
    times = np.unique(systems.t[systems.running]) if systems.running.any() else systems.t.max(keepdims=True)
    if times[-1] - times[0] > 1e-9 * max(1.0, abs(times[0])):
        raise StateError(
            f"systems: expected all at one time, got {times[0]:g} s to {times[-1]:g} s; a record has one time axis; try"
            " `step`"
        )
    return float(times[0])
