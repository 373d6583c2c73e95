"""User functions that become machine code: control laws, external wrenches and the motions of bases.

All are traced to programs. A program can also be sent to other processes, as plain data, if the function itself cannot
be pickled: a lambda or a nested function has no name under which another process could import it.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from holdfast.compiled.traced_chain import unit_pose
from holdfast.compiler.arithmetic import OPERATIONS
from holdfast.compiler.node import Node
from holdfast.compiler.program import Program
from holdfast.compiler.trace import trace
from holdfast.control.controller import ControlLaw
from holdfast.control.digital_law import DigitalTorque
from holdfast.control.sampled import SampledTorque
from holdfast.control.traced_law import comparable, law_program, require_same_program
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import shapes, state_fields
from holdfast.simulation.environment import BaseMotion, GivenInputs, inputs_at, motion_of, require_wrenches, take_state
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, arctan2, array, cos, exp, sin, tanh, where
from holdfast.state import Inputs, State, parts_of

Motions = Mapping[str, BaseMotion]  # motions of the moving bases, by arm name
WRENCH_FIELDS = ("object_wrench", "link_wrenches", "trunk_link_wrenches")  # fields of `Inputs`


def checked_motion(name: str, motion: BaseMotion) -> Callable[[Scalar], tuple[Pose, Array, Array]]:
    """Return the motion with a check of its pose: an invalid pose is refused on floats, and becomes NaN if traced."""

    def found(t: Scalar) -> tuple[Pose, Array, Array]:
        pose, twist, acceleration = motion_of(name, motion(t))
        if not isinstance(pose, Pose):
            seven = checks.numbers(pose, (7,), f"base motion of '{name}' (wxyz_xyz)")
            return unit_pose(seven, ()), twist, acceleration
        R = where(rotation.skewness(pose.R) <= checks.ROTATION_TOLERANCE, pose.R, np.nan)
        return Pose.unchecked(R, pose.p), twist, acceleration

    return found


def with_wrenches(inputs: Inputs, acting: GivenInputs, chain: ClosedChain, t: Scalar, state: State) -> Inputs:
    """Return the inputs of a call with the additional wrenches added.

    Args:
        inputs: inputs of the call.
        acting: the additional wrenches, or the function that returns them.
        chain: the chain.
        t: time [s].
        state: positions and velocities.

    Raises:
        StateError: the additional inputs contain base motions, or have wrong shapes.
    """
    found = inputs_at(acting, take_state(acting), t, comparable(state))
    require_wrenches(found, "of a rollout")
    own = found.shaped(chain)
    return replace(inputs, **{name: _sum(getattr(inputs, name), getattr(own, name)) for name in WRENCH_FIELDS})


def _sum(a: Array | None, b: Array | None) -> Array | None:
    return b if a is None else a if b is None else a + b


def travelling_inputs(acting: GivenInputs | None, chain: ClosedChain) -> GivenInputs | None:
    """Return the inputs if they can be pickled, or otherwise an equivalent traced function that can."""
    return acting if acting is None or _travels(acting) else traced_inputs_of(acting, chain)


def traced_inputs_of(acting: GivenInputs, chain: ClosedChain) -> TracedInputs:
    """Return a function of external wrenches, traced."""
    fields, size = state_fields(chain), shapes(chain)
    given: list[str] = []

    def outputs(t: Array, *arrays: Array) -> tuple[Array, ...]:
        state = State(**dict(zip(fields.values(), arrays, strict=True)))
        found = with_wrenches(Inputs(), acting, chain, t[()], state)
        given[:] = [name for name in WRENCH_FIELDS if getattr(found, name) is not None]
        return tuple(getattr(found, name) for name in given)

    return TracedInputs(trace(outputs, [(), *(size[name] for name in fields)]), tuple(given))


def travelling_law(law: ControlLaw, chain: ClosedChain) -> ControlLaw:
    """Return the law if it can be pickled, or otherwise an equivalent traced law that can."""
    if _travels(law.torque):
        return law
    if isinstance(law.torque, SampledTorque | DigitalTorque):
        return replace(law, torque=replace(law.torque, law=travelling_law(law.torque.law, chain)))
    return replace(law, torque=TracedTorque(law_program(law, chain), tuple(law.parameters)))


def travelling_motion(name: str, motion: BaseMotion) -> BaseMotion:
    """Return the motion of a base if it can be pickled, or otherwise an equivalent traced motion that can."""
    return motion if _travels(motion) else traced_motion_of(name, motion)


def traced_motion_of(name: str, motion: BaseMotion) -> TracedMotion:
    """Return the motion of a base, traced."""

    def outputs(t: Array) -> tuple[Array, Array, Array, Array]:
        pose, twist, acceleration = checked_motion(name, motion)(t[()])
        return pose.R, pose.p, twist, acceleration

    return TracedMotion(trace(outputs, [()]))


def require_functions(motions: Motions, acting: GivenInputs | None, chain: ClosedChain) -> None:
    """Refuse motions of bases and external wrenches that depend on more than their arguments.

    Raises:
        ModelError: one does.
    """
    for name, motion in motions.items():
        traced = partial(traced_motion_of, name, motion)
        require_same_program(f"base motion of '{name}'", lambda traced=traced: traced().program, "t")
    if callable(acting):
        advice = "object_wrench=... in every call of the rollout"
        require_same_program("inputs", lambda: traced_inputs_of(acting, chain).program, advice)


@dataclass(frozen=True, eq=False)
class TracedTorque:
    """A traced control law, a function (t, state, memory, parameters) -> (torques, memory).

    Attributes:
        program: program of t, the state's arrays, the memory and the parameters that returns torques and memory.
        parameters: names of the parameters, in order.
    """

    program: Program
    parameters: tuple[str, ...]

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and the memory (m,)."""
        values = [given[name] for name in self.parameters]
        torques, kept = replayed(self.program, t, *parts_of(state).values(), memory, *values)
        return torques, kept


