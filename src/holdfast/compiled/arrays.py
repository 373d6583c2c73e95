"""Check the user's arrays before their addresses are passed to machine code: shapes, batch sizes and numbers.

Invalid numbers are those that are not finite, angles that are too large, and quaternions that are not of unit length.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiled.result import Results
from holdfast.compiler.elementary import LARGEST_ARGUMENT
from holdfast.compiler.kernel import address_of
from holdfast.compiler.schedule import External
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.forest import Forest
from holdfast.questions.arrays import POSES
from holdfast.spatial.real_numbers import ROTATION_TOLERANCE, real_array
from holdfast.spatial.scalar import Array

_LARGEST = float(np.finfo(np.float64).max)


def largest_number(name: str) -> float:
    """Return a bound of the numbers of an input; of positions of joints, `largest_positions` are exact ones."""
    return LARGEST_ARGUMENT if name == "q" else _LARGEST


def largest_positions(chain: ClosedChain) -> Array:
    """Return the largest valid |q| of each position: 1e5 rad for revolute joints, no bound for prismatic ones."""
    joints = chain.all_joints
    largest = [LARGEST_ARGUMENT if joint.turns else _LARGEST for joint in joints]
    return np.repeat(np.array(largest, float), np.array([joint.type.position_count for joint in joints], int))


def invalid_mask(found: Mapping[str, Array], ranks: Mapping[str, int], largest: Array, batch: int) -> Array | None:
    """Return which systems of a batch have an invalid input, (batch,), or None if there are none.

    Args:
        found: the inputs by name.
        ranks: the number of axes of each input for one system; an input with one more axis has a batch axis.
        largest: (n,) the largest valid |q|.
        batch: the number of systems.
    """
    unsure = {name: x for name, x in found.items() if not _surely_sound(name, x)}
    if not unsure:
        return None
    bad = np.zeros(batch, dtype=bool)
    for name, x in unsure.items():
        wrong = ~_sound(name, x, largest)
        bad |= wrong.reshape(batch, -1).any(1) if x.ndim > ranks[name] else wrong.any()
    return bad


def input_error(found: Mapping[str, Array], largest: Array) -> StateError | None:
    """Return the error for the first invalid input of one system, or None if all are valid."""
    for name, x in found.items():
        if _surely_sound(name, x) or _sound(name, x, largest).all():
            continue
        if not np.isfinite(x).all():
            return StateError(f"{name.rpartition('.')[2]}: expected finite numbers, got {x[~np.isfinite(x)][0]}")
        if name in POSES:
            length = math.hypot(*x[:4])
            return StateError(f"{name}: expected a unit quaternion (w, x, y, z) first, got length {length:.9g}")
        worst = float(np.abs(x[~_sound(name, x, largest)]).max())
        return StateError(f"{name}: expected at most {LARGEST_ARGUMENT:g} rad, got {worst:.6g}")
    return None


def _surely_sound(name: str, x: Array) -> bool:
    """Return whether a fast sufficient test shows that all numbers are valid."""
    if not x.size:
        return True
    most = largest_number(name)
    within = bool(-most <= x.min() and x.max() <= most)  # false if x contains NaN
    return within and (name not in POSES or bool(_of_unit_length(x).all()))


def _sound(name: str, x: Array, largest: Array) -> Array:
    """Return which numbers are valid; no number of a pose is if its quaternion is not of unit length."""
    if name == "q":
        return np.abs(x) <= largest
    if name in POSES:
        return np.isfinite(x) & _of_unit_length(x)[..., None]
    return np.isfinite(x)


def _of_unit_length(pose: Array) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.sqrt(np.einsum("...i,...i", pose[..., :4], pose[..., :4]))
        return np.abs(length - 1.0) <= ROTATION_TOLERANCE


_FLOATS = np.dtype(np.float64)


def floats(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return a value as a float64 array in C order, of the given shape or with a leading batch axis."""
    if type(value) is np.ndarray and value.dtype is _FLOATS:
        got, flags = value.shape, value.flags
        if (got == shape or got[1:] == shape) and flags.c_contiguous and flags.aligned:
            return value
    a = real_array(value, name, "real numbers", StateError)
    if a.shape != shape and (a.ndim == 0 or a.shape[1:] != shape):
        raise StateError(f"{name}: expected shape {checks.shapes_with_rows(shape, 'batch')}, got {a.shape}")
    return np.require(a, np.float64, ["C", "A"])


