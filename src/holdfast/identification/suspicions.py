"""What is likely to be wrong with a recording: units, signs, swapped columns, channels that were not recorded.

Recordings with numbers that are not finite, repeated stamps or other lengths are refused by `Recording`. What is left
looks like a recording, and is told by what the model needs: torques that are its own with the other sign, or those of
another joint. Where model and recording disagree, each likely mistake is undone in turn, and the one that makes them
agree best is named. Each suspicion is a sentence that names the column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from holdfast.identification.machine.unknowns import MachineUnknowns
from holdfast.identification.recording import Recording
from holdfast.identification.rows import ON_DRIVES, RecordedRows
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.joint_friction import friction_torque
from holdfast.spatial.scalar import Array

DEGREES = 180.0 / np.pi
BEYOND_LIMITS = 0.2  # rad beyond a joint's limits, or a turn, from which positions are hardly radians
SAME_SIGNAL, ANOTHER_SIGNAL = 0.9, 0.5  # correlations of columns that are the same, and of those that are not
FAR_LESS_LIKE, EXACT_RATES = 10.0, 1e-4  # ratio of 1 - correlation^2 of two columns with a signal; least such size
STILL_POSITION = 1e-6  # deviation [rad or m] up to which a joint stands, so that its torque may be constant
TIMES = 5.0  # ratio of sizes above which units differ
RATE_ERROR = 0.2  # relative error of a ratio of rates that is one by mistaken units or signs
LARGEST_TURN = 4.0 * np.pi  # largest position of a joint without limits that is expected
SURE_OF_RATIO, WELL_CONDITIONED = 0.05, 1e3  # relative deviation of a ratio of torques, and its equations
BRAKES = 0.02  # power of friction, relative to the most that the torque may have, above which it brakes
RATE_UNITS = {
    DEGREES: "qd of '{}' is in degrees per second",
    30.0 / np.pi: "qd of '{}' is in revolutions per minute",
    1.0 / DEGREES: "q of '{}' is in degrees",
    -1.0: "qd of '{}' has the opposite sign",
    1e3: "the times are in milliseconds",
    1e6: "the times are in microseconds",
    1e9: "the times are in nanoseconds",
    1e-3: "the times are in seconds, not milliseconds",
}  # by the ratio of recorded rates to those of the positions
LONGEST_INTERVAL = 1.0  # s between samples, above which times are hardly seconds
FASTEST = 30.0  # rad/s, or five times a joint's limit, above which no joint turns
DISAGREE, MUCH_BETTER = 0.3, 0.4  # squared residual of the model, relative to its size or to that of another guess
JUDGED = 60  # samples by which guesses are compared
GUESSES_AT_ONCE = 30  # that machine code evaluates together


Needs = Callable[[Sequence[Recording]], RecordedRows]


def suspicions(
    chain: ClosedChain, recordings: Sequence[Recording], unknowns: MachineUnknowns, rows: RecordedRows, needs: Needs
) -> list[str]:
    """Return sentences about columns that are likely to be wrong. O(n^2) evaluations of the model if it disagrees.

    Args:
        chain: the model.
        recordings: the recordings, with rates and accelerations.
        unknowns: the unknowns, with the model's values.
        rows: the equations of the recordings.
        needs: returns the equations of other recordings.
    """
    by = unknowns.by
    names = chain.joint_names()
    found = suspicions_of_motion(chain, recordings)
    if by not in ON_DRIVES:
        return found
    needed, y = _needed(rows, unknowns)[0], rows.y
    moving = np.concatenate([one.q for one in recordings]).std(axis=0) > STILL_POSITION
    found += [
        f"{by} of '{name}' is always {y[0, k]:.3g}; most likely it was not recorded"
        for k, name in enumerate(names)
        if np.ptp(y[:, k]) == 0.0 and moving[k] and len(y) > 1
    ]
    if needed.shape != y.shape:
        return found or _guesses(names, recordings, unknowns, needs)
    rates = np.concatenate([np.asarray(one.qd) for one in recordings])
    torques = _of_torques(names, by, y, needed, rates if len(rates) == len(y) else None)
    return found + torques if found or torques else _guesses(names, recordings, unknowns, needs)


def suspicions_of_motion(chain: ClosedChain, recordings: Sequence[Recording]) -> list[str]:
    """Return sentences about times, positions and rates that are likely to be wrong, whatever was measured."""
    names = chain.joint_names()
    return [*_of_times(recordings), *_of_positions(chain, names, recordings), *_of_rates(names, recordings)]


def _of_times(recordings: Sequence[Recording]) -> list[str]:
    """Return whether stamps are in another unit, by how far they are apart."""
    steps = [float(np.median(np.diff(one.t))) for one in recordings if len(one) > 1]
    if not steps or max(steps) < LONGEST_INTERVAL:
        return []
    return [f"t: samples are {max(steps):.3g} s apart; most likely the stamps are in milliseconds or less, not seconds"]


def _of_positions(chain: ClosedChain, names: list[str], recordings: Sequence[Recording]) -> list[str]:
    """Return what is wrong with positions, by their limits, and whether they change at all."""
    q, found = np.concatenate([one.q for one in recordings]), list[str]()
    still = np.ptp(q, axis=0) == 0.0  # a mean of equal numbers rounds, so that their deviation need not be 0
    for joint, name in enumerate(names):
        rates = [one.qd[:, joint] for one in recordings if one.qd is not None]
        if still[joint] and not still.all() and (still.sum() == 1 < len(names) - 1 or any(np.any(x) for x in rates)):
            found.append(f"q of '{name}' never changes, while others do; most likely it was not recorded")
        if not chain.all_joints[joint].turns:
            continue
        limit = chain.all_joints[joint].rate_limit
        fastest = max(FASTEST, 5.0 * limit if np.isfinite(limit) else 0.0)
        fast = max(
            (float(np.quantile(np.abs(np.diff(one.q[:, joint]) / np.diff(one.t)), 0.9)) for one in recordings
             if len(one) > 2),
            default=0.0,
        )  # fmt: skip
        if fast > fastest:
            found.append(f"q of '{name}' turns by {fast:.3g} rad/s; units of the times or of q?")
    return [*positions_beyond_limits(chain, q), *found]


def positions_beyond_limits(chain: ClosedChain, q: Array) -> list[str]:
    """Return which joints turn beyond their limits in positions (samples, ...), and whether these are degrees."""
    found, column = list[str](), 0
    for joint, name in zip(chain.all_joints, chain.joint_names(), strict=True):
        x = q[np.isfinite(q[:, column]), column]
        column += joint.type.position_count
        if not joint.turns or joint.type.position_count > 1 or not len(x):
            continue
        low, high = np.clip(joint.position_limits, -LARGEST_TURN, LARGEST_TURN).tolist()
        largest = float(np.abs(x).max())
        if np.abs(x - np.clip(x, low, high)).max() > BEYOND_LIMITS:
            within = largest / DEGREES < max(-low, high) + BEYOND_LIMITS
            unit = "; most likely they are degrees" if within and largest > LARGEST_TURN else ""
            unit = unit or "; units, sign or another joint's column?"
            found.append(f"q of '{name}' goes up to {largest:.3g} rad, beyond its limits{unit}")
    return found


def _of_rates(names: list[str], recordings: Sequence[Recording]) -> list[str]:
    """Return what is wrong with recorded rates, by differences of the positions."""
    found = list[str]()
    for one in recordings:
        if one.qd is None or len(one) < 3:
            continue
        true = np.gradient(one.q, one.t, axis=0)
        n, moved = len(names), (true.std(axis=0) > 0.0) & (one.qd.std(axis=0) > 0.0)
        R = np.zeros((n, n))
        both = np.flatnonzero(moved)
        if len(both):
            R[np.ix_(both, both)] = np.atleast_2d(np.corrcoef(one.qd[:, both].T, true[:, both].T))[
                : len(both), len(both) :
            ]
        for j in both.tolist():
            k, unlike = int(np.argmax(np.abs(R[j]))), 1.0 - R[j] ** 2
            far = abs(R[j, j]) < ANOTHER_SIGNAL or unlike[j] > FAR_LESS_LIKE * max(unlike[k], EXACT_RATES)
            if k != j and abs(R[j, k]) > SAME_SIGNAL and far:
                found.append(f"qd of '{names[j]}' is the rate of '{names[k]}'; most likely columns are swapped")
            if abs(R[j, j]) < SAME_SIGNAL:
                continue
            ratio = float(one.qd[:, j] @ true[:, j] / (true[:, j] @ true[:, j]))
            for factor, cause in RATE_UNITS.items():
                if abs(ratio / factor - 1.0) < RATE_ERROR:
                    found.append(
                        f"qd of '{names[j]}' is {ratio:.3g} times the rate of q; most likely {cause.format(names[j])}"
                    )
        found += [
            f"qd of '{names[j]}' is always {one.qd[0, j]:.3g} although q changes; most likely it was not recorded"
            for j in np.flatnonzero((np.ptp(one.qd, axis=0) == 0.0) & (one.q.std(axis=0) > STILL_POSITION)).tolist()
        ]
    return found


def _of_torques(names: list[str], by: str, y: Array, needed: Array, rates: Array | None) -> list[str]:
    """Return what is wrong with torques or currents, by what the model needs."""
    found, varying, moved = list[str](), y.std(axis=0), needed.std(axis=0)
    told = (varying > 0.0) & (moved > 0.01 * moved.max())
    n = len(names)
    R = np.zeros((n, n))  # of what joint j needs and what column k has
    both = np.flatnonzero(told)
    if not len(both):
        return found
    R[np.ix_(both, both)] = np.corrcoef(needed[:, both].T, y[:, both].T)[: len(both), len(both) :]
    for j in both.tolist():
        for k in [k for k in both.tolist() if k > j and R[j, k] > SAME_SIGNAL and R[k, j] > SAME_SIGNAL]:
            if max(R[j, j], R[k, k]) < ANOTHER_SIGNAL:
                found.append(f"{by} of '{names[j]}' and '{names[k]}' are most likely swapped")
        beside = None if rates is None else _beside_friction(y[:, j], needed[:, j], rates[:, j])
        if R[j, j] < -SAME_SIGNAL or (beside is not None and -TIMES < beside < -1.0 / TIMES):
            found.append(f"{by} of '{names[j]}' has most likely the opposite sign")
        if by != "tau":
            continue
        ratio, sure = float(varying[j] / moved[j]), bool(R[j, j] > SAME_SIGNAL)
        if beside is not None:
            ratio, sure = beside, beside > 0.0
        if sure and not 1.0 / TIMES < ratio < TIMES:
            found.append(f"tau of '{names[j]}' is {ratio:.2g} times what the model needs; most likely it is not in N m")
    return found


def _beside_friction(y: Array, needed: Array, rate: Array) -> float | None:
    """Return how many times what a model needs a torque is, beside damping, friction and an offset; None if unsure.

    A negative ratio is unsure if the friction beside it brakes: that of a torque with the opposite sign drives.
    """
    A = np.column_stack([needed, rate, friction_torque(np.ones(len(rate)), rate), np.ones(len(rate))])
    sizes = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    if len(y) <= 2 * A.shape[1] or np.linalg.cond(A / sizes) > WELL_CONDITIONED:
        return None
    c = np.linalg.lstsq(A / sizes, y, rcond=None)[0] / sizes
    left = y - A @ c
    variance = float(left @ left) / (len(y) - A.shape[1]) * np.linalg.inv((A / sizes).T @ (A / sizes))[0, 0]
    unsure = np.sqrt(variance) / sizes[0] >= SURE_OF_RATIO * abs(c[0])
    brakes = float(A[:, 1:3] @ c[1:3] @ rate) > BRAKES * float(np.linalg.norm(y) * np.linalg.norm(rate))
    return None if unsure or (c[0] < 0.0 and brakes) else float(c[0])


def _needed(rows: RecordedRows, unknowns: MachineUnknowns) -> tuple[Array, Array]:
    """Return what rows need at the model's values, and what they have by the measurements, (samples, rows) each."""
    needed = rows.A @ unknowns.x(unknowns.start)[0] + rows.b
    return needed, np.einsum("src,sc->sr", rows.P, rows.y * unknowns.gain(unknowns.start, rows.y.shape[1]))


