"""Derivatives of forward dynamics as schedules: the reference's own functions, traced."""

from __future__ import annotations

from typing import Any, NamedTuple

from holdfast.compiled.externals import shapes
from holdfast.compiled.forward_schedule import (
    forward_externals,
    guarded_outputs,
    outputs_of,
    solve_with_status,
)
from holdfast.compiled.structure import Structure
from holdfast.compiled.traced_chain import Given, traced, traced_chain, traced_inputs, traced_state
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External, Schedule
from holdfast.dynamics.closed.forward_derivatives import RESULTS, backward, forward
from holdfast.dynamics.closed.second_solve import point
from holdfast.model.closed_chain import ClosedChain

WITH = "with."  # before the names of what a product is taken with: cotangents of results, tangents of arguments
FOUND = "found."  # before the names of the product's parts


class Product(NamedTuple):
    """A product with the Jacobian of forward dynamics.

    Attributes:
        backward: cotangents of results with it, rather than it with tangents of arguments.
        given: the results, or arguments, that it is taken with.
        wanted: the arguments, or results, that it is found for.
    """

    backward: bool
    given: tuple[str, ...]
    wanted: tuple[str, ...]

    @property
    def name(self) -> str:
        """What it is called on disk."""
        return f"forward_{'vjp' if self.backward else 'jvp'}({','.join(self.given)};{','.join(self.wanted)})"

    def externals(self, structure: Structure) -> dict[str, External]:
        """Return the arrays it takes and returns."""
        known = derivative_shapes(structure.chain)
        of_forward = forward_externals(structure)
        own = {name: e for name, e in of_forward.items() if e.role == "input"}
        own |= {f"{WITH}{name}": External(known[name], "input") for name in self.given}
        own |= {name: e for name, e in of_forward.items() if e.role != "input"}
        return own | {f"{FOUND}{name}": External(known[name], "output") for name in self.wanted}

    def schedule(self, structure: Structure) -> Schedule:
        """Return the schedule for one chain."""
        externals = self.externals(structure)
        names = (*guarded_outputs(structure.chain), *(f"{FOUND}{name}" for name in self.wanted))
        guarded = tuple(name for name in names if externals[name].size)
        return traced(externals, lambda given: self.outputs(structure, given), "status", guarded)

    def outputs(self, structure: Structure, given: Given) -> dict[str, Any]:
        """Return forward dynamics and the product: the reference's functions, run on what is given."""
        chain, route = traced_chain(structure, given), structure.options.route
        state, inputs = traced_state(chain, given), traced_inputs(chain, given)
        solved = solve_with_status(chain, state, given["tau"], inputs, given["generic_rank"], route)
        at = point(solved.motion, solved.found, route)
        own = {name: given[f"{WITH}{name}"] for name in self.given}
        found = backward(at, own, self.wanted) if self.backward else forward(at, own)
        return outputs_of(chain, solved) | {f"{FOUND}{name}": found[name] for name in self.wanted}


def derivative_shapes(chain: ClosedChain) -> dict[str, Shape]:
    """Return the shapes of cotangents and tangents, by result and argument: poses as [turn; shift]."""
    known = shapes(chain)
    n, arms, grasps = chain.joint_count, len(chain.arms), len(chain.grasps)
    poses = {"object_pose": (6,), "base_pose": (arms, 6), "grasp_pose": (grasps, 6)}
    return known | poses | {"armature": (n,), "damping": (n,)} | {name: known[name] for name in RESULTS}
