"""Open-loop torques that are piecewise polynomials of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.controller import Controller, known_breakpoints, require_controller, torques_and_memory
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, ArrayField, Converted, Frozen, frozen_property, read_only
from holdfast.spatial.linalg import without_overflow
from holdfast.spatial.scalar import Array
from holdfast.state import State


@called
@dataclass(frozen=True, eq=False)
class TorqueSchedule(Frozen):
    """Torques tau_j(t) = sum_k c_jk (t - knot)^k from each knot to the next, plus those of another controller.

    The torques are zero before the first knot, and the last piece has no end. Simulation ends steps at the
    `breakpoints`. These are the knots, so that no step contains two pieces, and the extrema of the torques, so that
    every torque is monotonic within a step.

    Attributes:
        knots: (pieces,) times at which the pieces begin, increasing [s].
        coefficients: per piece (n, degree + 1), beginning with the constant [N m / s^k or N / s^k].
        beside: another controller, whose torques are added.
    """

    knots: ArrayField = REQUIRED
    coefficients: Converted[tuple[Array, ...], Sequence[ArrayLike]] = REQUIRED
    beside: Controller | None = None

    def __post_init__(self) -> None:
        if self.beside is not None:
            require_controller(self.beside)
        put = object.__setattr__
        put(self, "knots", checks.vector(self.knots, "schedule: knots"))
        if not len(self.knots) or (np.diff(self.knots) <= 0).any():
            raise ModelError(f"schedule: knots: expected increasing times, got {self.knots.tolist()}")
        if not isinstance(self.coefficients, list | tuple) and not (
            isinstance(self.coefficients, np.ndarray) and self.coefficients.ndim
        ):
            got = type(self.coefficients).__name__
            raise ModelError(f"schedule: coefficients: expected a list of tables, one per knot, got {got}")
        if len(self.coefficients) != len(self.knots):
            raise ModelError(
                f"schedule: expected one table of coefficients per knot, got {len(self.coefficients)} for"
                f" {len(self.knots)}"
            )
        shaped = [np.atleast_2d(checks.numbers(c, None, "schedule: coefficients")) for c in self.coefficients]
        joints = {c.shape[:-1] for c in shaped}
        if len(joints) != 1 or len(*joints) != 1 or not all(c.shape[-1] for c in shaped):
            raise ModelError(f"schedule: expected tables of (n, degree + 1), got {[c.shape for c in shaped]}")
        put(self, "coefficients", tuple(read_only(c) for c in shaped))

    @classmethod
    def linear(cls, times: Any, torques: Any, beside: Controller | None = None) -> TorqueSchedule:
        """Return the schedule that interpolates torques at given times linearly, and holds the last ones.

        Args:
            times: (k,) increasing [s].
            torques: (k, n) [N m or N].
            beside: as for the class.

        Raises:
            ModelError: the times do not increase, or the shape of the torques does not match them.
        """
        t, tau = (checks.numbers(x, None, f"schedule: {name}") for x, name in ((times, "times"), (torques, "torques")))
        if t.ndim != 1 or tau.ndim != 2 or len(t) != len(tau) or not len(t):
            raise ModelError(f"schedule: expected times (k,) and torques (k, n), got {t.shape} and {tau.shape}")
        if (np.diff(t) <= 0.0).any():
            raise ModelError(f"schedule: times: expected increasing ones, got {checks.short(t.tolist())}")
        with np.errstate(over="ignore"):  # refused below
            slopes = np.diff(tau, axis=0) / np.diff(t)[:, None]
        slopes = np.vstack([slopes, np.zeros((1, tau.shape[1]))])
        return cls(t, [np.column_stack([value, slope]) for value, slope in zip(tau, slopes, strict=True)], beside)

    @np.errstate(all="ignore")  # what overflows is refused
    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques (n,) [N m or N]; the memory is that of the other controller.

        Raises:
            ModelError: t is not a finite number.
            StateError: the torques overflow.
        """
        t = checks.number(t, "schedule: t")
        found, memory = (0.0, memory) if self.beside is None else torques_and_memory(self.beside(t, state, memory))
        others = np.asarray(found)
        piece = int(np.searchsorted(self.knots, t, side="right")) - 1
        if piece < 0:
            return others + np.zeros(len(self.coefficients[0])), memory
        table = self.coefficients[piece]
        tau = others + table @ (t - self.knots[piece]) ** np.arange(table.shape[1])
        return checks.finite(tau, "torque schedule"), memory

    @frozen_property
    def breakpoints(self) -> Array:
        """Knots, times of the torques' extrema, and breakpoints of the other controller, increasing [s]."""
        ends = np.append(self.knots[1:], np.inf)
        found = [*self.knots, *known_breakpoints(self.beside)]
        for begin, end, table in zip(self.knots, ends, self.coefficients, strict=True):
            for row in table:
                found += [begin + x for x in _turning_points(row) if 0.0 < x < end - begin]
        return np.unique(found)

    def for_chain(self, chain: ClosedChain) -> TorqueSchedule:
        """Return the schedule for a chain whose grasps have changed, with the other controller adapted."""
        other = getattr(self.beside, "for_chain", None)
        return self if other is None else replace(self, beside=other(chain))


def _turning_points(coefficients: Array) -> list[float]:
    """Return the points at which a polynomial's slope vanishes, including double roots that rounding made complex."""
    if len(coefficients) < 3:
        return []
    slope = np.polynomial.Polynomial(without_overflow(coefficients)).deriv().trim()
    if not np.isfinite(slope.coef).all() or slope.degree() < 1:
        return []
    roots = slope.roots()
    return [float(x.real) for x in roots if abs(x.imag) <= 1e-6 * max(1.0, abs(x))]
