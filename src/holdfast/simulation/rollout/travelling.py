"""Control laws and base motions as the programs that they were traced to: plain data travels where functions cannot.

A lambda, or a function made by another, has no name that a second process could find it by.
"""

from __future__ import annotations

import operator
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.compiler import arithmetic
from holdfast.compiler.node import Node
from holdfast.compiler.program import Program
from holdfast.compiler.trace import trace
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.environment import BaseMotion
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.rollout.law_text import law_program
from holdfast.simulation.rollout.traced_motion import sound
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, cos, sin, sqrt, where
from holdfast.state import State


def travelling_law(law: ControlLaw, chain: ClosedChain) -> ControlLaw:
    """Return the law itself if it can be pickled, else one of the same meaning that can."""
    if _travels(law.torque):
        return law
    return replace(law, torque=TracedTorque(Replayed(law_program(law, chain)), tuple(law.parameters)))


def travelling_motion(name: str, motion: BaseMotion) -> BaseMotion:
    """Return the motion of a base itself if it can be pickled, else one of the same meaning that can."""
    if _travels(motion):
        return motion

    def text(t: Array) -> tuple[Array, Array, Array, Array]:
        pose, twist, acceleration = sound(name, motion)(t[()])
        return pose.R, pose.p, twist, acceleration

    return TracedMotion(Replayed(trace(text, [()])))


@dataclass(frozen=True, eq=False)
class Replayed:
    """A program as a function, on floats or to be traced again: arrays to arrays.

    Attributes:
        program: what it computes.
    """

    program: Program

    def __call__(self, *arrays: Any) -> list[Array]:
        """Return the program's outputs."""
        entries = [x for array in arrays for x in np.asarray(array).flat]
        values: list[Scalar] = []
        for kind, args, value in self.program.instructions:
            if kind == "input":
                value = entries[len(values)]
            elif kind != "constant":
                value = _OPERATIONS[kind](*(values[a] for a in args))
            values.append(value)
        return [array([values[k] for k in output.places]).reshape(output.shape) for output in self.program.outputs]


@dataclass(frozen=True, eq=False)
class TracedTorque:
    """The torques of a law: (t, state, memory, parameters) -> (torques, memory).

    Attributes:
        program: takes t, q, qd, object_pose, object_twist, memory and the parameters; returns torques and memory.
        parameters: their names, in order.
    """

    program: Replayed
    parameters: tuple[str, ...]

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and the memory (m,)."""
        where_it_is = (state.q, state.qd, state.object_pose, state.object_twist)
        torques, kept = self.program(t, *where_it_is, memory, *(given[name] for name in self.parameters))
        return torques, kept


@dataclass(frozen=True, eq=False)
class TracedMotion:
    """The motion of a base: t -> (pose, twist, acceleration).

    Attributes:
        program: takes t; returns R, p, twist and acceleration.
    """

    program: Replayed

    def __call__(self, t: Scalar) -> tuple[Pose, Array, Array]:
        """Return pose, twist and acceleration at a time [s]."""
        R, p, twist, acceleration = self.program(t)
        return Pose.unchecked(R, p), twist, acceleration


def _travels(function: object) -> bool:
    try:
        pickle.dumps(function)
    except Exception:  # whatever objects that the function holds raise
        return False
    return True


def _divide(a: Scalar, b: Scalar) -> Scalar:
    return a / b if isinstance(a, Node) or isinstance(b, Node) else arithmetic.divide(a, b)


def _fma(a: Scalar, b: Scalar, c: Scalar) -> Scalar:
    traced = [x for x in (a, b, c) if isinstance(x, Node)]
    return traced[0].graph.apply("fma", a, b, c) if traced else arithmetic.fma(a, b, c)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": _divide,
    "negate": operator.neg,
    "absolute": abs,
    "sqrt": sqrt,
    "sin": sin,
    "cos": cos,
    "fma": _fma,
    "less": operator.lt,
    "less_equal": operator.le,
    "select": where,
}
