"""Control laws as machine code: called as a controller, tied to arrays for control loops, or for a batch."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.externals import externals, shapes, state_fields
from holdfast.compiled.faults import fault, faulty, largest_positions
from holdfast.compiled.kernels import key_of
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, traced
from holdfast.compiler.kernel import Bound, Kernel
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External, Schedule
from holdfast.control.controller import ControlLaw, Controller, GivenLaw
from holdfast.control.traced_law import law_of, law_outputs
from holdfast.errors import FrozenError, HoldfastError, MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_fit

ROOMS = (
    "forces",
    "simulation",
    "control",
    "scenario",
)  # whose functions laws are made of, besides those of forward dynamics
LARGEST = 1e5  # rad: positions that machine code takes


class LawTorques(NamedTuple):
    """What a law returns.

    Attributes:
        tau: (n,) or (batch, n) torques [N m or N].
        memory: (m,) or (batch, m) what it carries on.
    """

    tau: Array
    memory: Array


def compile_law(controller: Controller | ControlLaw, chain: ClosedChain | None = None) -> CompiledLaw:
    """Return a control law as machine code of this computer.

    Args:
        controller: a `ControlLaw`, its parameters given or not, or a ready-made controller that can be traced.
        chain: whose joints it drives; the ready-made ones know it.

    Raises:
        ModelError: no chain.
        MethodNotApplicable: a function that cannot be traced.
        CompileError: the law does what machine code cannot.
    """
    known = getattr(controller, "chain", None) if chain is None else chain
    if not isinstance(known, ClosedChain):
        got = "none" if known is None else type(known).__name__
        raise ModelError(f"compile_law: chain: expected the ClosedChain whose joints the law drives, got {got}")
    law, values = law_and_values(controller, known)
    return CompiledLaw(law, known, values)


def law_and_values(controller: Controller | ControlLaw, chain: ClosedChain) -> tuple[ControlLaw, Mapping[str, Array]]:
    """Return the law of a controller of a chain, and its parameters' values as far as they are given.

    Raises:
        MethodNotApplicable: a function that cannot be traced.
    """
    law = controller if isinstance(controller, ControlLaw) else law_of(controller, chain)
    if law is None:
        raise MethodNotApplicable(
            f"compile_law: expected a ControlLaw or a built-in controller, got {type(controller).__name__}, which"
            " cannot be traced; try ControlLaw(torque), torque written with the functions of holdfast.spatial.scalar"
        )
    return law, controller.values if isinstance(controller, GivenLaw) else {}


class CompiledLaw:
    """A control law as machine code; made by `compile_law`. A controller itself, if its parameters are given.

    Attributes:
        law: the law.
        chain: whose joints it drives.
        values: of its parameters, as far as they were given.
    """

    def __init__(self, law: ControlLaw, chain: ClosedChain, values: Mapping[str, Array]) -> None:
        self.law, self.chain, self.values = law, chain, dict(values)
        self._fields, self._lock = state_fields(chain), threading.Lock()
        self._externals = law_externals(law, chain)
        key = f"{law.key}/{list(law.parameters.items())}/{len(law.memory)}" if law.key else ""
        structure = Structure(chain, Options())
        key = key and f"{key_of(f'law/{key}', structure, *ROOMS)}/{chain.joint_count}"
        self._kernel = Kernel(self._externals, lambda: law_schedule(law, chain), key)
        self._largest = largest_positions(chain)
        self._ranks = {name: len(e.shape) for name, e in self._externals.items()}

    def __repr__(self) -> str:
        """Return what it is the law of."""
        asked = [name for name in self.law.parameters if name not in self.values]
        return f"<CompiledLaw of {self.chain.joint_count} joints{', of ' + ', '.join(asked) if asked else ''}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes the law again: machine code is compiled, or found on disk."""
        return CompiledLaw, (self.law, self.chain, self.values)

    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return torques (n,) and memory, as any controller.

        Raises:
            StateError: a parameter that was not given, a state of another chain, or torques that are not finite.
        """
        require_fit(self.chain, state)
        if self._own is None or not np.abs(state.q).max(initial=0.0) <= LARGEST:
            return self.law.given(self.values).on_floats(t, state, memory)  # it says what is missing
        with self._lock:
            x = self._own.arrays
            x["t"][...] = t
            for name, field in self._fields.items():
                x[name][...] = getattr(state, field)
            if "memory" in x:
                x["memory"][...] = self.law.memory if memory is None else memory
            self._own.run()
            if not np.isfinite(x["tau"]).all():
                raise self._refusal(x)
            return x["tau"].copy(), x["kept"].copy() if "memory" in x else memory

    def torques(
        self,
        t: Any,
        q: Any,
        qd: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        memory: Any = None,
        threads: int = 1,
        **parameters: Any,
    ) -> LawTorques:
        """Return the torques and the memory of one system or a batch: a leading axis on any argument.

        Args:
            t: time [s].
            q: (n,) joint positions [rad or m].
            qd: (n,) joint rates.
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            memory: (m,) the law's; as it begins if not given.
            threads: how many threads share a batch.
            **parameters: of the law, those not given before; floating_pose and floating_twist of a floating base.

        Raises:
            StateError: wrong shapes or names, something missing; of one system also numbers that are not finite,
                angles beyond 1e5 rad, a quaternion not of unit length, and torques that are not finite. In a batch
                such a system gets not-a-number.
        """
        arrays.require_threads(threads)
        given = {"t": t, "q": q, "qd": qd, "object_pose": object_pose, "object_twist": object_twist}
        if len(self.law.memory):
            given["memory"] = self.law.memory if memory is None else memory
        elif memory is not None and np.size(memory):
            raise StateError("memory: expected none, as the law has no memory")
        given |= self.values | parameters
        inputs = {name: e.shape for name, e in self._externals.items() if e.role == "input"}
        _require_names(given, inputs)
        found = {name: arrays.floats(name, given[name], shape) for name, shape in inputs.items()}
        batch = arrays.batch_of(found, self._externals)
        wrong = fault(found, self._largest) if batch is None else None
        if wrong is not None:
            raise wrong
        lead = () if batch is None else (batch,)
        out = {name: np.empty((*lead, *e.shape)) for name, e in self._externals.items() if e.role == "output"}
        table = np.zeros((len(self._externals), 2), dtype=np.int64)
        for row, (name, e) in zip(table, self._externals.items(), strict=True):
            x = out[name] if name in out else found[name]
            row[:] = x.ctypes.data, e.size if x.ndim > len(e.shape) else 0
        self._kernel.run_batch(table, batch or 1, threads)
        bad = None if batch is None else faulty(found, self._ranks, self._largest, batch)
        for x in out.values() if bad is not None else ():
            x[bad] = np.nan
        if batch is None and not np.isfinite(out["tau"]).all():
            raise self._refusal(found)
        return LawTorques(out["tau"], out.get("kept", np.zeros((*lead, 0))))

    def _refusal(self, found: Mapping[str, Array]) -> StateError:
        """Return why torques are not finite: what the law's function says of the state, where it says something."""
        state = State(**{field: found[name] for name, field in self._fields.items()})
        given = {name: found[name] for name in self.law.parameters}
        try:
            with np.errstate(all="ignore"):
                self.law.torque(float(found["t"]), state, found.get("memory", self.law.memory), given)
        except StateError as said:
            return said
        except ArithmeticError:
            pass  # such as a division of Python's numbers by zero
        return StateError("compiled law: expected finite torques, got not-a-number or infinity at this state")

    def bind(self, **values: Any) -> BoundLaw:
        """Return the law tied to arrays that stay: a call without arguments, for control loops.

        Args:
            **values: what the arrays hold at first: of the state, `t`, `memory` and the law's parameters.

        Raises:
            StateError: a wrong shape or name.
        """
        return BoundLaw(self._kernel, self._externals, self.law, self.values | values)

    @cached_property
    def _own(self) -> Bound | None:
        """What calls as a controller run on; None while parameters are missing."""
        if set(self.values) != set(self.law.parameters):
            return None
        bound = self._kernel.bind()
        for name, x in self.values.items():
            bound.arrays[name][...] = x
        return bound


