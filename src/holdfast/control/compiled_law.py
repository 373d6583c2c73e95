"""Control laws in machine code, for calls as a controller, for control loops with bound arrays, and for batches."""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.computation import Computation
from holdfast.compiled.function import Function
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, externals, traced
from holdfast.compiler.elementary import LARGEST_ARGUMENT
from holdfast.compiler.kernel import Bound
from holdfast.compiler.program import Shape
from holdfast.control.controller import ControlLaw, Controller, GivenLaw
from holdfast.control.traced_law import law_of, law_outputs, require_function
from holdfast.errors import HoldfastError, MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.names import called, no_arguments
from holdfast.questions.arrays import Row, shapes, state_fields
from holdfast.questions.case import VariedCase
from holdfast.questions.question import Found, Question, Show
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit

# packages with functions that laws use, in addition to forward dynamics
PACKAGES = ("forces", "simulation", "control", "scenario")


class LawTorques(NamedTuple):
    """The results of a law.

    Attributes:
        tau: (n,) or (batch, n) torques [N m or N].
        memory: (m,) or (batch, m) memory.
    """

    tau: Array
    memory: Array


def _shown(chain: ClosedChain) -> Show:
    """Return what shows torques and memory."""

    def shown(found: Found) -> LawTorques:
        return LawTorques(found["tau"], found.get("kept", np.zeros((*found["tau"].shape[:-1], 0))))

    return shown


def compile_law(
    controller: Controller | ControlLaw, chain: ClosedChain | None = None, *, progress: bool | None = None
) -> CompiledLaw:
    """Return a control law compiled to machine code for this computer.

    Args:
        controller: a `ControlLaw`, with or without values of its parameters, or a controller of the library.
        chain: the chain that it controls; not needed for controllers of the library, which contain it.
        progress: as for `holdfast.compile`.

    Raises:
        ModelError: no chain is given, the law depends on more than its arguments, or `progress` is neither True, False
            nor None.
        MethodNotApplicable: the controller is a function that cannot be traced.
        CompileError: the law contains operations that cannot be compiled.
    """
    known = getattr(controller, "chain", None) if chain is None else chain
    if not isinstance(known, ClosedChain):
        got = "none" if known is None else type(known).__name__
        raise ModelError(f"compile_law: chain: expected the ClosedChain whose joints the law drives, got {got}")
    serial_chain(known, "compile_law: chain")
    law, values = law_and_values(controller, known)
    require_function(law, known)
    return CompiledLaw(law, known, values, progress)


def law_and_values(controller: Controller | ControlLaw, chain: ClosedChain) -> tuple[ControlLaw, Mapping[str, Array]]:
    """Return a controller as a control law, and the given values of its parameters.

    Raises:
        MethodNotApplicable: the controller is a function that cannot be traced.
    """
    law = controller if isinstance(controller, ControlLaw) else law_of(controller, chain)
    if law is None:
        raise MethodNotApplicable(
            f"compile_law: expected a ControlLaw or a built-in controller, got {type(controller).__name__}, which"
            " cannot be traced; try ControlLaw(torque), torque written with the functions of holdfast.spatial.scalar"
        )
    return law, controller.values if isinstance(controller, GivenLaw) else {}


def law_question(law: ControlLaw, chain: ClosedChain) -> Question:
    """Return the question that a law answers: which torques, and which memory if it has one."""
    kept = [Row("kept", (len(law.memory),), "", "memory")] if len(law.memory) else []

    def compute(case: VariedCase) -> tuple[Array, ...]:
        own = case.own
        given = {f"control.{name}": own[name] for name in law.parameters}
        found = law_outputs(law, chain, own["t"][()], case.state, own.get("memory", np.zeros(0)), given)
        return found if kept else found[:1]

    return Question("control law", compute, ("tau", *kept), shown=_shown)


