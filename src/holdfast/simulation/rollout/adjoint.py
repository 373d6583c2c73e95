"""The adjoint of a step in machine code, which maps cotangents at its end to gradients at its start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.compiled.derivative_schedule import FOUND, WITH
from holdfast.compiled.kernels import batch_kernel
from holdfast.compiled.traced_chain import Given
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External
from holdfast.questions.arrays import CONTACTS, shapes, state_fields
from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.rollout.kernel import StepKernel
from holdfast.simulation.rollout.varied_step import LAW_PREFIX, MARGIN_RESULT, WORK_RESULT, VariedStep
from holdfast.simulation.runge_kutta import EULER, Tableau
from holdfast.spatial.scalar import Array

UNUSED = ("held", "least_margin", "least_joint_margin", "search", "keep_rows", "notice", CONTACTS, "limits")
BEFORE = "before"  # the law's memory at the start of a step


class AdjointKernel:
    """The adjoint of a step of one chain with one control law.

    Attributes:
        by: the arguments of which gradients are returned, with the names of `VariedStep.linear`.
        of: results at the step's end that have cotangents, besides the state and the memory.
        externals: input and output arrays of the machine code.
    """

    def __init__(self, step: StepKernel, tableau: Tableau | None, by: Sequence[str], of: Sequence[str]) -> None:
        """Store what is differentiated; the machine code is compiled at the first run.

        Args:
            step: the step.
            tableau: scheme of the step; None for the projection onto the grasps in `Rollout.start`.
            by: the arguments of which gradients are returned.
            of: results that have cotangents.
        """
        self.by, self.of, self._step = tuple(by), tuple(of), step
        self._shapes = adjoint_shapes(step, self.by, self.of)
        if tableau is None:  # the projection does not depend on the law
            del self._shapes[f"{WITH}{BEFORE}"]
        own = step.externals
        unused = [name for name in UNUSED if name != CONTACTS or MARGIN_RESULT not in self.of]
        plain = {name: e for name, e in own.items() if e.role != "carried" and name not in unused}
        states = [f"last.{name}" for name in (*state_fields(step.chain), "before", "count")]
        states += ["last.held_rows"] if "held_rows" in step.carried else []
        found = {name: e for name, e in plain.items() if e.role == "input"}
        found |= {name: External(own[name].shape, "input") for name in states if name in own}
        found |= {name: External(shape, "input") for name, shape in self._shapes.items() if name.startswith(WITH)}
        found |= {name: e for name, e in plain.items() if e.role == "parameter"}
        found |= {name: External(shape, "output") for name, shape in self._shapes.items() if name.startswith(FOUND)}
        self.externals = {name: e for name, e in found.items() if math.prod(e.shape)}
        scheme = "closing" if tableau is None else tableau.name
        model = VariedStep(step.model, tableau or EULER, kind=step.code.varied)
        what = f"adjoint/{scheme}/{','.join(self.by)};{','.join(self.of)}"
        self._code = batch_kernel(
            step.computation(what, self.externals, self._gradients(model, tableau)), what="gradients of steps"
        )

    @classmethod
    def of_step(cls, step: StepKernel, tableau: Tableau | None, by: Sequence[str], of: Sequence[str]) -> AdjointKernel:
        """Return the adjoint of a step, which is created at the first call and then reused."""
        key = None if tableau is None else tableau.name, tuple(by), tuple(of)
        if key not in step.adjoints:
            step.adjoints[key] = cls(step, tableau, by, of)
        return step.adjoints[key]

    def _gradients(self, model: VariedStep, tableau: Tableau | None) -> Any:
        def gradients(given: Given) -> dict[str, Array]:
            empty = {name: np.zeros(e.shape) for name, e in self._step.externals.items() if not math.prod(e.shape)}
            whole = {"last.before": np.zeros(0)} | empty | dict(given)
            linear = model.closing(whole, self.by) if tableau is None else model.linear(whole, self.by, self.of)
            cotangents = {name.removeprefix(WITH): x for name, x in given.items() if name.startswith(WITH)}
            return {f"{FOUND}{name}": x for name, x in linear.gradient(cotangents).items() if x.size}

        return gradients

    def run(
        self, given: Mapping[str, Array], cotangents: Mapping[str, Array], count: int, threads: int | None = None
    ) -> dict[str, Array]:
        """Return the gradients, (count, *shape) each.

        Args:
            given: inputs and parameters, (*shape) for all systems or (count, *shape).
            cotangents: cotangents by name, (count, *shape) each.
            count: number of systems.
            threads: as for `Rollout.step`.
        """
        found = {name: np.empty((count, *self._shapes[f"{FOUND}{name}"])) for name in self.by}
        every = {**self._step.parameters, **given}
        every |= {f"{WITH}{name}": x for name, x in cotangents.items()}
        every |= {f"{FOUND}{name}": x for name, x in found.items()}
        arrays = {name: np.asarray(every[name], dtype=float, order="C") for name in self.externals}
        self._code.run_arrays(arrays, count, threads)
        return found


def adjoint_shapes(step: StepKernel, by: Sequence[str], of: Sequence[str]) -> dict[str, Shape]:
    """Return the shapes of cotangents and gradients, with the names of the machine code; poses have shape (6,)."""
    known = shapes(step.chain) | step.code.varied.shapes(step.chain)
    known |= dict.fromkeys((BEFORE, "memory"), (len(step.law.memory),))
    known |= {"step": (), MARGIN_RESULT: step.carried.get("margin", (0,)), WORK_RESULT: (len(WORK_TERMS),)}
    known |= {f"{LAW_PREFIX}{name}": tuple(shape) for name, shape in step.law.parameters.items()}
    states = (*state_fields(step.chain), BEFORE)
    return {f"{WITH}{name}": known[name] for name in (*states, *of)} | {f"{FOUND}{name}": known[name] for name in by}
