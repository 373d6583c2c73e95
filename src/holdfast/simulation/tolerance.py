"""How large the error of one step may be, and how large the estimated one is beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.model import checks
from holdfast.spatial.scalar import Array
from holdfast.state import State

RTOL = 1e-8
SMALLEST_RTOL = 1e-15  # float64 has no more digits


@dataclass(frozen=True)
class Tolerance:
    """The error allowed in one step: atol + rtol times the size of what is integrated.

    Sizes are taken over groups (joint positions, joint rates, the object's position, angular
    and linear velocity), so that a joint that happens to stand still asks for no more digits
    than the others; an attitude counts as 1 rad. The work done is integrated, not controlled.

    Attributes:
        rtol: at least 1e-15.
        atol: > 0 [rad, m, rad/s or m/s]; rtol where it is None.
    """

    rtol: float = RTOL
    atol: float | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "rtol", checks.number(self.rtol, "tolerance: rtol", at_least=SMALLEST_RTOL))
        atol = self.rtol if self.atol is None else self.atol
        put(self, "atol", checks.number(atol, "tolerance: atol", above=0.0))

    def allowed(self, before: State, after: State) -> Array:
        """Return the error allowed in each increment (dq, dqd, turn, dp, dV(C)) of a step, (2 n + 12,)."""
        assert self.atol is not None
        sizes = np.maximum(_sizes(before), _sizes(after))
        n = len(before.q)
        return self.atol + self.rtol * np.repeat(sizes, [n, n, 3, 3, 3, 3])

    def ratio(self, estimates: Sequence[Array], before: State, after: State) -> float:
        """Return the estimated error of a step over the allowed one, in the mean square; 0 without estimates.

        e_5^2 / sqrt(e_5^2 + e_3^2 / 100) of the two estimates' means: Hairer's error of order 7,
        which no single linear estimate of these stages reaches.

        Args:
            estimates: none, or those of orders 5 and 3, (2 n + 16,) each.
            before: the state at the step's start.
            after: the state at its end.
        """
        if not estimates:
            return 0.0
        allowed = self.allowed(before, after)
        fifth, third = (float(np.mean((e[: len(allowed)] / allowed) ** 2)) for e in estimates)
        return fifth / math.sqrt(fifth + 0.01 * third) if fifth > 0.0 else 0.0


def _sizes(state: State) -> Array:
    """Return the sizes of q, qd, attitude, p, omega, v, (6,)."""
    w, v = state.object_twist[:3], state.object_twist[3:]
    return np.array([np.abs(x).max(initial=0.0) for x in (state.q, state.qd, np.ones(1), state.object_pose[4:], w, v)])
