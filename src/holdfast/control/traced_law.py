"""Tracing of control laws to programs of time, state, memory and parameters."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from weakref import WeakSet

import numpy as np

from holdfast.compiled.traced_forest import traced_inverse
from holdfast.compiler.errors import CompileError
from holdfast.compiler.program import Program
from holdfast.compiler.trace import trace
from holdfast.control.controller import ControlLaw, Controller, GivenLaw, LawParameters, known_breakpoints
from holdfast.dynamics.tree.forest_inverse import inverse_code
from holdfast.errors import HoldfastError, ModelError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.questions.arrays import shapes, state_fields
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.spatial.traced_array import as_traced
from holdfast.state import State, parts_of


def law_of(controller: Controller | ControlLaw, chain: ClosedChain) -> ControlLaw | None:
    """Return a traceable controller as a control law; None if it cannot be traced.

    Raises:
        StateError: the controller is a law with parameters.
    """
    if isinstance(controller, ControlLaw | GivenLaw):
        return controller.given({}).law if isinstance(controller, ControlLaw) else controller.law
    if not getattr(controller, "traceable", False):
        return None
    key = exact_fingerprint(controller)
    law = ControlLaw(ControllerTorque(controller), key=key or "")
    if key is None:  # a part of it, such as a path, is a user function
        try:
            law_program(law, chain)
        except CompileError:
            return None
    return law


@dataclass(frozen=True, eq=False)
class ControllerTorque(Frozen):
    """The torques of a controller without memory, as those of a law.

    Attributes:
        controller: the controller.
    """

    controller: Controller

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its torques jump [s], as far as they are known in advance."""
        return known_breakpoints(self.controller)

    def for_chain(self, chain: ClosedChain) -> ControllerTorque:
        """Return the torques for a chain whose grasps have changed."""
        for_chain = getattr(self.controller, "for_chain", None)
        return self if for_chain is None else ControllerTorque(for_chain(chain))

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and the memory."""
        return np.asarray(self.controller(t, state, None)[0]), memory


def law_outputs(
    law: ControlLaw, chain: ClosedChain, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return a law's torques (n,) and memory.

    Args:
        law: the law.
        chain: the chain that it controls.
        t: time [s].
        state: positions and velocities.
        memory: memory to pass to the law.
        given: values of its parameters, by `control.name`.

    Raises:
        CompileError: the law does not return torques and memory of the right shapes.
    """
    values = LawParameters({name: as_traced(given[f"control.{name}"]) for name in law.parameters})
    if not isinstance(law.torque, ControllerTorque):
        state, memory = comparable(state), as_traced(memory)
    token = inverse_code.set(traced_inverse if state.q.dtype == object else inverse_code.get())
    try:
        found = law.torque(t, state, memory, values)
    finally:
        inverse_code.reset(token)
    if not isinstance(found, tuple) or len(found) != 2:
        raise CompileError(f"control law: expected torques and memory, got {type(found).__name__}; try `tau, memory`")
    none = found[1] is None and not len(law.memory)
    drive, kept = array(found[0]), np.zeros(0) if none else array(found[1])
    for what, x, size in (("torques", drive, chain.joint_count), ("memory", kept, len(law.memory))):
        if x.shape != (size,):
            advice = f"; try ControlLaw(torque, memory=np.zeros({x.shape}))" if what == "memory" else ""
            raise CompileError(f"control law: {what}: expected shape ({size},), got {x.shape}{advice}")
    return drive, kept


def comparable(state: State) -> State:
    """Return a state; one of traced numbers has arrays on which NumPy's functions that compare entries work."""
    if state.q.dtype != object:
        return state
    return State(**{name: as_traced(x) for name, x in parts_of(state).items()})


def law_program(law: ControlLaw, chain: ClosedChain) -> Program:
    """Return a law as a program from t, the state's arrays, memory and parameters to torques and memory.

    Raises:
        CompileError: the law cannot be traced.
    """
    names, fields, size = [f"control.{name}" for name in law.parameters], state_fields(chain), shapes(chain)

    def outputs(t: Array, *arrays: Array) -> tuple[Array, Array]:
        parts, (memory, *given) = arrays[: len(fields)], arrays[len(fields) :]
        state = State(**dict(zip(fields.values(), parts, strict=True)))
        return law_outputs(law, chain, t[()], state, memory, dict(zip(names, given, strict=True)))

    of_state = [size[name] for name in fields]
    return trace(outputs, [(), *of_state, (len(law.memory),), *map(tuple, law.parameters.values())])


def law_key(law: ControlLaw, chain: ClosedChain) -> str:
    """Return what identifies a law's machine code: its own key, or a digest of its program; "" if it has neither."""
    if law.key:
        return law.key
    try:
        return hashlib.sha256(repr(law_program(law, chain)).encode()).hexdigest()
    except HoldfastError:  # reported where the law is compiled
        return ""


_functions: WeakSet[ControlLaw] = WeakSet()  # laws found to be functions of their arguments alone


def require_function(law: ControlLaw, chain: ClosedChain) -> None:
    """Refuse a law whose result depends on more than its arguments; a law of the library is known not to.

    Raises:
        ModelError: it does.
    """
    advice = "ControlLaw(torque, parameters={'noise': (n,)}) with values given to every call, or its memory"
    known = law.key or law in _functions
    if not known and require_same_program("control law", lambda: law_program(law, chain), advice):
        _functions.add(law)


def require_same_program(what: str, program: Callable[[], Program], advice: str) -> bool:
    """Refuse a function that depends on more than its arguments: it is traced twice, and the programs are compared.

    Args:
        what: what it is, for the message.
        program: traces it.
        advice: where to give what changes from call to call, for the message.

    Returns:
        Whether it could be traced; what to do with one that cannot is left to the caller.

    Raises:
        ModelError: the programs differ.
    """
    try:
        first, second = program(), program()
    except HoldfastError:
        return False
    if repr(first) == repr(second):  # as texts, because not-a-number differs from itself
        return True
    pairs = zip(first.instructions, second.instructions, strict=False)
    numbers = next(((a.value, b.value) for a, b in pairs if repr(a) != repr(b) and a.kind == b.kind), None)
    found = "other operations" if numbers is None else f"{numbers[1]:.6g} in place of {numbers[0]:.6g}"
    raise ModelError(
        f"{what}: expected a function of its arguments alone, got {found} from a second call with the same ones. It"
        " reads random numbers, a clock, a counter or a variable that changes, and would be compiled with the values of"
        f" one call. Try {advice} for what changes"
    )