def _guesses(names: list[str], recordings: Sequence[Recording], unknowns: MachineUnknowns, needs: Needs) -> list[str]:
    """Return the mistake which, if it is undone, makes model and recording agree far better; none if they agree."""
    every, by = max(1, sum(map(len, recordings)) // JUDGED), unknowns.by
    few = [one.part(slice(None, None, every)) for one in recordings]
    needed, had = _needed(needs(few), unknowns)
    samples, square = len(had), had.shape[1] == len(names)
    sizes = np.maximum(had.std(axis=0), 1e-12) ** -2.0 if square else np.ones(had.shape[1])
    whole = float(((had - had.mean(axis=0)) ** 2 @ sizes).sum())
    here = float(((needed - had) ** 2 @ sizes).sum())
    if here < DISAGREE * whole or not whole > 0.0:
        return []
    best, said = MUCH_BETTER * here, ""
    guesses = iter(_undone(names, few, by))
    while group := list(islice(guesses, GUESSES_AT_ONCE)):
        rows = needs([one for _, changed in group for one in changed])
        needed, had = _needed(rows, unknowns)
        if needed.shape[1] != len(sizes):
            continue
        kept = np.array([int(one.sum()) for one in rows.kept]).reshape(len(group), -1).sum(axis=1)
        squares = np.split((needed - had) ** 2 @ sizes, np.cumsum(kept)[:-1])
        for (title, _), of_guess in zip(group, squares, strict=True):
            if len(of_guess) == samples and (found := float(of_guess.sum())) < best:
                best, said = found, title
    return [f"{said}: the residual of the model falls to {np.sqrt(best / here):.2g} times as much"] if said else []


def _undone(names: list[str], recordings: Sequence[Recording], by: str) -> Iterator[tuple[str, list[Recording]]]:
    """Yield what may have gone wrong, and the recordings without it."""
    n, arrays_of = len(names), {by: (by,), "q": ("q", "qd", "qdd")}
    for what, arrays in arrays_of.items():
        for j, name in enumerate(names):
            signs, same = np.where(np.arange(n) == j, -1.0, 1.0), np.arange(n)
            yield f"{what} of '{name}' has most likely the opposite sign", _changed(recordings, arrays, same, signs)
            for k in range(j + 1, n):
                order = same.copy()
                order[[j, k]] = k, j
                title = f"{what} of '{name}' and '{names[k]}' are most likely swapped"
                yield title, _changed(recordings, arrays, order, np.ones(n))


def _changed(recordings: Sequence[Recording], names: Sequence[str], order: Array, signs: Array) -> list[Recording]:
    """Return recordings with columns in another order, with signs, without the object's motion, which follows."""
    others: dict[str, Any] = dict.fromkeys(("object_pose", "object_twist", "object_acceleration"))
    return [
        replace(one, **others, **{name: getattr(one, name)[:, order] * signs for name in names}) for one in recordings
    ]
