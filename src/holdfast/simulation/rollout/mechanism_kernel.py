"""The machine code of one step of chains that are answered as forests, all numbers of which are constants of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import externals
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External
from holdfast.forces.margins import joint_limits
from holdfast.questions.arrays import CONTACTS, FLOATING_RESULT, contact_of, shapes, state_fields
from holdfast.simulation.increment import OF_WORK
from holdfast.simulation.rollout import traced_mechanism
from holdfast.simulation.rollout.kernel import STEP_INPUTS, StepKernel, own_shapes
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array

OF_MECHANISM = ("qdd", "object_acceleration", "grasp_wrench", "coupling_force")


class MechanismKernel(StepKernel):
    """The compiled step of a chain that is answered as a forest; see `StepKernel`."""

    def structured(self, options: Options) -> Structure:
        """Return what the compiler sees."""
        return traced_mechanism.MechanismStructure(
            self.chain, options, rank=self.generic_rank if self.generic_rank >= 0 else None
        )

    def carried_shapes(self) -> dict[str, Shape]:
        """Return the shapes of the arrays that a system carries between two steps, by name."""
        chain, law = self.chain, self.law
        forest, known = chain.as_forest.forest, shapes(chain)
        own = own_shapes(chain.joint_count, len(forest.closures), len(law.memory), self.structure.options)
        own["slope"] = (forest.position_count + forest.velocity_count + OF_WORK,)
        names = [*state_fields(chain), *OF_MECHANISM, *([FLOATING_RESULT] if chain.floats else [])]
        states = {name: known[name] for name in names}
        found = {**states, **own}
        return {name: shape for name, shape in found.items() if math.prod(shape) or name in states}

    def step_externals(self) -> dict[str, External]:
        """Return the arrays of a step: inputs, parameters, and carried arrays."""
        chain, law, options = self.chain, self.law, self.structure.options
        known = shapes(chain)
        own: dict[str, Shape] = {**dict.fromkeys((*STEP_INPUTS, "notice"), ()), "limits": (4, chain.joint_count)}
        of_law = {f"control.{name}": tuple(shape) for name, shape in law.parameters.items()}
        wrenches = ["object_wrench", *(["link_wrench", "trunk_link_wrench"] if options.link_wrenches else [])]
        inputs = [*STEP_INPUTS, *(name for name in wrenches if math.prod(known[name])), *of_law]
        inputs += ["notice"] if options.resolution else []
        carried = {f"last.{name}": External(shape, "carried") for name, shape in self.carried.items()}
        return externals(inputs, ["limits", CONTACTS], (), known | own | of_law) | carried

    def own_parameters(self) -> dict[str, Array]:
        """Return the chain's own parameters by name."""
        closures = self.chain.as_forest.forest.closures
        contacts = np.array([contact_of(closure.grasp) for closure in closures]).reshape(len(closures), 7)
        return {"limits": np.array(joint_limits(self.chain)), CONTACTS: contacts}

    def functions(self, tableau: Tableau) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Return the functions of a step, and of the slopes at the current states."""
        model = self.model
        return partial(traced_mechanism.step, model, tableau), partial(traced_mechanism.evaluation, model)