def require_threads(threads: Any) -> None:
    """Raise a StateError unless `threads` is None or an integer of at least 1."""
    whole = isinstance(threads, int | np.integer) and not isinstance(threads, bool)
    if threads is not None and not (whole and threads >= 1):
        raise StateError(f"threads: expected an integer >= 1, got {checks.short(threads)}; try None, which chooses")


def batch_of(found: Mapping[str, Array], externals: Mapping[str, External]) -> int | None:
    """Return the batch size of the arrays, or None if none of them has a batch axis.

    Raises:
        StateError: The arrays have different batch sizes.
    """
    batch: int | None = None
    for name, a in found.items():
        if a.ndim > len(externals[name].shape):
            if batch not in (None, len(a)):
                sizes = {n: len(x) for n, x in found.items() if x.ndim > len(externals[n].shape)}
                raise StateError(f"expected one batch size, got {', '.join(f'{n}: {s}' for n, s in sizes.items())}")
            batch = len(a)
    return batch


def require_fit(out: Any, chain: ClosedChain | Forest, batch: int | None) -> None:
    """Raise a StateError if `out` belongs to another chain or forest, or has another batch size."""
    if not isinstance(out, Results) or out.chain is not chain:
        raise StateError(f"out: expected a result of this compiled chain, got {type(out).__name__}; leave it out first")
    if out.batch != batch:
        expected = "one system" if batch is None else f"a batch of {batch}"
        got = "one system" if out.batch is None else f"a batch of {out.batch}"
        raise StateError(f"out: expected a result of {expected}, got one of {got}")


class Addresses:
    """Makes tables of the addresses of a kernel's arrays; the addresses of fixed arrays are stored once."""

    def __init__(self, externals: Mapping[str, External], fixed: Mapping[str, Array]) -> None:
        self._externals, self._fixed = externals, dict(fixed)  # keeps the memory of fixed arrays alive
        self._rows = {name: k for k, name in enumerate(externals)}
        self._inputs = len(externals) - sum(e.role == "output" for e in externals.values())
        self._template = [address_of(fixed[name]) if name in fixed else 0 for name in externals]

    def row(self, found: Mapping[str, Array], out: Results) -> list[int]:
        """Return the address of every array, in the kernel's order; see `table`.

        Raises:
            StateError: An input lies in the memory of `out`.
        """
        row, rows, begin = self._template.copy(), self._rows, out.address
        end = begin + out.memory.nbytes
        for name, a in found.items():
            row[rows[name]] = start = address_of(a)
            if start < end and begin < start + a.nbytes and a.nbytes:
                raise StateError("out: expected memory of its own, but an input lies in it; try a copy of the input")
        count = 8 if out.batch is None else 8 * out.batch
        row[self._inputs :] = [begin + count * start for start in out.layout.starts]
        return row

    def table(self, found: Mapping[str, Array], out: Results) -> Array:
        """Return the address and the stride of every array, (externals, 2), in the kernel's order.

        The stride is the number of doubles from one system to the next, or 0 if all systems share the array.

        Args:
            found: the inputs and those parameters that replace fixed ones, as float64 arrays in C order.
            out: the result to be written.

        Raises:
            StateError: An input lies in the memory of `out`.
        """
        table = np.zeros((len(self._externals), 2), dtype=np.int64)
        table[:, 0] = self.row(found, out)
        for name, a in found.items():
            external = self._externals[name]
            table[self._rows[name], 1] = external.size if a.ndim > len(external.shape) else 0
        table[self._inputs :, 1] = out.layout.strides
        return table
