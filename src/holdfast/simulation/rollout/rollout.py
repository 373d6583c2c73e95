"""`holdfast.compile_rollout`: many systems stepped in machine code, control law included."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.faults import faulty, largest_positions
from holdfast.compiled.parameters import taken
from holdfast.compiler.schedule import External
from holdfast.dynamics.forward import forward_dynamics
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.kernel import StepKernel
from holdfast.simulation.rollout.law import ControlLaw, held_torques
from holdfast.simulation.rollout.rows import STATE
from holdfast.simulation.rollout.stages import BROKEN, SLIPPED
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.spatial.scalar import Array
from holdfast.state import State

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
        ModelError: no such scheme, or one that estimates errors.
        CompileError: the law does what cannot be traced; the line is named.
    """
    if scheme_of(scheme).adaptive:
        raise ModelError(f"rollout: scheme: expected 'rk4' or 'midpoint', got '{scheme}'; it is for `simulate`")
    return Rollout(chain, law or held_torques(chain.joint_count), scheme, generic_rank)


@dataclass(frozen=True, eq=False)
class RolloutRecord:
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
            **given: the law's parameters and the chain's, as for `step`.

        Raises:
            StateError: wrong shapes, or no system at all.
        """
        shapes = {name: self._kernel.carried[name] for name in STATE}
        state = {
            name: arrays.floats(name, x, shapes[name])
            for name, x in zip(STATE, (q, qd, object_pose, object_twist), strict=True)
        }
        count = arrays.batch_of(state, {name: External(shape, "input") for name, shape in shapes.items()}) or 1
        bad = faulty(state, {name: len(s) for name, s in shapes.items()}, largest_positions(self.chain), count)
        remembered = None if memory is None else arrays.floats("memory", memory, (len(self.law.memory),))
        systems = RolloutSystems(self.chain, np.full(count, float(t)), self._kernel.systems(state, remembered, count))
        pose = systems.arrays["object_pose"]
        pose[:, :4] /= np.linalg.norm(pose[:, :4], axis=1, keepdims=True)
        if bad is not None:
            systems.arrays["code"][bad] = BROKEN
        self._know_rank(systems)
        self._run(systems, 0.0, 1, threads, -np.inf, given)
        for name in ("work", "count"):
            systems.arrays[name][...] = 0.0
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
        `least_margin`, or the step is too long, stands still from then on; see `fate`.

        Args:
            systems: what `start` returned.
            step: h [s]; one for all, or (systems,).
            steps: how many.
            least_margin: of every one-sided contact at every step's end [N]; 0 stops slipping systems.
            threads: how many share the systems; no bit depends on it.
            **given: the law's parameters, shared or (systems, ...); object_wrench (6,), gravity,
                object_mass, object_com, object_inertia, base_pose, grasp_pose as in
                `CompiledChain.forward_dynamics`.

        Raises:
            StateError: wrong shapes, unknown names, a step that is not positive.
        """
        h = np.asarray(step, dtype=float)
        if not (np.isfinite(h).all() and (h > 0).all()) or h.shape not in ((), (len(systems),)):
            raise StateError(f"step: expected one positive number of seconds, or one for each system, got {step!r}")
        if not isinstance(steps, int | np.integer) or steps < 1:
            raise StateError(f"steps: expected an integer >= 1, got {steps!r}")
        begin = systems.t
        systems.arrays["count"][...] = 0.0
        self._run(systems, h, int(steps), threads, least_margin, given)
        systems.t = begin + systems.arrays["count"] * h
        return systems

    def run(
        self,
        systems: RolloutSystems,
        duration: float,
        step: float,
        *,
        every: int = 1,
        record: tuple[str, ...] = RECORDED,
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
            StateError: wrong shapes or names, or a duration that is no whole number of steps.
        """
        steps = round(float(duration) / float(step))
        if steps < 1 or abs(steps * step - duration) > 1e-9 * duration:
            raise StateError(f"duration: expected a whole number of steps of {step:g} s, got {duration:g} s")
        if not isinstance(every, int | np.integer) or every < 1:
            raise StateError(f"every: expected an integer >= 1, got {every!r}")
        for name in record:
            if not isinstance(getattr(RolloutSystems, name, None), property):
                known = [n for n, x in vars(RolloutSystems).items() if isinstance(x, property)]
                raise StateError(f"record: no array '{name}'.{checks.did_you_mean(name, known)}")
        at, begin = systems.copy(), systems.t.copy()
        done, times = 0, [0]
        kept = {name: [np.array(getattr(at, name))] for name in record}
        while done < steps:
            some = min(int(every), steps - done)
            self.step(at, step, steps=some, least_margin=least_margin, threads=threads, **given)
            # as one product of whole numbers: times do not drift
            done += some
            at.t = np.where(at.running, begin + done * step, at.t)
            times.append(done)
            for name, rows in kept.items():
                rows.append(np.array(getattr(at, name)))
        stopped = np.where(at.running, np.inf, at.t)
        slipped = at.arrays["code"] == SLIPPED
        if slipped.any():
            stopped[slipped] = self._slip_times(at, slipped, step, least_margin, given)
        t = float(systems.t.min()) + step * np.array(times)
        return RolloutRecord(t, {name: np.array(rows) for name, rows in kept.items()}, at, stopped)

    def _slip_times(
        self, at: RolloutSystems, rows: Array, step: float, least_margin: float, given: Mapping[str, Any]
    ) -> Array:
        """Return when systems slip, by halving the step that would go too far."""
        begin = at.copy(rows)
        begin.arrays["code"][...] = 0.0
        own = {name: x[rows] if self._by_system(name, x, len(at)) else x for name, x in given.items()}
        low, high = np.zeros(len(begin)), np.full(len(begin), float(step))
        for _ in range(HALVINGS):
            middle, trial = 0.5 * (low + high), begin.copy()
            self.step(trial, middle, least_margin=least_margin, **own)
            low, high = np.where(trial.running, middle, low), np.where(trial.running, high, middle)
        return begin.t + low

    def _by_system(self, name: str, value: Any, count: int) -> bool:
        """Return whether a given array has a row for each system."""
        shapes = {n: e.shape for n, e in self._kernel.externals.items()} | dict(self.law.parameters)
        rank = {"base_pose": 2, "grasp_pose": 2}.get(name, len(shapes.get(name, ())))
        return np.ndim(value) > rank and len(value) == count

    def _run(
        self,
        systems: RolloutSystems,
        step: Any,
        steps: int,
        threads: int,
        least_margin: float,
        given: Mapping[str, Any],
    ) -> None:
        if not isinstance(threads, int) or threads < 1:
            raise StateError(f"threads: expected an integer >= 1, got {threads!r}")
        inputs: dict[str, Array] = {
            "begin": systems.t,
            "step": np.asarray(step, dtype=float),
            "held": np.array(0.0),
            "least_margin": np.array(float(least_margin)),
            "object_wrench": np.zeros(6),
        }
        rest = dict(given)
        for name, shape in self.law.parameters.items():
            if name not in rest:
                raise StateError(f"the control law's parameter '{name}' is missing: expected shape {tuple(shape)}")
            inputs[f"control.{name}"] = self._fitting(name, rest.pop(name), tuple(shape), len(systems))
        changed = taken(rest, self._kernel.externals) if rest else {}
        for name, x in changed.items():
            self._fitting(name, x, self._kernel.externals[name].shape, len(systems))
        if "object_wrench" in changed:
            inputs["object_wrench"] = changed.pop("object_wrench")
        self._kernel.run(systems.arrays, inputs, changed, steps, threads)

    def _fitting(self, name: str, value: Any, shape: tuple[int, ...], count: int) -> Array:
        x = arrays.floats(name, value, shape)
        if x.ndim > len(shape) and len(x) != count:
            raise StateError(f"{name}: expected shape {shape} or ({count}, *{shape}), got {x.shape}")
        return x

    def _know_rank(self, systems: RolloutSystems) -> None:
        """Find the generic rank near the first sound system."""
        if self.generic_rank is not None or not systems.running.any():
            return
        row = int(np.flatnonzero(systems.running)[0])
        state = State(*(systems.arrays[name][row] for name in STATE))
        tau = np.zeros(self.chain.joint_count)
        self.generic_rank = forward_dynamics(self.chain, state, tau, check=False).rank
        self._kernel.parameters["generic_rank"] = np.array(float(self.generic_rank))
