"""Which machine code takes the steps of which systems of a rollout."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.simulation.rollout.arguments import StopMargins, kernel_arguments, step_inputs
from holdfast.simulation.rollout.contact_steps import with_impulses
from holdfast.simulation.rollout.kernel import StepKernel
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.traced_impulses import FROM_LAST, LONG_WAY, WHOLE_PATH
from holdfast.simulation.runge_kutta import IMEX, Tableau
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.simulation.rollout.rollout import Rollout

EXPLICIT, IMPLICIT = "explicit", "implicit"  # ways to take a step without contacts


def kernels_of(rollout: Rollout) -> dict[str, StepKernel]:
    """Return the machine code of every way; the first one is the usual."""
    rank = -1 if rollout.generic_rank is None else rollout.generic_rank

    def of(tableau: Tableau, contacts: str = "") -> StepKernel:
        options = replace(rollout.options, resolution=not (tableau.implicit or contacts), contacts=contacts)
        surroundings: Any = {"motions": rollout.base_motion, "acting": rollout.inputs, "options": options}
        surroundings["code"] = rollout.kind.code
        return StepKernel(rollout.chain, rollout.law, tableau, rank, **surroundings)

    scheme = scheme_of(rollout.scheme)
    if rollout.chain.touching is not None:
        return {way: of(scheme, way) for way in (FROM_LAST, WHOLE_PATH, LONG_WAY)}
    return {EXPLICIT: of(scheme)} | ({IMPLICIT: of(IMEX)} if rollout.kind.implicit else {})


def take_steps(
    rollout: Rollout, systems: RolloutSystems, steps: int, least: StopMargins, threads: int | None, wait: bool
) -> None:
    """Take steps in place, with the systems' step lengths; see `Rollout.advance_unconfirmed`."""
    take = partial(_take, rollout.kernels, least=least, threads=threads)
    if rollout.chain.touching is not None:
        with_impulses(systems, steps, take)
        return
    stiff = rollout.stiff(systems)
    for way, of_way in ((EXPLICIT, ~stiff), (IMPLICIT, stiff)) if stiff.any() else ((EXPLICIT, ~stiff),):
        rows = np.flatnonzero(of_way)
        if not len(rows):
            continue
        part = systems if len(rows) == len(systems) else systems.copy(rows)
        take(part, part.step_length, way=way, steps=steps, wait=wait)
        if part is not systems:
            systems.put(rows, part)


def _take(
    kernels: dict[str, StepKernel],
    systems: RolloutSystems,
    h: Array,
    *,
    way: str,
    steps: int = 1,
    least: StopMargins,
    threads: int | None,
    wait: bool = False,
) -> None:
    """Take steps in place with one of the kernels."""
    systems.set_step_length(h)
    kernel = kernels[way]
    inputs, parameters = kernel_arguments(kernel, systems.call_inputs)
    kernel.run(systems.arrays, inputs | step_inputs(systems, least, wait), parameters, steps, threads)