class CompiledLaws:
    """The machine code of controllers that one chain's run calls on floats, each made at its first call.

    A law that a function of the user's wraps costs what its machine code does.
    """

    def __init__(self, chain: ClosedChain) -> None:
        self._chain = chain
        self._found: dict[int, tuple[Any, CompiledLaw | None]] = {}

    def __call__(self, controller: Any) -> CompiledLaw | None:
        """Return a controller's machine code; None where there can be none."""
        known = self._found.get(id(controller))
        if known is None:
            try:
                made = compile_law(controller, self._chain)
            except HoldfastError:
                made = None
            known = self._found[id(controller)] = controller, made  # kept alive, so that the number stays its own
        return known[1]


class BoundLaw:
    """Write into the inputs, call, read `tau`; for one thread at a time. Made by `CompiledLaw.bind`.

    Nothing is checked and nothing is raised. The memory moves on when `keep` is called, so that a step may be asked
    twice.

    Attributes:
        arrays: all of them by name; each is an attribute too: write with `bound.q[...] = q`.
        run: the bare call without arguments.
    """

    def __init__(
        self, kernel: Kernel, externals: Mapping[str, External], law: ControlLaw, values: Mapping[str, Any]
    ) -> None:
        self._bound = kernel.bind()
        self.arrays = dict(self._bound.arrays)
        inputs = {name: e.shape for name, e in externals.items() if e.role == "input"}
        _require_names(values, inputs, every=False)
        if "memory" in inputs:
            self.arrays["memory"][...] = law.memory
        if "object_pose" in inputs:
            self.arrays["object_pose"][0] = 1.0
        for name, x in values.items():
            self.arrays[name][...] = checks.numbers(x, inputs[name], f"bind: {name}", StateError)
        vars(self).update(self.arrays)
        self.run = self._bound.run
        self._made = True

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse new arrays in the place of those that the machine code reads; `bound.q += dq` writes into them."""
        if "_made" in vars(self) and value is not vars(self).get(name, self):
            known = [n for n in vars(self) if not n.startswith("_")]
            if name in known:
                raise FrozenError(
                    f"bound law: {name}: cannot be replaced, because the machine code reads this array; try"
                    f" bound.{name}[...] = values"
                )
            raise FrozenError(f"bound law: no attribute '{name}'.{checks.did_you_mean(name, known)}")
        object.__setattr__(self, name, value)

    def __call__(self) -> Array:
        """Compute and return `tau`, the array that stays."""
        self.run()
        return self.arrays["tau"]

    def keep(self) -> None:
        """Let the memory move on to what the last call returned."""
        if "memory" in self.arrays:
            self.arrays["memory"][...] = self.arrays["kept"]


def law_externals(law: ControlLaw, chain: ClosedChain) -> dict[str, External]:
    """Return the arrays of a law: time, state, memory and parameters in; torques and memory out."""
    own: dict[str, Shape] = {"t": (), "memory": (len(law.memory),), "kept": (len(law.memory),)}
    size = shapes(chain) | own | {name: tuple(shape) for name, shape in law.parameters.items()}
    if taken := {"t", "tau", "memory", "kept", *state_fields(chain)} & set(law.parameters):
        raise StateError(f"compile_law: parameter '{min(taken)}': expected another name, since this one is reserved")
    remembers = ["memory"] if len(law.memory) else []
    inputs = ["t", *state_fields(chain), *remembers, *law.parameters]
    return externals(inputs, (), ["tau", *(["kept"] if remembers else [])], size)


def law_schedule(law: ControlLaw, chain: ClosedChain) -> Schedule:
    """Return what a law computes of its arrays."""

    def outputs(x: Given) -> dict[str, Array]:
        state = State(**{field: x[name] for name, field in state_fields(chain).items()})
        given = {f"control.{name}": x[name] for name in law.parameters}
        tau, kept = law_outputs(law, chain, x["t"][()], state, x.get("memory", np.zeros(0)), given)
        return {"tau": tau, "kept": kept} if len(law.memory) else {"tau": tau}

    return traced(law_externals(law, chain), outputs)


def _require_names(given: Mapping[str, Any], inputs: Mapping[str, Shape], every: bool = True) -> None:
    """Refuse values of what a law does not take, and one that is missing."""
    for name in given:
        if name not in inputs:
            raise StateError(f"compiled law: no argument '{name}'.{checks.did_you_mean(name, inputs)}")
    if every and (missing := [name for name in inputs if name not in given]):
        raise StateError(f"compiled law: expected {', '.join(missing)} too, got no value; try {missing[0]}=...")
