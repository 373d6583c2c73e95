"""Whether the steps of a run follow the motion.

A gain, damper or spring that is too fast for the step makes velocities grow from step to step, or decay far too slowly,
long before anything overflows. They then change by something else than the mean of the accelerations at both ends,

    | v(t + h) - v(t) - h (a(t) + a(t + h)) / 2 |  >  1 % of the largest velocity so far,

while a smooth motion differs in the third order of h only. The step is then repeated in halves: a rate that it does not
follow makes both differ.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, array, maximum, select, where

OF_MOTION = 0.01  # smallest difference of velocities that counts, relative to the largest velocity so far
IGNORED_RATE = 1e-4  # rad/s or m/s: smaller differences never count
MOST_UNRESOLVED = 8  # steps in a row, after which one is repeated in halves again


class Resolution(NamedTuple):
    """What is known of a run whose steps have a fixed length.

    Attributes:
        largest: largest velocity of a joint or the object so far [rad/s or m/s].
        in_a_row: number of steps to the present instant that seem unresolved.
        seen: largest gap between the change of velocities and the mean accelerations so far [rad/s or m/s].
        off: largest difference between a step and its halves [rad/s or m/s].
        text: what it was and what to try; "" if nothing was noticed.
    """

    largest: float = 0.0
    in_a_row: int = 0
    seen: float = 0.0
    off: float = 0.0
    text: str = ""

    @property
    def matters(self) -> bool:
        """Whether the largest difference is more than one per cent of the motion."""
        return self.off > least_difference(self.largest)


NOTHING_NOTICED = Resolution()


def least_difference(largest: Any) -> Any:
    """Return the smallest difference of velocities that counts beside the largest velocity so far [rad/s or m/s]."""
    return OF_MOTION * largest + IGNORED_RATE


def largest_of(x: Array) -> Any:
    """Return the largest magnitude along the last axis; of traced numbers, which have one axis, a scalar."""
    return reduce(maximum, [abs(entry) for entry in x]) if x.dtype == object else np.abs(x).max(axis=-1)


def leap(h: Any, v0: Array, v1: Array, a0: Array, a1: Array) -> Any:
    """Return by how much velocities change otherwise than by the mean of the accelerations [rad/s or m/s].

    Args:
        h: length of the step, or (..., 1) of several steps [s].
        v0: velocities at its start, (..., n + 6); a floating base adds six.
        v1: velocities at its end.
        a0: accelerations at its start.
        a1: accelerations at its end.
    """
    return largest_of(v1 - v0 - 0.5 * h * (a0 + a1))


def asked(last: Array, fastest: Scalar, gap: Scalar, taken: Scalar) -> tuple[Scalar, Array]:
    """Return whether a step must wait until it has been compared with its halves, and a `Resolution` after it, (4,).

    The gap that was seen lets the same step pass the next time.

    Args:
        last: the numbers of the `Resolution` before the step, (4,).
        fastest: the largest velocity at its end [rad/s or m/s].
        gap: its `leap` [rad/s or m/s].
        taken: whether the step is taken as far as everything else is concerned.
    """
    largest, in_a_row, seen, off = last
    largest = maximum(largest, fastest)
    in_a_row = where(gap > least_difference(largest), in_a_row + 1.0, 0.0)
    doubtful = where(gap > 2.0 * seen, 1.0, where(in_a_row >= float(MOST_UNRESOLVED), 1.0, 0.0))
    waits = where(taken, where(in_a_row > 0.5, doubtful, 0.0), 0.0) > 0.5
    found = select(taken, array([largest, in_a_row, seen, off]), last)
    return waits, select(waits, array([last[0], 0.0, maximum(seen, gap), off]), found)
