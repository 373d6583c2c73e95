"""Whole steps in machine code whose torques at the stages are given: those of a controller that is a Python function.

The controller is asked once a stage. Each answer is put into the table of torques, and the step is run again from its
start, up to the next stage. Running a whole step costs less than the call of a Python function.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.control.controller import ControlLaw
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import shapes, state_fields
from holdfast.simulation.rollout.traced_step import StepModel, TracedSystem, step_of
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.state import State

GIVEN_TORQUES = "tau"  # parameter of the law
ASKED = "asked"  # array of the states at which the controller is to be asked, (stages, size)


def stage_torques(chain: ClosedChain, stages: int) -> ControlLaw:
    """Return a law without a function: its torques at the stages after the first, and at the step's end, are given."""

    def torque(t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        return given[GIVEN_TORQUES][-1], memory

    return ControlLaw(torque, parameters={GIVEN_TORQUES: (stages, chain.joint_count)}, key="stage torques")


def asked_shape(chain: ClosedChain, stages: int) -> tuple[int, int]:
    """Return the shape of the states at which the controller is asked in a step."""
    return stages, sum(int(np.prod(shapes(chain)[name])) for name in state_fields(chain))


def asked_states(chain: ClosedChain, asked: Array) -> dict[str, Array]:
    """Return views of the states (..., size) at which the controller is asked, by name."""
    found, begin = {}, 0
    for name in state_fields(chain):
        shape = shapes(chain)[name]
        end = begin + int(np.prod(shape))
        found[name] = asked[..., begin:end].reshape(*asked.shape[:-1], *shape)
        begin = end
    return found


class SystemWithStageTorques(TracedSystem):
    """One system during the tracing of a step with given torques at its stages."""

    def __init__(self, model: StepModel, given: Mapping[str, Any]) -> None:
        super().__init__(model, given)
        self.asked: list[State] = []

    def torques(self, law: ControlLaw, t: Scalar, state: State, memory: Array) -> tuple[Array, Array]:
        """Return the torques of the next stage, and no memory."""
        self.asked.append(state)
        return self.given[f"control.{GIVEN_TORQUES}"][len(self.asked) - 1], memory


def step(model: StepModel, tableau: Tableau, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the carried arrays after a step, and the states at which the controller is to be asked."""
    system = SystemWithStageTorques(model, given)
    found = step_of(system, tableau)
    fields = state_fields(system.real).values()
    found[f"last.{ASKED}"] = array([concatenate([getattr(state, field) for field in fields]) for state in system.asked])
    return found
