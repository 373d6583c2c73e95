"""A compiled program tied to arrays of its own: the shortest way to call it, for control loops."""

from __future__ import annotations

import ctypes
import math

import numpy as np

from holdfast.compiler.cpu import Code
from holdfast.compiler.program import Program, Shape

_FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)  # lets other threads run meanwhile


class Bound:
    """Write into `inputs`, call, read from `outputs`; for one thread at a time.

    Attributes:
        inputs: an array of each input's shape; write with `inputs[k][...] = x`.
        outputs: the results of the last call.
    """

    def __init__(self, program: Program, code: Code) -> None:
        self._code = code  # alive as long as its address is used
        self._function = _FUNCTION(code.address)
        self._in, self._out = np.zeros(program.input_size), np.zeros(program.output_size)
        self._addresses = self._in.ctypes.data, self._out.ctypes.data
        self.inputs = _views(self._in, program.input_shapes)
        self.outputs = _views(self._out, tuple(output.shape for output in program.outputs))

    def __call__(self) -> None:
        """Compute `outputs` from `inputs`."""
        self._function(*self._addresses)


def _views(buffer: np.ndarray, shapes: tuple[Shape, ...]) -> tuple[np.ndarray, ...]:
    """Return the arrays of given shapes that lie one after the other in a buffer."""
    views, start = [], 0
    for shape in shapes:
        end = start + math.prod(shape)
        views.append(buffer[start:end].reshape(shape))
        start = end
    return tuple(views)
