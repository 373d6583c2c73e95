"""Solvers of quadratic programmes on the elastic programme that the library solves, where it has no cones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.clarabel_peer import arguments
from holdfast.forces.programme_block import Block
from holdfast.spatial.scalar import Array

EQUALITY = 5  # DAQP's mark of a row that is an equation
PRECISION = 1e-9  # of ProxQP, whose own leaves more than the price of v allows


def solvers(blocks: Sequence[Block], e: Array, price: float) -> Iterator[tuple[str, Callable[[], Array]]]:
    """Yield the installed ones of DAQP, PIQP and ProxQP: the name, and a call that returns the unknowns, v last.

    A call passes the matrices anew, as the next sample of a controller has to.

    Args:
        blocks: the blocks of the programme, which have no cones.
        e: right-hand sides of the equations.
        price: of a unit of v.
    """
    upper, c, rows, right, _, _ = arguments(blocks, e, price)
    P, rows, k = (upper + upper.T).toarray() - np.diag(upper.diagonal()), rows.toarray(), len(e)
    A, G, h = np.ascontiguousarray(rows[:k]), np.ascontiguousarray(rows[k:]), right[k:]
    lowest = np.full(len(right), -np.inf)
    lowest[:k] = e
    kinds, made = np.zeros(len(right), np.int32), [_found(name) for name in ("daqp", "piqp", "proxsuite")]
    kinds[:k] = EQUALITY
    daqp, piqp, proxsuite = made

    def by_piqp() -> Array:
        solver = piqp.DenseSolver()
        solver.setup(P, c, A, e, G, lowest[k:], h)
        solver.solve()
        return np.array(solver.result.x)

    def by_proxqp() -> Array:
        solver = proxsuite.proxqp.dense.QP(len(c), k, len(h))
        solver.settings.eps_abs = PRECISION
        solver.init(P, c, A, e, G, lowest[k:], h)
        solver.solve()
        return np.array(solver.results.x)

    if daqp is not None:
        yield "DAQP", lambda: np.array(daqp.solve(P, c, rows, right, lowest, kinds)[0])
    if piqp is not None:
        yield "PIQP", by_piqp
    if proxsuite is not None:
        yield "ProxQP", by_proxqp


def _found(name: str) -> Any:
    """Return a module; None if it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        return None
