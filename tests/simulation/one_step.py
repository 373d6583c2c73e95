"""One step of any differential equation by the library's schemes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from holdfast.simulation.runge_kutta import Tableau, runge_kutta_step
from holdfast.spatial.scalar import Array


def one_step(
    derivative: Callable[[Any, Array], Array], t: Any, y: Array, step: Any, tableau: Tableau
) -> tuple[Array, list[Array]]:
    """Return y(t + step) for y' = derivative(t, y), and the estimates of its error.

    Args:
        derivative: (t, y) -> y'.
        t: time.
        y: (m,) at time t.
        step: h.
        tableau: the scheme.
    """
    requests = runge_kutta_step(
        derivative(t, y), step, tableau, lambda i, grown: (t + float(tableau.c[i]) * step, y + grown)
    )
    reply: Any = None
    while True:
        try:
            there = requests.send(reply)
        except StopIteration as end:
            grown, estimates = end.value
            return y + grown, estimates
        reply = derivative(*there)
