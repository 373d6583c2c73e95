"""Step-size control: the tolerance, and steps as long as the estimated error allows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from holdfast.errors import HoldfastError, ModelError, StateError
from holdfast.model import checks
from holdfast.spatial.scalar import Array, Scalar, array, maximum, sqrt, where
from holdfast.spatial.vector import largest
from holdfast.state import State

RTOL = 1e-8
SMALLEST_RTOL = 1e-15  # float64 has no more digits


@dataclass(frozen=True)
class Tolerance:
    """The error allowed in one step: atol + rtol times the size of the integrated quantities.

    One size is used for each group of quantities (joint positions, joint rates, and the position, angular velocity
    and linear velocity of each free body), so that a joint that happens to stand still is integrated no more
    accurately than the others. The size of an attitude is 1 rad. A chain that is answered as a forest has two groups,
    positions and rates. The work done is integrated, but its error is not controlled.

    Attributes:
        rtol: relative tolerance, at least 1e-15.
        atol: absolute tolerance, > 0 [rad, m, rad/s or m/s]; None means the same number as rtol.
    """

    rtol: float = RTOL
    atol: float | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "rtol", checks.number(self.rtol, "tolerance: rtol", at_least=SMALLEST_RTOL))
        atol = self.rtol if self.atol is None else self.atol
        put(self, "atol", checks.number(atol, "tolerance: atol", above=0.0))

    def ratio(self, estimates: Sequence[Array], before: State, after: State) -> float:
        """Return the estimated error of a step divided by the allowed error; see `error_ratio`.

        Args:
            estimates: empty, or the estimates of orders 5 and 3, each laid out as an `increment`.
            before: the state at the step's start.
            after: the state at its end.
        """
        assert self.atol is not None
        return error_ratio(estimates, allowed_error(self.rtol, self.atol, before, after))


def allowed_error(rtol: Scalar, atol: Scalar, before: State, after: State) -> Array:
    """Return the error allowed in each entry of a step's increment, without the work, (2 n + 12 bodies,)."""
    sizes = [atol + rtol * maximum(*pair) for pair in zip(_sizes(before), _sizes(after), strict=True)]
    n = len(before.q)
    return array([sizes[0]] * n + [sizes[1]] * n + [size for size in sizes[2:] for _ in range(3)])


def error_ratio(estimates: Sequence[Array], allowed: Array) -> Scalar:
    """Return the estimated error of a step divided by the allowed error, in the mean square; 0 without estimates.

    With e_5 and e_3 the root mean squares of the two estimates, the error is e_5^2 / sqrt(e_5^2 + e_3^2 / 100).
    This is Hairer's estimate of order 7; a single linear combination of these stages does not reach that order.

    Args:
        estimates: the estimates of orders 5 and 3.
        allowed: the error allowed in each of their first entries; that of the others, the work, is not controlled.
    """
    if not estimates:
        return 0.0
    n = len(allowed)
    fifth, third = (sum((e[:n] / allowed) ** 2) / n for e in estimates)
    found = fifth > 0.0
    return where(found, fifth / sqrt(where(found, fifth + 0.01 * third, 1.0)), 0.0)


def _sizes(state: State) -> list[Scalar]:
    """Return the sizes of q and qd, and of the attitude, p, omega and v of each free body, 6 or 10."""
    groups = [state.q, state.qd]
    for pose, twist in ((state.object_pose, state.object_twist), (state.base_pose, state.base_twist)):
        if pose is not None and twist is not None:
            groups += [np.ones(1), pose[4:], twist[:3], twist[3:]]
    return [largest(x) for x in groups]


if TYPE_CHECKING:
    from holdfast.simulation.instant import Instant
    from holdfast.simulation.stepper import Advance, Stepper

SAFETY = 0.9
LEAST_RATIO, MOST_RATIO = 0.2, 5.0  # limits of the ratio between a step and its predecessor
SMALLEST_STEP = 1e-12  # [s]: no motion of a simulated arm is faster than this
SMALLEST_ERROR = 1e-4  # the controller uses at least this as the error of the previous step
FIRST_STEP = 0.01  # the first step, as a fraction of the time in which the chain would move by 1 rad or m


@dataclass(frozen=True)
class Proposal:
    """The step to try next, with the state of the step-size controller.

    Attributes:
        step: length of the step [s].
        last_error: estimated error of the previous step divided by the tolerance.
    """

    step: float
    last_error: float = 1.0


