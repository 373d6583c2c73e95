"""How far two records of one run are apart, field by field, and which of its bars that breaks.

Fixed steps: arrays to 1e-11 of max(1, their size in the run) up to the first event, and to 1e-9 after it. Adaptive
steps: to 10 times the tolerance. Instants to 1e-9 s. Words of occurrences, ends and errors are the same; numbers in
them to 1e-6, or to their last printed digit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

BEFORE, AFTER, ADAPTIVE, INSTANTS, IN_WORDS = 1e-11, 1e-9, 10.0, 1e-9, 1e-6
NOTHING = 1e-9  # numbers in texts that are smaller are rounding errors
# arrays of what happened since the sample before, which is another one if an adaptive run takes other steps
SINCE_LAST = ("lowest_margin", "lowest_margin_time", "lowest_joint_margin", "lowest_joint_margin_time", "lowest_joint")
NUMBER = re.compile(r"(?<![A-Za-z_\d.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

Record = dict[str, Any]  # a run as plain data, see `against.recorded`


@dataclass
class Difference:
    """What two records of a run differ by.

    Attributes:
        before, after: largest difference of fixed steps up to the first event and after it, over max(1, size).
        adaptive: largest difference of adaptive steps, over the tolerance.
        instants: largest difference of the times of samples and occurrences [s].
        failures: what is beyond its bar, in words.
    """

    before: float = 0.0
    after: float = 0.0
    adaptive: float = 0.0
    instants: float = 0.0
    failures: list[str] = field(default_factory=list)


def differences(old: Record, new: Record) -> Difference:
    """Return what two records of the same run differ by."""
    found = Difference()
    for what in ("error", "stopped"):
        _compare_words(found, what, old[what], new[what])
    _compare_occurrences(found, old["occurrences"], new["occurrences"])
    if old["arrays"] and new["arrays"]:
        _compare_arrays(found, old, new)
    return found


def _compare_occurrences(found: Difference, old: list[Record], new: list[Record]) -> None:
    kinds = [[f"{one['kind']} {one['name']}" for one in log] for log in (old, new)]
    if kinds[0] != kinds[1]:
        found.failures.append(f"occurrences: {', '.join(kinds[0]) or 'none'} became {', '.join(kinds[1]) or 'none'}")
        return
    for a, b in zip(old, new, strict=True):
        what = f"{a['kind']} of {a['name']} at {a['t']:.9g} s"
        apart = abs(a["t"] - b["t"])
        found.instants = max(found.instants, apart)
        if apart > INSTANTS:
            found.failures.append(f"{what}: {apart:.2g} s apart")
        for name in a:
            if name != "t":
                _compare_words(found, f"{what}: {name}", a[name], b[name])


def _compare_words(found: Difference, what: str, old: Any, new: Any) -> None:
    """Compare texts, or anything printed: words exactly, numbers nearly."""
    a, b = str(old), str(new)
    same = NUMBER.sub("#", a) == NUMBER.sub("#", b)
    pairs = zip(NUMBER.findall(a), NUMBER.findall(b), strict=False)
    if not same or not all(_nearly(x, y) for x, y in pairs):
        found.failures.append(f"{what}: {a!r} became {b!r}")


def _nearly(x: str, y: str) -> bool:
    """Whether two printed numbers are the same but for rounding."""
    a, b = float(x), float(y)
    allowed = max(IN_WORDS * max(abs(a), abs(b)), 1.01 * max(_last_digit(x), _last_digit(y)) * ("." in x + y))
    return abs(a - b) <= allowed or max(abs(a), abs(b)) < NOTHING


def _last_digit(text: str) -> float:
    """Return the value of one unit in the last digit of a printed number."""
    digits, _, exponent = text.partition("e")
    return 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


def _compare_arrays(found: Difference, old: Record, new: Record) -> None:
    ours, theirs = old["arrays"]["t"], new["arrays"]["t"]
    rows, same = np.arange(len(ours)), len(ours) == len(theirs)
    if old["tolerance"] and not same:  # the samples that both have
        rows = np.flatnonzero([np.abs(theirs - t).min(initial=np.inf) <= INSTANTS for t in ours])
        if not len(rows):
            found.failures.append("no sample in common")
            return
        there = np.array([np.abs(theirs - ours[k]).argmin() for k in rows])
    elif not same:
        found.failures.append(f"{len(ours)} samples became {len(theirs)}")
        return
    else:
        there = rows
    apart = float(np.abs(ours[rows] - theirs[there]).max(initial=0.0))
    found.instants = max(found.instants, apart)
    if apart > INSTANTS:
        found.failures.append(f"samples {apart:.2g} s apart")
    events = [one["t"] for one in (*old["occurrences"], *new["occurrences"]) if one["kind"] != "unresolved"]
    early = ours[rows] < min(events, default=np.inf) - INSTANTS
    for name in sorted({*old["arrays"]} - {"t"}):
        if not same and name in SINCE_LAST:
            continue
        a, b = old["arrays"][name], new["arrays"].get(name)
        if b is None or a.shape[1:] != b.shape[1:] or a.dtype.kind != b.dtype.kind:
            found.failures.append(f"{name}: {_shape(a)} became {_shape(b)}")
            continue
        _compare_array(found, name, a[rows], b[there], early, old["tolerance"])


def _shape(x: Any) -> str:
    return "nothing" if x is None else f"{x.dtype} {x.shape}"


def _compare_array(found: Difference, name: str, a: Any, b: Any, early: Any, tolerance: float) -> None:
    """Compare one array at the same samples."""
    if not a.size:
        return
    a, b = (x.reshape(len(x), -1).astype(float) for x in (a, b))
    finite = np.isfinite(a) & np.isfinite(b)
    with np.errstate(invalid="ignore"):
        apart = np.where(finite, np.abs(a - b), np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, np.inf))
    size = max(1.0, float(np.abs(a[finite]).max(initial=0.0)))
    worst = apart.max(axis=1, initial=0.0) / size
    if tolerance:
        parts = [("adaptive", worst / tolerance, ADAPTIVE)]
    else:
        parts = [("before", np.where(early, worst, 0.0), BEFORE), ("after", np.where(early, 0.0, worst), AFTER)]
    for part, here, bar in parts:
        largest = float(here.max(initial=0.0))
        setattr(found, part, max(getattr(found, part), largest))
        if largest > bar:
            k = int(here.argmax())
            found.failures.append(f"{name}: {largest:.2g} {part}, at sample {k}, beyond {bar:g}")
