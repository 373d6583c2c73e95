"""One step of many systems as machine code, and what a system is between two steps."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from holdfast.compiled.kernels import key_of
from holdfast.compiled.parameters import parameters_of
from holdfast.compiled.structure import Options, Structure
from holdfast.compiler.kernel import BatchKernel
from holdfast.dynamics.margins import joint_limits
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.grasp import WrenchLimits
from holdfast.simulation.friction import joint_friction
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.rollout.schedule import carried_shapes, evaluation_schedule, step_externals, step_schedule
from holdfast.simulation.rollout.traced_motion import Motions
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.scalar import Array

Systems = dict[str, Array]  # carried arrays by name, (systems, *shape) each


class StepKernel:
    """A step of one chain under one law.

    Attributes:
        chain: the chain.
        law: the control law.
        motions: of the bases that move.
        carried: shapes of what a system is between two steps.
        externals: the arrays its machine code takes and returns.
        parameters: the chain's own, by the machine code's names.
    """

    def __init__(
        self,
        chain: ClosedChain,
        law: ControlLaw,
        tableau: Tableau,
        generic_rank: int,
        *,
        motions: Motions | None = None,
        options: Options | None = None,
        quick: bool = False,
    ) -> None:
        """Take what is to be stepped; compiled at the first step, sooner if `quick`."""
        self.chain, self.law, self.motions = chain, law, dict(motions or {})
        structure = Structure(chain, options or Options())
        externals = step_externals(structure, law)
        friction = hashlib.sha256(joint_friction(chain).tobytes()).hexdigest()
        moving = exact_fingerprint(self.motions)
        what = f"{law.key}/{list(law.parameters.items())}/{len(law.memory)}/{friction}/{moving}"

        def key(of: str) -> str:
            known = law.key and moving is not None
            return key_of(f"{of}/{what}", structure, "simulation", "control", "scenario") if known else ""

        self._step = BatchKernel(
            externals,
            lambda: step_schedule(structure, law, self.motions, tableau),
            key(f"step/{tableau.name}"),
            quick=quick,
        )
        self._evaluation = BatchKernel(
            externals, lambda: evaluation_schedule(structure, law, self.motions), key("evaluation"), quick=quick
        )
        self.carried = carried_shapes(chain, law)
        self.externals = externals
        own = parameters_of(chain, generic_rank) | {"contact": _contact(chain), "limits": np.array(joint_limits(chain))}
        self.parameters = {name: own[name] for name, e in externals.items() if e.role == "parameter"}
        self._margins = dict.fromkeys(("least_margin", "least_joint_margin"), np.array(-np.inf))
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
            systems: as `systems` returns them (see `require_own`); their slopes must be found under the same inputs.
            inputs: of the inputs' shapes, shared by all systems, or with a leading axis; no margin stops a system
                unless one is given.
            parameters: likewise, where they differ from the chain's own.
            repeats: steps.
            threads: how many share the systems.
        """
        self._run(self._step, systems, inputs, parameters, repeats, threads)

    def renew(
        self, systems: Systems, inputs: Mapping[str, Array], parameters: Mapping[str, Array], threads: int
    ) -> None:
        """Find the slopes where the systems are anew, in place, under other inputs; arguments as for `run`."""
        self._run(self._evaluation, systems, inputs, parameters, 1, threads)

    def _run(
        self,
        code: BatchKernel,
        systems: Systems,
        inputs: Mapping[str, Array],
        parameters: Mapping[str, Array],
        repeats: int,
        threads: int,
    ) -> None:
        given = (
            self.parameters
            | self._margins
            | dict(parameters)
            | dict(inputs)
            | {f"last.{name}": x for name, x in systems.items()}
        )
        arrays = {name: np.asarray(given[name], dtype=float, order="C") for name in self._sizes}
        table = np.zeros((len(arrays), 2), dtype=np.int64)
        for row, (name, x) in zip(table, arrays.items(), strict=True):
            row[:] = x.ctypes.data, self._sizes[name] if x.ndim > self._ranks[name] else 0
        code.run_batch(table, len(systems["q"]), threads, repeats)

    def require_own(self, systems: Systems) -> None:
        """Refuse arrays that the machine code would read or write beyond their ends, or not at all.

        Raises:
            StateError: the systems are not of this chain and law, or cannot be written in place.
        """
        count = len(systems["q"])
        for name, shape in self.carried.items():
            x, expected = systems.get(name), (count, *shape)
            if x is None or x.shape != expected:
                found = "none" if x is None else f"shape {x.shape}"
                raise StateError(
                    f"systems: {name}: expected shape {expected}, got {found}; try systems that `start` of this rollout"
                    " returned"
                )
            if x.dtype != np.float64 or not (x.flags.c_contiguous and x.flags.aligned and x.flags.writeable):
                raise StateError(f"systems: {name}: expected float64 in C order, writeable; try writing into the array")


def _contact(chain: ClosedChain) -> Array:
    """Return what the grasps' margins are made of, (grasps, 6); see `advance.contact_margin`."""
    rows: list[list[float]] = []
    for grasp in chain.grasps.values():
        contact, limits = grasp.contact, grasp.wrench_limits or WrenchLimits()
        one_sided = [0.0, 1.0, 1.0] if contact is None else [1.0, contact.mu, grasp.contact_size or 1.0]
        rows.append([*one_sided, limits.moment, limits.force, limits.lever])
    return np.array(rows, dtype=float).reshape(len(rows), 6)
