"""Ordinary differential equations to any number of digits: Gragg's midpoint steps, extrapolated.

The error of Gragg's n substeps holds even powers of 1/n only, so Aitken-Neville's table over
n = 2, 4, 6 ... gains two orders a row (Bulirsch and Stoer). Nothing here knows how many digits
its scalars have.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def integrated(rate: Callable[[np.ndarray], np.ndarray], y: np.ndarray, step, steps: int, rows: int) -> np.ndarray:
    """Return y after some equal steps of y' = rate(y), each of order 2 * rows."""
    for _ in range(steps):
        y = extrapolated_step(rate, y, step, rows)
    return y


def extrapolated_step(rate: Callable[[np.ndarray], np.ndarray], y: np.ndarray, step, rows: int) -> np.ndarray:
    """Return y one step later, to order 2 * rows; rows * (rows + 1) + 1 evaluations."""
    first, table = rate(y), []
    for j in range(1, rows + 1):
        row = [_gragg(rate, y, first, step, 2 * j)]
        for k, before in enumerate(table, start=1):
            squared = (j * j - (j - k) ** 2) / _exact((j - k) ** 2, step)  # (n_j / n_(j-k))^2 - 1
            row.append(row[-1] + (row[-1] - before) / squared)
        table = row
    return table[-1]


def _gragg(rate: Callable, y: np.ndarray, first: np.ndarray, step, substeps: int) -> np.ndarray:
    """Return the midpoint rule's result after some substeps, smoothed."""
    h = step / substeps
    before, now = y, y + h * first
    for _ in range(substeps - 1):
        before, now = now, before + 2 * h * rate(now)
    return (before + now + h * rate(now)) / 2


def _exact(number: int, like):
    """Return a whole number as a scalar of the same kind."""
    return like * 0 + number
