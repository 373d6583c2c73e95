"""What machine code finds out about systems between their steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.compiled.traced_chain import Given
from holdfast.dynamics.closed.chain_motion import chain_at_rest, chain_motion
from holdfast.dynamics.constraint import dimensionless_rows
from holdfast.dynamics.projection import StepEnd, largest_gaps
from holdfast.dynamics.smallest_forces import replaced_by_smallest
from holdfast.forces.force_split import constant_split
from holdfast.forces.margins import margins_of_grasps
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import CONTACTS, Shape
from holdfast.simulation.accounts import SPLIT, Forces, account_shapes, accounts
from holdfast.simulation.rollout.stage_values import SystemWithStageValues
from holdfast.simulation.rollout.traced_step import StepModel, TracedSystem, carried, stop_code
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class SystemQuestion:
    """A question about systems at their current states, with the forces there.

    Attributes:
        name: its name, part of the key in the cache.
        compute: function of the traced system, its chain, state, inputs, and the generic rank of the constraint, that
            returns the outputs by name, and carried arrays to overwrite as "last.NAME".
        shapes: function of the chain that returns the shapes of the outputs by name.
        parameters: function of the chain that returns parameters that only this question has, by name.
    """

    name: str
    compute: Callable[[TracedSystem, ClosedChain, State, Inputs, int], Mapping[str, Any]]
    shapes: Callable[[ClosedChain], Mapping[str, Shape]]
    parameters: Callable[[ClosedChain], Mapping[str, Array]] = lambda chain: {}


def _split(chain: ClosedChain) -> dict[str, Array]:
    split = constant_split(chain)
    return {} if split is None else {SPLIT: split}


def _accounts(system: TracedSystem, chain: ClosedChain, state: State, inputs: Inputs, rank: int) -> Mapping[str, Any]:
    given, last = system.given, system.last
    forces = Forces(last("grasp_wrench"), last("base_wrench"), given.get("last.trunk_base_wrench"))
    return accounts(chain, state, inputs, forces, given.get(SPLIT))


def _smallest(system: TracedSystem, chain: ClosedChain, state: State, inputs: Inputs, rank: int) -> Mapping[str, Any]:
    given, last = system.given, system.last
    forces = last("grasp_wrench"), last("base_wrench"), given.get("last.trunk_base_wrench")
    found = replaced_by_smallest(chain_at_rest(chain, state), rank, *forces)
    margins = margins_of_grasps(system.real, given[CONTACTS], state.object_frame.R, given["grasp_R"], found[0])
    chosen = {**dict(zip(Forces._fields, found, strict=True)), "margin": margins}
    return {f"last.{name}": x for name, x in chosen.items() if x is not None}


def _rows(system: TracedSystem, chain: ClosedChain, state: State, inputs: Inputs, rank: int) -> Mapping[str, Any]:
    return {ROWS: dimensionless_rows(chain_at_rest(chain, state))}


def _shape_of_rows(chain: ClosedChain) -> dict[str, Shape]:
    return {ROWS: (chain.constraint_row_count - chain.contact_freedom_count, chain.velocity_count)}


ROWS = "constraint_rows"
ACCOUNTS = SystemQuestion("accounts", _accounts, lambda chain: account_shapes(chain, bool(_split(chain))), _split)
SMALLEST_FORCES = SystemQuestion("smallest forces", _smallest, lambda chain: {})  # these and their margins, in place
CONSTRAINT = SystemQuestion("constraint", _rows, _shape_of_rows)


def after_jump(model: StepModel, given: Given) -> dict[str, Array]:
    """Return the carried arrays at the current state under torques and inputs that have jumped.

    These are the bits of a step of length zero with the input `held`, whose stages and projection count for nothing.
    """
    system = (SystemWithStageValues if model.structure.options.stages else TracedSystem)(model, given)
    t, at, none = system.time(0.0), system.state, np.zeros(model.structure.chain.joint_count)
    chain, inputs = system.environment.at(t, at)
    # as at a step's end: with configurations that were found before the velocities
    motion = chain_motion(chain, at, none, inputs, chain_motion(chain, at, none, inputs))
    gap = largest_gaps(chain, at, inputs, motion)
    system.end = StepEnd(at, gap, gap, motion)
    kept = system.results(system.evaluate(t, at, system.last("memory"), True, system.added))
    return carried(system, kept, stop_code(system, kept, gap, gap, passed=0.0), np.zeros(4), t, np.zeros(4))
