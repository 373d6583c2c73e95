"""Steps of a rollout as a JAX function with gradients."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.compiled.derivative_schedule import FOUND, WITH
from holdfast.errors import SingularChainError, StateError
from holdfast.interop.jax_arguments import checked, require_jax, require_names
from holdfast.interop.jax_call import JaxRoute, batched, callback
from holdfast.interop.jax_pose import pose_cotangent, pose_gradient
from holdfast.model.serial_chain import serial_chain
from holdfast.questions.arrays import POSES, results_of, shapes, state_fields
from holdfast.simulation.rollout.adjoint import BEFORE, adjoint_shapes
from holdfast.simulation.rollout.arguments import step_lengths, whole_number
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.tape import LAW_MEMORY, STEP_LENGTH, Tape, arguments_of
from holdfast.simulation.rollout.varied_step import LAW_PREFIX
from holdfast.spatial.scalar import Array

# A function of arrays of systems, (systems, ...) each, that returns such arrays.
HostRows = Callable[[Mapping[str, Array]], tuple[Array, ...]]
STILL_RUNNING = "running"  # arrays of systems that have values at the end of every step


class JaxRollout:
    """Steps of a rollout as a JAX function; created by `to_jax`.

    Attributes:
        rollout: the rollout that takes the steps.
        of: names of the results, which are (steps, ...) arrays of values at the end of every step.
        steps: number of steps.
        step: step h [s].
        route: "callback", because the steps are called through Python.
    """

    route: JaxRoute = "callback"

    def __init__(
        self,
        rollout: Rollout,
        of: Sequence[str] | None,
        parameters: Sequence[str],
        step: Any,
        steps: Any,
        schedule: Sequence[str],
    ) -> None:
        serial_chain(rollout.chain, "to_jax: rollout: chain")
        state, law, chain = tuple(state_fields(rollout.chain)), rollout.law.parameters, rollout.chain
        memory = (LAW_MEMORY,) if len(rollout.law.memory) else ()
        known = (*state, *memory, "tau", *results_of(chain))
        recorded = [name for name in known if isinstance(getattr(RolloutSystems, name, None), property)]
        self.rollout, self.of = rollout, require_names("of", state if of is None else of, recorded)
        self.steps, self.step = whole_number("to_jax: steps", steps), float(step_lengths(step, 1)[0])
        chosen = [name for name in arguments_of(rollout) if name not in (*state, *law, STEP_LENGTH)]
        self._scheduled = require_names("schedule", schedule, tuple(law))
        self._names = (*state, *law, *require_names("parameters", parameters, chosen))
        code = {name: f"{LAW_PREFIX}{name}" if name in law else name for name in self._names}
        code |= {LAW_MEMORY: BEFORE} if LAW_MEMORY in code else {}
        found = adjoint_shapes(rollout.kernel, tuple(code.values()), ())
        by = {name: found[f"{FOUND}{key}"] for name, key in code.items()}
        by |= {name: (self.steps, *by[name]) for name in self._scheduled}
        sizes = shapes(chain) | {LAW_MEMORY: (len(rollout.law.memory),)}
        results = {name: (self.steps, *sizes[name]) for name in self.of}
        cotangents = {f"{WITH}{name}": (*x[:-1], 6) if name in POSES else x for name, x in results.items()}
        self._shapes = {name: (*x[:-1], 7) if name in POSES else x for name, x in by.items()}
        self._forward = self._operation(self._roll, self._shapes, results)
        self._backward = self._operation(self._pull, self._shapes | cotangents, by)
        self._function = self._with_vjp()

    def __call__(self, q: Any, qd: Any, object_pose: Any, object_twist: Any, **parameters: Any) -> dict[str, Any]:
        """Return the results by name, (steps, ...) each.

        Args:
            q: (n,) initial joint positions [rad or m]; they must nearly satisfy the grasps.
            qd: joint rates.
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            **parameters: all parameters of the law, those named in `to_jax`, and floating_pose and floating_twist of a
                floating base.

        Raises:
            StateError: a parameter is missing or unknown, a shape is wrong, or numbers are not real.
        """
        state = {"q": q, "qd": qd, "object_pose": object_pose, "object_twist": object_twist}
        return self._function(*checked(state | parameters, self._shapes, len(state)))

    def _with_vjp(self) -> Any:
        function = require_jax().custom_vjp(self._values)

        def forward(*values: Any) -> tuple[dict[str, Any], tuple[Any, Any]]:
            found = self._values(*values)
            return found, (values, found)

        def backward(kept: tuple[Any, Any], cotangents: Mapping[str, Any]) -> tuple[Any, ...]:
            values, found = kept
            given = [pose_cotangent(found[n], cotangents[n]) if n in POSES else cotangents[n] for n in self.of]
            gradients = zip(self._names, values, self._backward(*values, *given), strict=True)
            return tuple(pose_gradient(x, found) if name in POSES else found for name, x, found in gradients)

        function.defvjp(forward, backward)
        return function

    def _values(self, *values: Any) -> dict[str, Any]:
        return dict(zip(self.of, self._forward(*values), strict=True))

    def _operation(
        self, host: HostRows, given: Mapping[str, tuple[int, ...]], found: Mapping[str, tuple[int, ...]]
    ) -> Callable[..., tuple[Any, ...]]:
        """Return a host function as a JAX operation, whose vmap is one call for a batch."""

        def run(batch: int | None, values: Sequence[Array]) -> tuple[Array, ...]:
            count = 1 if batch is None else batch
            rows = {
                name: np.broadcast_to(x if batch is not None and x.ndim > len(shape) else x[None], (count, *shape))
                for (name, shape), x in zip(given.items(), values, strict=True)
            }
            result = _each_for_itself(host, rows, [*found.values()])
            return tuple(x[0] for x in result) if batch is None else result

        return batched(callback(run, [*found.values()]), [len(shape) for shape in given.values()])

    def _tape(self, given: Mapping[str, Array]) -> Tape:
        """Return the tape of the steps; the first axis of the arguments is the system."""
        schedule = {name: np.moveaxis(given[name], 0, 1) for name in self._scheduled}
        first: dict[str, Any] = {name: schedule[name][0] if name in schedule else given[name] for name in self._names}
        systems, record = self.rollout.start(**first), (*self.of, STILL_RUNNING)
        return self.rollout.tape(systems, self.step, steps=self.steps, record=record, schedule=schedule)

    def _roll(self, given: Mapping[str, Array]) -> tuple[Array, ...]:
        """Return the results, (systems, steps, ...); NaN after a system has stopped."""
        records = self._tape(given).records
        for name in self.of:
            records[name][~records[STILL_RUNNING]] = np.nan
        return tuple(np.moveaxis(records[name], 0, 1) for name in self.of)

    def _pull(self, given: Mapping[str, Array]) -> tuple[Array, ...]:
        """Return gradients, (systems, ...); NaN for systems with cotangents of steps that were not taken."""
        tape = self._tape(given)
        along, idle = {}, ~tape.records[STILL_RUNNING]
        lost = np.zeros(idle.shape[1], dtype=bool)
        for name in self.of:
            cotangent = np.array(np.moveaxis(given[f"{WITH}{name}"], 1, 0))
            lost |= (idle & (cotangent != 0).reshape(*idle.shape, -1).any(axis=2)).any(axis=0)
            cotangent[idle] = 0.0
            along[name] = cotangent
        found = tape.vjp(along=along, by=self._names)
        rows = {name: np.array(found[name]) for name in self._names}
        rows |= {name: np.moveaxis(rows[name], 0, 1) for name in self._scheduled}
        for x in rows.values():
            x[lost] = np.nan
        return tuple(rows.values())


def _each_for_itself(host: HostRows, rows: Mapping[str, Array], found: Sequence[tuple[int, ...]]) -> tuple[Array, ...]:
    """Return the results of the host function; NaN for the systems that it refuses, which are found by bisection."""
    count = len(next(iter(rows.values())))
    try:
        return host(rows)
    except (StateError, SingularChainError):
        if count == 1:
            return tuple(np.full((1, *shape), np.nan) for shape in found)
    parts = [{name: x[half] for name, x in rows.items()} for half in (slice(count // 2), slice(count // 2, None))]
    halves = [_each_for_itself(host, part, found) for part in parts]
    return tuple(np.concatenate(x) for x in zip(*halves, strict=True))
