"""Signals of real robots, made ready for identification: one cut-off frequency, zero phase, and a report of what went.

    1. even stamps    samples are interpolated linearly to the median interval; what falls into a gap does not count
    2. one filter     a Butterworth filter, forwards and backwards, is applied to positions and measurements alike: the
                      equations are (nearly) linear in both, so that neither lags behind the other
    3. derivatives    by central differences of the filtered positions, so that their noise ends at the cut-off
    4. what counts    not the ends, where the filter has no past; nor saturated samples and joints that stand still,
                      and what is within the filter's memory of a saturated sample
    5. fewer samples  as many as the cut-off leaves independent, four for each of its periods

Filtered noise depends on its past. The covariance of `identify` accounts for it from the residuals, so it is as wide as
without step 5, and no narrower for a higher rate.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import StateError
from holdfast.identification.recording import Recording
from holdfast.model import checks
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

ORDER = 4  # of the filter, in each direction
LONGEST_STEP = 5.0  # median intervals beyond which a gap is not bridged
MEMORY = 2.0  # periods of the cut-off after which the filter has forgotten
PER_PERIOD = 4.0  # samples that are kept for each period of the cut-off
SATURATED = 0.999  # of the limit
MEASURED = ("tau", "current", "wrist_wrench", "wrist_force")


@called
@dataclass(frozen=True, eq=False)
class SignalReport(Frozen):
    """What was done to a recording, and what of it does not count.

    Attributes:
        cutoff: frequency at which the filter leaves half of the power in each direction [Hz].
        interval: between the even stamps before samples were thinned out [s].
        uneven: largest interval as recorded, over the median one.
        samples: number of samples as recorded, and of those that are left.
        repeated: number of samples whose position is the same as before in every joint, as if the clock had run on.
        in_gaps: share of the samples that fell into gaps.
        at_ends: share at the ends.
        saturated: (n,) share of each joint's samples at or near its limit.
        standing: (n,) share of each joint's samples without motion.
    """

    cutoff: float
    interval: float
    uneven: float
    samples: tuple[int, int]
    repeated: int
    in_gaps: float
    at_ends: float
    saturated: Array
    standing: Array

    def __str__(self) -> str:
        """Return the report as text."""
        lines = [
            f"{self.samples[0]} samples, every {1e3 * self.interval:.3g} ms (up to {self.uneven:.3g} times that),"
            f" filtered at {self.cutoff:.3g} Hz: {self.samples[1]} are left",
            f"dropped: {100 * self.at_ends:.2g} % at the ends, {100 * self.in_gaps:.2g} % in gaps",
        ]
        if self.repeated:
            lines.append(f"{self.repeated} samples repeat the position before them in every joint")
        for name, shares in (("saturated", self.saturated), ("standing still", self.standing)):
            if shares.any():
                said = ", ".join(f"{100 * x:.2g} %" for x in shares.tolist())
                lines.append(f"not used as {name}, by joint: {said}")
        return "\n".join(lines)


def prepared(
    recording: Recording,
    cutoff: float = 10.0,
    *,
    limits: ArrayLike | None = None,
    standstill: float = 0.0,
) -> tuple[Recording, SignalReport]:
    """Return a recording with filtered signals, rates and accelerations, for `identify`, and a report.

    Filtered are q, tau, current, wrist_wrench and wrist_force; recorded qd and qdd are replaced by derivatives of q.
    Recorded motions of the object and of a base are refused, as the filter would bend them; the object's follows from
    rigid grasps. O(samples).

    Args:
        recording: the recording; its stamps may be uneven.
        cutoff: frequency above which nothing is believed [Hz]: well above that of the motion, below that of structural
            vibrations and of the noise of positions.
        limits: (n,) sizes of torques or currents at which the drives saturate; None for none.
        standstill: rate below which a joint stands still, where its friction is anything up to that of motion [rad/s or
            m/s]; 0 uses all samples.

    Raises:
        StateError: the recording is too short or too slowly sampled for the cut-off, or has a motion of object or base.
    """
    checks.instance(recording, Recording, "prepared: recording", StateError)
    cutoff = checks.number(cutoff, "prepared: cutoff", above=0.0)
    standstill = checks.number(standstill, "prepared: standstill", at_least=0.0)
    if given := [name for name in ("object_pose", "base_pose") if getattr(recording, name) is not None]:
        raise StateError(f"prepared: recording: expected joints and measurements only, got {given[0]}")
    t = recording.t
    if len(t) < 2:
        raise StateError(f"prepared: recording: expected two samples or more, got {len(t)}")
    steps = np.diff(t)
    interval = float(np.median(steps))
    if 2.0 * cutoff * interval >= 0.9:
        raise StateError(
            f"prepared: cutoff: expected below {0.45 / interval:.3g} Hz for samples every {1e3 * interval:.3g} ms, got"
            f" {cutoff:.3g}; try a lower cut-off, or no `prepared`: `identify` smooths by itself"
        )
    even = np.arange(t[0], t[-1] + 0.5 * interval, interval)
    settling = MEMORY / cutoff
    if even[-1] - even[0] < 3.0 * settling:
        raise StateError(
            f"prepared: recording: expected {3.0 * settling:.3g} s or more for {cutoff:.3g} Hz, got"
            f" {even[-1] - even[0]:.3g} s"
        )
    from scipy.signal import butter, sosfiltfilt  # imported here because it takes a second

    sos = butter(ORDER, cutoff, fs=1.0 / interval, output="sos")
    pad = min(len(even) - 2, int(2.0 * settling / interval))

    def filtered(values: Array) -> Array:
        flat = values.reshape(len(values), -1)
        evenly = np.column_stack([np.interp(even, t, column) for column in flat.T])
        return sosfiltfilt(sos, evenly, axis=0, padlen=pad).reshape(len(even), *values.shape[1:])

    made = {
        name: filtered(getattr(recording, name)) for name in ("q", *MEASURED) if getattr(recording, name) is not None
    }
    made["qd"] = np.gradient(made["q"], interval, axis=0)
    made["qdd"] = np.gradient(made["qd"], interval, axis=0)
    gap = (
        np.interp(even, 0.5 * (t[1:] + t[:-1]), steps) > LONGEST_STEP * interval
        if len(t) > 2
        else np.zeros(len(even), bool)
    )
    for a, b in zip(t[:-1][steps > LONGEST_STEP * interval], t[1:][steps > LONGEST_STEP * interval], strict=True):
        gap |= (even > a - settling) & (even < b + settling)
    end = (even < t[0] + settling) | (even > t[-1] - settling)
    saturated = _saturated(recording, limits, even, settling)
    standing = np.abs(made["qd"]) < standstill
    used = ~(saturated | standing)
    if recording.used is not None:
        used &= np.column_stack([np.interp(even, t, column) for column in recording.used.T]) > 0.999
    kept = ~(gap | end)
    every = max(int(1.0 / (PER_PERIOD * cutoff * interval)), 1)
    chosen = np.flatnonzero(kept)[::every]
    others = {f.name: None for f in fields(Recording) if f.name.startswith(("object_", "base_"))}
    found = replace(
        recording, **others, t=even[chosen], **{k: x[chosen] for k, x in made.items()}, used=used[chosen].astype(float)
    )
    still = (np.abs(np.diff(recording.q, axis=0)).max(axis=1) == 0.0).sum()
    report = SignalReport(
        cutoff=cutoff,
        interval=interval,
        uneven=float(steps.max()) / interval,
        samples=(len(t), len(chosen)),
        repeated=int(still),
        in_gaps=float(gap.mean()),
        at_ends=float(end.mean()),
        saturated=saturated[kept].mean(axis=0),
        standing=standing[kept].mean(axis=0),
    )
    return found, report


def _saturated(recording: Recording, limits: ArrayLike | None, even: Array, settling: float) -> Array:
    """Return where drives are at their limits, or were within the memory of the filter, (samples, n)."""
    n = recording.q.shape[1]
    found = np.zeros((len(even), n), bool)
    if limits is None:
        return found
    highest = checks.numbers(limits, (n,), "prepared: limits")
    measured = recording.tau if recording.tau is not None else recording.current
    if measured is None:
        raise StateError("prepared: limits: expected a recording of torques or currents with them, got neither")
    for joint, column in enumerate(np.abs(measured).T):
        times = recording.t[column >= SATURATED * highest[joint]]
        if len(times):
            nearest = np.abs(
                even[:, None] - times[np.clip(np.searchsorted(times, even)[:, None] + [-1, 0], 0, len(times) - 1)]
            )
            found[:, joint] = nearest.min(axis=1) < settling
    return found