def law_computation(law: ControlLaw, chain: ClosedChain) -> Computation:
    """Return the computation of a law, from time, state, memory and parameters to torques and memory.

    Raises:
        StateError: a parameter has the name of another array.
    """
    own: dict[str, Shape] = {"t": (), "memory": (len(law.memory),), "kept": (len(law.memory),)}
    size = shapes(chain) | own | {name: tuple(shape) for name, shape in law.parameters.items()}
    if taken := {"t", "tau", "memory", "kept", *state_fields(chain)} & set(law.parameters):
        raise StateError(f"compile_law: parameter '{min(taken)}': expected another name, since this one is reserved")
    remembers = ["memory"] if len(law.memory) else []
    inputs = ["t", *state_fields(chain), *remembers, *law.parameters]
    arrays = externals(inputs, (), ["tau", *(["kept"] if remembers else [])], size)

    question = law_question(law, chain)

    def outputs(x: Given) -> dict[str, Array]:
        state = State(**{field: x[name] for name, field in state_fields(chain).items()})
        return dict(zip(question.names, question.compute(VariedCase(chain, state, Inputs(), x)), strict=True))

    key = f"law/{law.key}/{list(law.parameters.items())}/{len(law.memory)}/{chain.joint_count}" if law.key else ""
    schedule = partial(traced, arrays, outputs)
    return Computation(key, Structure(chain, Options()), arrays, schedule, tuple(inputs), packages=PACKAGES)


@called
class CompiledLaw:
    """A control law in machine code, created by `compile_law`. It is itself a controller if its parameters are given.

    Attributes:
        law: the law.
        chain: the chain that it controls.
        values: the given values of its parameters.
        function: the machine code, a function of time, state, memory and parameters.
    """

    def __init__(
        self, law: ControlLaw, chain: ClosedChain, values: Mapping[str, Array], progress: bool | None = None
    ) -> None:
        self.law, self.chain, self.values = law, chain, dict(values)
        self._fields, self._lock = state_fields(chain), threading.Lock()
        question = replace(law_question(law, chain), settle=self._settle)
        compiled = CompiledChain(chain, Options(), None, progress)
        self.function = Function(compiled, question, computation=law_computation(law, chain))
        _ = self.function.calls

    def __repr__(self) -> str:
        """Return the number of joints and the names of the parameters without values."""
        missing = [name for name in self.law.parameters if name not in self.values]
        return f"<CompiledLaw of {self.chain.joint_count} joints{', of ' + ', '.join(missing) if missing else ''}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the arguments that create the law again; its machine code is then compiled or loaded from disk."""
        return CompiledLaw, (self.law, self.chain, self.values, self.function.compiled.progress)

    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques (n,) and the memory, as for any controller.

        Raises:
            StateError: a parameter has no value, the state belongs to another chain, or the torques are not finite.
        """
        require_fit(self.chain, state)
        if self._own is None or not np.abs(state.q).max(initial=0.0) <= LARGEST_ARGUMENT:
            return self.law.given(self.values).on_floats(t, state, memory)  # raises the error
        with self._lock:
            x = self._own.arrays
            x["t"][...] = t if isinstance(t, float) else checks.numbers(t, (), "control law: t", StateError)
            for name, field in self._fields.items():
                x[name][...] = getattr(state, field)
            if "memory" in x:
                size = self.law.memory.shape
                fits = isinstance(memory, np.ndarray) and memory.shape == size and memory.dtype == float
                memory = self.law.memory if memory is None else memory
                x["memory"][...] = memory if fits else checks.numbers(memory, size, "control law: memory", StateError)
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
        threads: int | None = None,
        **parameters: Any,
    ) -> LawTorques:
        """Return the torques and the memory for one system, or for a batch if an argument has a leading axis.

        Args:
            t: time [s].
            q: (n,) joint positions [rad or m].
            qd: (n,) joint rates.
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            memory: (m,) memory of the law; by default its initial memory.
            threads: as for `CompiledChain.forward_dynamics`.
            **parameters: parameters of the law that have no value yet; floating_pose and floating_twist of a floating
                base.

        Raises:
            StateError: a shape or name is wrong, or an argument is missing. For one system also: a number is not
                finite, an angle is beyond 1e5 rad, a quaternion is not of unit length, or the torques are not finite.
                In a batch the torques of such a system are NaN.
        """
        given = {"t": t, "q": q, "qd": qd, "object_pose": object_pose, "object_twist": object_twist}
        if len(self.law.memory):
            given["memory"] = self.law.memory if memory is None else memory
        elif memory is not None and np.size(memory):
            raise StateError("memory: expected none, as the law has no memory")
        given |= self.values | parameters
        _require_names(given, self.function.computation.inputs)
        return self.function(threads=threads, **given)

    def _settle(self, chain: ClosedChain, given: Found, found: Found) -> Found:
        """Refuse torques of one system that are not finite; see `Question`."""
        if found["tau"].ndim == 1 and not np.isfinite(found["tau"]).all():
            raise self._refusal(given)
        return found

    def _refusal(self, found: Found) -> StateError:
        """Return the error for torques that are not finite; it is that of the law's own function if it raises one."""
        state = State(**{field: found[name] for name, field in self._fields.items()})
        given = {name: found[name] for name in self.law.parameters}
        try:
            with np.errstate(all="ignore"):
                self.law.torque(float(found["t"]), state, found.get("memory", self.law.memory), given)
        except StateError as said:
            return said
        except ArithmeticError:
            pass  # for example a division by zero
        return StateError("compiled law: expected finite torques, got not-a-number or infinity at this state")

    def bind(self, **values: Any) -> BoundLaw:
        """Return the law bound to fixed arrays, which is called without arguments, for control loops.

        Args:
            **values: initial values of the arrays: of the state, `t`, `memory` and the law's parameters.

        Raises:
            StateError: a shape or name is wrong.
        """
        return BoundLaw(self, self.values | values)

    @cached_property
    def _own(self) -> Bound | None:
        """The bound kernel for calls as a controller; None if parameters have no values."""
        if set(self.values) != set(self.law.parameters):
            return None
        bound = self.function.calls.bind()
        for name, x in self.values.items():
            bound.arrays[name][...] = x
        return bound


