"""What is likely to be wrong with a recording: units, signs, swapped columns, channels that were not recorded.

Recordings with numbers that are not finite, repeated stamps or other lengths are refused by `Recording`. What is left
looks like a recording, and is told by what the model needs: torques that are its own with the other sign, or those of
another joint. Each suspicion is a sentence that names the column.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

DEGREES = 180.0 / np.pi
BEYOND_LIMITS = 0.2  # rad beyond a joint's limits, or a turn, from which positions are hardly radians
SAME_SIGNAL, ANOTHER_SIGNAL = 0.9, 0.5  # correlations of columns that are the same, and of those that are not
THOUSANDS = 100.0  # ratio of sizes above which units differ
RATE_ERROR = 0.2  # relative error of a ratio of rates that is one by mistaken units or signs
LARGEST_TURN = 4.0 * np.pi  # largest position of a joint without limits that is expected


def suspicions(chain: ClosedChain, recordings: Sequence[Recording], by: str, y: Array, needed: Array) -> list[str]:
    """Return sentences about columns that are likely to be wrong.

    Args:
        chain: the model.
        recordings: the recordings.
        by: what is measured at joints.
        y: (samples, n) measurements.
        needed: (samples, n) what the model would measure.
    """
    names, found = chain.joint_names(), []
    q = np.concatenate([one.q for one in recordings])
    for joint, (name, (low, high)) in enumerate(zip(names, chain.position_limits.tolist(), strict=True)):
        if not chain.all_joints[joint].turns:
            continue
        low, high = max(low, -LARGEST_TURN), min(high, LARGEST_TURN)
        if np.abs(q[:, joint] - np.clip(q[:, joint], low, high)).max() > BEYOND_LIMITS:
            within = np.abs(q[:, joint]).max() / DEGREES < max(-low, high) + BEYOND_LIMITS
            unit = "; most likely they are degrees" if within and np.abs(q[:, joint]).max() > LARGEST_TURN else ""
            found.append(f"q of '{name}' goes up to {np.abs(q[:, joint]).max():.3g} rad, beyond its limits{unit}")
    found += _of_rates(names, recordings)
    return found + _of_torques(names, by, y, needed)


def _of_rates(names: list[str], recordings: Sequence[Recording]) -> list[str]:
    """Return what is wrong with recorded rates, by differences of the positions."""
    found = []
    for one in recordings:
        if one.qd is None or len(one) < 3:
            continue
        true = np.gradient(one.q, one.t, axis=0)
        for name, given, rate in zip(names, one.qd.T, true.T, strict=True):
            if not rate.any() or abs(np.corrcoef(given, rate)[0, 1] if given.any() else 0.0) < SAME_SIGNAL:
                continue
            ratio = float(given @ rate / (rate @ rate))
            for factor, cause in ((DEGREES, "degrees per second"), (-1.0, "of the opposite sign")):
                if abs(ratio / factor - 1.0) < RATE_ERROR:
                    found.append(f"qd of '{name}' is {ratio:.3g} times the rate of q; most likely it is {cause}")
    return found


def _of_torques(names: list[str], by: str, y: Array, needed: Array) -> list[str]:
    """Return what is wrong with torques or currents, by what the model needs."""
    varying, moved = y.std(axis=0), needed.std(axis=0)
    found = [
        f"{by} of '{name}' is always {y[0, k]:.3g}; most likely it was not recorded"
        for k, name in enumerate(names)
        if varying[k] == 0.0 and moved[k] > 0.0
    ]
    told = (varying > 0.0) & (moved > 0.01 * moved.max())
    n = len(names)
    R = np.zeros((n, n))  # of what joint j needs and what column k has
    both = np.flatnonzero(told)
    R[np.ix_(both, both)] = np.corrcoef(needed[:, both].T, y[:, both].T)[: len(both), len(both) :]
    for j in both.tolist():
        for k in [k for k in both.tolist() if k > j and R[j, k] > SAME_SIGNAL and R[k, j] > SAME_SIGNAL]:
            if max(R[j, j], R[k, k]) < ANOTHER_SIGNAL:
                found.append(f"{by} of '{names[j]}' and '{names[k]}' are most likely swapped")
        if R[j, j] < -SAME_SIGNAL:
            found.append(f"{by} of '{names[j]}' has most likely the opposite sign")
        ratio = float(varying[j] / moved[j])
        if by == "tau" and not 1.0 / THOUSANDS < ratio < THOUSANDS:
            found.append(f"tau of '{names[j]}' is {ratio:.2g} times what the model needs; most likely it is not in N m")
    return found
