"""A control law as the program that it was traced to: plain data, which travels where a function cannot.

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
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.rollout.law_text import law_program
from holdfast.spatial.scalar import Array, Scalar, cos, sin, sqrt, where
from holdfast.state import State


def travelling(law: ControlLaw, chain: ClosedChain) -> ControlLaw:
    """Return the law itself if it can be pickled, else one of the same meaning that can."""
    try:
        pickle.dumps(law.torque)
    except Exception:  # whatever objects that the law holds raise
        return replace(law, torque=TracedTorque(law_program(law, chain), tuple(law.parameters)))
    return law


@dataclass(frozen=True, eq=False)
class TracedTorque:
    """The torques of a law, on floats or to be traced again: (t, state, memory, parameters) -> (torques, memory).

    Attributes:
        program: takes t, q, qd, object_pose, object_twist, memory and the parameters; returns torques and memory.
        parameters: their names, in order.
    """

    program: Program
    parameters: tuple[str, ...]

    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the torques (n,) and the memory (m,)."""
        arrays = [t, state.q, state.qd, state.object_pose, state.object_twist, memory]
        arrays += [given[name] for name in self.parameters]
        entries = [x for array in arrays for x in np.asarray(array).flat]
        values: list[Scalar] = []
        for kind, args, value in self.program.instructions:
            if kind == "input":
                value = entries[len(values)]
            elif kind != "constant":
                value = _OPERATIONS[kind](*(values[a] for a in args))
            values.append(value)
        torques, kept = ([values[place] for place in output.places] for output in self.program.outputs)
        return np.array(torques), np.array(kept)


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