def first_proposal(now: Instant) -> Proposal:
    """Return a cautious first step, chosen from the velocities and accelerations at the start."""
    inverse_time = max(float(np.abs(now.velocities).max()), math.sqrt(float(np.abs(now.accelerations).max())))
    return Proposal(FIRST_STEP / max(inverse_time, FIRST_STEP))  # 1 s where nothing moves


def controlled(step: float, error: float, order: int, last_error: float) -> tuple[bool, float]:
    """Return whether a step is accepted, and the length of the next one [s].

    h' = 0.9 h e^(-0.7/k) e_last^(0.4/k) after an accepted step (Gustafsson's PI control),
    h' = 0.9 h e^(-1/k) after a rejected one; between a fifth and five times h.

    Args:
        step: h [s].
        error: e, the estimated error divided by the tolerance; NaN counts as too large.
        order: k, where the estimated error of one step is O(h^k).
        last_error: e of the previous accepted step.
    """
    accepted = error <= 1.0
    if error == 0.0:
        return True, MOST_RATIO * step
    if not math.isfinite(error):
        return False, LEAST_RATIO * step
    change = error ** (-0.7 / order) * last_error ** (0.4 / order) if accepted else error ** (-1 / order)
    return accepted, step * min(MOST_RATIO, max(LEAST_RATIO, SAFETY * change))


def smallest_step(t: float) -> float:
    """Return the shortest step at a time [s]: 1e-12 s, or the resolution of float64 at that time if it is coarser."""
    return max(SMALLEST_STEP, 16 * float(np.spacing(abs(t))))


def next_step(
    stepper: Stepper, now: Instant, proposed: Proposal, latest: float, placed: Callable[[float], float] | None = None
) -> tuple[Advance, Proposal]:
    """Return the next accepted step and the proposal for the one after it.

    A step that fails, or whose error is above the tolerance, is repeated with a shorter length. The last two steps
    before `latest` divide the remaining time equally, and the last one ends exactly there. If `latest` shortens a
    step, the proposal for the step after it is not shortened.

    Args:
        stepper: takes the steps, with a scheme that estimates its error.
        now: the last accepted instant.
        proposed: from `first_proposal` or from the previous call.
        latest: time that the step must not pass [s].
        placed: maps the length that a step could have to the length that it shall have, which is no longer [s].

    Raises:
        StateError: the error is too large even with the shortest step; the message gives the time.
        SingularChainError, ClosureError: even the shortest step fails.
        ModelError: the scheme does not estimate its error, or `latest` is not later than `now`.
    """
    if not stepper.scheme.adaptive:
        raise ModelError(f"adaptive: scheme '{stepper.scheme.name}' estimates no error; try 'dop853', or a fixed step")
    room = latest - now.t
    if not 0.0 < room < math.inf:
        raise ModelError(f"adaptive: latest: expected a time after t = {now.t:.9g} s, got {latest:.9g} s")
    pieces = math.ceil(room / proposed.step * (1 - 1e-9))
    step, rejected = (room / pieces if pieces <= 2 else proposed.step), False
    if placed is not None:
        step = placed(min(proposed.step, room))
    while True:
        (reached,) = stepper.advance(now, [latest if step >= room else now.t + step])
        error = reached.error if reached.failure is None else math.nan
        accepted, proposal = controlled(step, error, stepper.scheme.order, proposed.last_error)
        if accepted and not rejected and step < proposed.step:  # `latest` shortened the step
            return reached, Proposal(max(proposal, proposed.step), proposed.last_error)
        if accepted:  # a length that has just failed is not tried again in the next step
            return reached, Proposal(min(step, proposal) if rejected else proposal, max(error, SMALLEST_ERROR))
        if proposal < smallest_step(now.t):
            raise _stuck(now.t, reached)
        step, rejected = (proposal if placed is None else placed(min(proposal, room))), True


def _stuck(t: float, reached: Advance) -> HoldfastError:
    """Return the error of a step that cannot be made shorter."""
    if reached.failure is not None:
        return type(reached.failure)(f"no step leads on from t = {t:.9g} s, however short: {reached.failure}")
    error = f"{reached.error:.3g} times the tolerance" if math.isfinite(reached.error) else "beyond all numbers"
    return StateError(
        f"no step leads on from t = {t:.9g} s: at {reached.t - t:.3g} s the error is still {error}; try a larger rtol,"
        " or end steps where controller or inputs jump"
    )
