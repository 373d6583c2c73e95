"""One step of many systems as machine code, and what a system is between two steps."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiled.kernels import key_of
from holdfast.compiled.parameters import parameters_of
from holdfast.compiled.structure import Options, Structure
from holdfast.compiler.batch_kernel import BatchKernel
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.friction import joint_friction
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.rollout.schedule import carried_shapes, step_externals, step_schedule
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array

Systems = dict[str, Array]  # carried arrays by name, (systems, *shape) each


class StepKernel:
    """A step of one chain under one law.

    Attributes:
        chain: the chain.
        law: the control law.
        carried: shapes of what a system is between two steps.
        externals: the arrays its machine code takes and returns.
        parameters: the chain's own, by the machine code's names.
    """

    def __init__(
        self, chain: ClosedChain, law: ControlLaw, tableau: Tableau, generic_rank: int, base_motion: bool = False
    ) -> None:
        """Take what is to be stepped; compiled at the first step."""
        self.chain, self.law = chain, law
        structure = Structure(chain, Options(base_motion=base_motion))
        externals = step_externals(structure, law)
        friction = hashlib.sha256(joint_friction(chain).tobytes()).hexdigest()
        what = f"step/{tableau.name}/{law.key}/{friction}"
        key = key_of(what, structure, "simulation", "control") if law.key else ""
        self._kernel = BatchKernel(externals, lambda: step_schedule(structure, law, tableau), key)
        self.carried = carried_shapes(chain, law)
        self.externals = externals
        own = parameters_of(chain, generic_rank) | {"friction": _friction(chain)}
        self.parameters = {name: own[name] for name, e in externals.items() if e.role == "parameter"}
        self._sizes = {name: e.size for name, e in externals.items()}
        self._ranks = {name: len(e.shape) for name, e in externals.items()}

    def systems(self, state: Mapping[str, Array], memory: Array | None = None, count: int | None = None) -> Systems:
        """Return systems that have only their states; a step of length zero closes them and finds everything else.

        Args:
            state: q, qd, object_pose, object_twist, a row for each system, or one for all.
            memory: the law's, likewise; by default as it says.
            count: how many, where no array has rows.
        """
        count = len(state["q"]) if count is None else count
        found = {name: np.zeros((count, *shape)) for name, shape in self.carried.items()}
        for name, x in state.items():
            found[name][...] = x
        if "memory" in found:
            found["memory"][...] = self.law.memory if memory is None else memory
        if "worst_margin" in found:
            found["worst_margin"][...] = np.inf
        return found

    def run(
        self, systems: Systems, inputs: Mapping[str, Array], parameters: Mapping[str, Array], repeats: int, threads: int
    ) -> None:
        """Take so many steps in place; a system that cannot stays at its last good state and says why.

        Args:
            systems: C order float64, as `systems` returns them.
            inputs: of the inputs' shapes, shared by all systems, or with a leading axis.
            parameters: likewise, where they differ from the chain's own.
            repeats: steps.
            threads: how many share the systems.
        """
        count = len(systems["q"])
        given = self.parameters | dict(parameters) | dict(inputs) | {f"last.{name}": x for name, x in systems.items()}
        arrays = {name: np.asarray(given[name], dtype=float, order="C") for name in self._sizes}
        table = np.zeros((len(arrays), 2), dtype=np.int64)
        for row, (name, x) in zip(table, arrays.items(), strict=True):
            row[:] = x.ctypes.data, self._sizes[name] if x.ndim > self._ranks[name] else 0
        self._kernel.run_batch(table, count, threads, repeats)


def _friction(chain: ClosedChain) -> Array:
    """Return [one-sided, mu, torsion radius or half length] of every grasp, (grasps, 3)."""
    rows: list[list[Any]] = []
    for grasp in chain.grasps.values():
        contact = grasp.contact
        size = None if contact is None else contact.half_length if grasp.kind == "hinge" else contact.torsion_radius
        rows.append([0.0, 1.0, 1.0] if contact is None else [1.0, contact.mu, size or 1.0])
    return np.array(rows, dtype=float).reshape(len(rows), 3)