class CompiledLaws:
    """The machine code of the controllers that are called on floats in a run of one chain, compiled at the first call.

    A law that is called inside a function of the user is therefore also evaluated by machine code.
    """

    def __init__(self, chain: ClosedChain) -> None:
        self._chain = chain
        self._found: dict[int, tuple[Any, CompiledLaw | None]] = {}

    def __call__(self, controller: Any) -> CompiledLaw | None:
        """Return a controller's machine code; None if it cannot be compiled."""
        known = self._found.get(id(controller))
        if known is None:
            try:
                made = compile_law(controller, self._chain)
            except HoldfastError:
                made = None
            known = self._found[id(controller)] = controller, made  # kept alive, so that its id stays unique
        return known[1]


class BoundLaw(BoundFunction):
    """A law bound to fixed arrays: write into the inputs, call it, and read `tau`. Created by `CompiledLaw.bind`.

    Only one thread at a time may use it. Nothing is checked, and no errors are raised. The memory is updated when
    `keep` is called, so a step can be evaluated twice.

    Attributes:
        arrays: the inputs by name. Each is also an attribute; write with `bound.q[...] = q`.
        tau: (n,) torques of the last call.
        kept: (m,) memory that the last call returned, if the law has one.
        run: the function without arguments that computes the outputs.
    """

    tau: Array

    def __init__(self, of: CompiledLaw, values: Mapping[str, Any]) -> None:
        super().__init__(of.function, {})
        _require_names(values, self.arrays, every=False)
        initial = {"memory": of.law.memory} if "memory" in self.arrays else {}
        for name, x in {**initial, **values}.items():
            self.arrays[name][...] = checks.numbers(x, self.arrays[name].shape, f"bind: {name}", StateError)
        vars(self).update({name: self._written.array(name) for name in self._written.layout.shapes})

    def __repr__(self) -> str:
        """Return the number of joints and the names of the arrays."""
        return f"<BoundLaw of {len(self.tau)} joints: {', '.join(self.arrays)}>"

    def __call__(self, *none: Any) -> Array:
        """Compute and return `tau`, which is always the same array."""
        if none:
            no_arguments("bound law", none)
        self.run()
        return self.tau

    def keep(self) -> None:
        """Update the memory to that of the last call."""
        if "memory" in self.arrays:
            self.arrays["memory"][...] = self._written.array("kept")


def _require_names(given: Mapping[str, Any], inputs: Collection[str], every: bool = True) -> None:
    """Refuse unknown names and, with `every`, missing ones."""
    for name in given:
        if name not in inputs:
            raise StateError(f"compiled law: no argument '{name}'.{checks.did_you_mean(name, inputs)}")
    if every and (missing := [name for name in inputs if name not in given]):
        raise StateError(f"compiled law: expected {', '.join(missing)} too, got no value; try {missing[0]}=...")
