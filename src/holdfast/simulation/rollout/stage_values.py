"""Whole steps in machine code with given values at the stages: the torques and external wrenches of Python functions.

The functions are called once a stage. Each answer is put into the table of values, and the step is run again from its
start, up to the next stage. Running a whole step costs less than the call of a Python function.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.compiled.parameters import WRENCHES
from holdfast.compiled.structure import Options
from holdfast.compiler.program import Shape
from holdfast.control.controller import ControlLaw
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import ARRAYS, shapes, state_fields
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.traced_step import StepModel, TracedSystem, step_of
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.state import Inputs, State

VALUES = "values"  # parameter of the law: torques, if no law computes them, then wrenches, if they are not constant
ASKED = "asked"  # array of the states at which the functions are to be called, (stages, size)


class GivenTorques:
    """The torques of a law without a function: those given at the step's end."""

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and no memory."""
        return given[VALUES][-1][: len(state.q)], memory


def with_stage_values(
    law: ControlLaw | None, chain: ClosedChain, stages: int, taken: Mapping[str, Shape]
) -> ControlLaw:
    """Return a law for steps with given values, at the stages after the first and at the step's end.

    Args:
        law: a law that computes the torques; None if they are among the values.
        chain: the chain.
        stages: number of stages of a step.
        taken: shapes of the external wrenches among the values, by name.
    """
    size = sum(int(np.prod(shape)) for shape in taken.values())
    if law is None:
        law, size = ControlLaw(GivenTorques(), key="given torques"), chain.joint_count + size
    return replace(law, parameters={**law.parameters, VALUES: (stages, size)})


def acting_on(chain: ClosedChain, options: Options) -> dict[str, Shape]:
    """Return the shapes of the external wrenches that machine code takes, by name."""
    rows = [ARRAYS[name] for name in ("object_wrench", *(WRENCHES if options.link_wrenches else ()))]
    return {row.name: row.shape(chain) for row in rows if row.exists(chain)}


def wrench_arrays(taken: Mapping[str, Shape], acting: Inputs) -> dict[str, Array]:
    """Return external wrenches by name, those in `taken`; zero where none is given."""
    given = {name: getattr(acting, ARRAYS[name].field) for name in taken}
    return {name: np.zeros(taken[name]) if x is None else x for name, x in given.items()}


def asked_shape(chain: ClosedChain, stages: int) -> tuple[int, int]:
    """Return the shape of the states at which the functions are called in a step."""
    return stages, sum(int(np.prod(shapes(chain)[name])) for name in state_fields(chain))


def asked_states(chain: ClosedChain, asked: Array) -> dict[str, Array]:
    """Return views of the states (..., size) at which the functions are called, by name."""
    known = shapes(chain)
    return _split({name: known[name] for name in state_fields(chain)}, asked)


def _split(parts: Mapping[str, Shape], flat: Array) -> dict[str, Array]:
    """Return views of the arrays that follow each other along the last axis, by name."""
    found, begin = {}, 0
    for name, shape in parts.items():
        end = begin + int(np.prod(shape))
        found[name] = flat[..., begin:end].reshape(*flat.shape[:-1], *shape)
        begin = end
    return found


class SystemWithStageValues(TracedSystem):
    """One system during the tracing of a step with given values at its stages."""

    def __init__(self, model: StepModel, given: Mapping[str, Any], environment: Environment | None = None) -> None:
        super().__init__(model, given, environment)
        self.asked: list[State] = []
        self._taken = acting_on(self.real, model.structure.options)
        self._torques = self.real.joint_count if isinstance(model.law.torque, GivenTorques) else 0

    def torques(self, law: ControlLaw, t: Scalar, state: State, memory: Array) -> tuple[Array, Array]:
        """Return the torques of the next stage, and the memory."""
        self.asked.append(state)
        return (self._row[: self._torques], memory) if self._torques else super().torques(law, t, state, memory)

    def surroundings(self, t: Scalar, state: State) -> tuple[ClosedChain, Inputs]:
        """Return the chain and its inputs with the wrenches of the stage whose torques were asked for last."""
        chain, inputs = super().surroundings(t, state)
        wrenches = self._row[self._torques :]
        if not len(wrenches):
            return chain, inputs
        parts = _split(self._taken, wrenches)
        return chain, replace(inputs, **{ARRAYS[name].field: x for name, x in parts.items()})

    @property
    def _row(self) -> Array:
        return self.given[f"control.{VALUES}"][len(self.asked) - 1]

    def step(self, tableau: Tableau) -> dict[str, Any]:
        """Return the carried arrays after a step, and the states at which the functions are to be called."""
        found, fields = step_of(self, tableau), state_fields(self.real).values()
        asked = [concatenate([getattr(state, field) for field in fields]) for state in self.asked]
        return {**found, f"last.{ASKED}": array(asked)}


def step(model: StepModel, tableau: Tableau, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the carried arrays after a step, and the states at which the functions are to be called."""
    return SystemWithStageValues(model, given).step(tableau)