@dataclass(frozen=True, eq=False)
class TracedMotion:
    """A traced motion of a base, a function t -> (pose, twist, acceleration).

    Attributes:
        program: program of t that returns R, p, twist and acceleration.
    """

    program: Program

    def __call__(self, t: Scalar) -> tuple[Pose, Array, Array]:
        """Return the pose, twist and acceleration at a time [s]."""
        R, p, twist, acceleration = replayed(self.program, t)
        return Pose.unchecked(R, p), twist, acceleration


@dataclass(frozen=True, eq=False)
class TracedInputs:
    """Traced external wrenches, a function (t, state) -> Inputs.

    Attributes:
        program: program of t and the state's arrays that returns the wrenches.
        given: the fields of `Inputs` that the program returns, in order.
    """

    program: Program
    given: tuple[str, ...]

    def __call__(self, t: Scalar, state: State) -> Inputs:
        """Return the wrenches at a time [s] and a state."""
        found = replayed(self.program, t, *parts_of(state).values())
        return Inputs(**dict(zip(self.given, found, strict=True)))


def replayed(program: Program, *arrays: Any) -> list[Array]:
    """Return the outputs of a program, evaluated on floats or on traced numbers."""
    entries = [x for array in arrays for x in np.asarray(array).flat]
    values: list[Scalar] = []
    for kind, places, value in program.instructions:
        if kind == "input":
            value = entries[len(values)]
        elif kind != "constant":
            value = _applied(kind, *(values[place] for place in places))
        values.append(value)
    return [array([values[k] for k in output.places]).reshape(output.shape) for output in program.outputs]


def _applied(kind: str, *operands: Scalar) -> Scalar:
    """Return the result of one operation, which is a node if any operand is one."""
    node = next((x for x in operands if isinstance(x, Node)), None)
    return _ON_FLOATS[kind](*operands) if node is None else node.graph.apply(kind, *operands)


_ON_FLOATS: dict[str, Callable[..., Scalar]] = {
    **OPERATIONS,
    **{word.__name__: word for word in (sin, cos, exp, tanh, arctan2)},
}


def _travels(function: object) -> bool:
    try:
        pickle.dumps(function)
    except Exception:  # objects held by the function may raise any error
        return False
    return True
