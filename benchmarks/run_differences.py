"""How far two records of one run are apart, field by field, and which of its bars that breaks.

Fixed steps: arrays to 1e-11 of max(1, their size in the run) up to the first event, and to 1e-9 after it. Adaptive
steps: to 10 times the tolerance, at samples that both have. Instants to 1e-9 s, those of adaptive steps to 10 times the
tolerance. Words of occurrences, ends and errors are the same; numbers in them to 1e-6, or to their last printed digit.

Not everything is determined that well: forces near a singular configuration, the time at which a flat margin is lowest,
the sign of a direction. What exceeds its bar is therefore held against what rounding does to the same run.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

BEFORE, AFTER, ADAPTIVE, INSTANTS, IN_WORDS = 1e-11, 1e-9, 10.0, 1e-9, 1e-6
ILL_CONDITIONED = 100.0  # times what rounding alone does, where that exceeds the bar
NOTHING = 1e-9  # numbers in texts that are smaller are rounding errors
# arrays of what happened since the sample before, which is another one if an adaptive run takes other steps
SINCE_LAST = ("lowest_margin", "lowest_margin_time", "lowest_joint_margin", "lowest_joint_margin_time", "lowest_joint")
NUMBER = re.compile(r"(?<![A-Za-z_\d.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

Record = dict[str, Any]  # a run as plain data, see `against.recorded`


@dataclass
class Difference:
    """What two records of a run differ by.

    Attributes:
        measured: how far things are apart, by the measure and their name: "before" and "after" the first event, for
            fixed steps, over max(1, size); "adaptive", over the tolerance; "instants" [s]; "words", 1 if they differ.
        failures: what is beyond its bar, in words, by the same.
    """

    measured: dict[tuple[str, str], float] = field(default_factory=dict)
    failures: dict[tuple[str, str], str] = field(default_factory=dict)

    def measure(self, how: str, what: str, apart: float, bar: float, text: str = "") -> None:
        """Note how far something is apart, and whether that is beyond its bar."""
        self.measured[how, what] = apart
        if apart > bar:
            self.failures[how, what] = f"{what}: {apart:.2g} apart ({how}), beyond {bar:g}{text}"

    def words(self, what: str, text: str) -> None:
        """Note that something is not the same."""
        self.measured["words", what] = 1.0
        self.failures["words", what] = f"{what}: {text}"

    def explained(self, rounding: Sequence[Difference]) -> set[tuple[str, str]]:
        """Return which failures are explained by rounding.

        Args:
            rounding: differences between the earlier version's run and runs of it from the same state but for rounding.
        """
        alone = {key: max((one.measured.get(key, 0.0) for one in rounding), default=0.0) for key in self.failures}
        return {key for key, apart in alone.items() if self.measured[key] <= ILL_CONDITIONED * apart}

    def worst(self, how: str, but: set[tuple[str, str]]) -> float:
        """Return the largest of one measure, apart from some things."""
        return max((x for key, x in self.measured.items() if key[0] == how and key not in but), default=0.0)


def differences(old: Record, new: Record) -> Difference:
    """Return what two records of the same run differ by."""
    found = Difference()
    for what in ("error", "stopped"):
        _compare_words(found, what, old[what], new[what])
    instants = max(INSTANTS, ADAPTIVE * old["tolerance"])
    _compare_occurrences(found, old["occurrences"], new["occurrences"], instants)
    if old["arrays"] and new["arrays"]:
        _compare_arrays(found, old, new)
    return found


def _compare_occurrences(found: Difference, old: list[Record], new: list[Record], instants: float) -> None:
    kinds = [[f"{one['kind']} {one['name']}" for one in log] for log in (old, new)]
    if kinds[0] != kinds[1]:
        found.words("occurrences", f"{', '.join(kinds[0]) or 'none'} became {', '.join(kinds[1]) or 'none'}")
        return
    for k, (a, b) in enumerate(zip(old, new, strict=True), start=1):
        what = f"occurrence {k}, {a['kind']} of {a['name']}"
        found.measure("instants", what, abs(a["t"] - b["t"]), instants, f" at {a['t']:.9g} s")
        for name in a:
            if name != "t":
                _compare_words(found, f"{what}, {name}", a[name], b[name])


def _compare_words(found: Difference, what: str, old: Any, new: Any) -> None:
    """Compare texts, or anything printed: words exactly, numbers nearly."""
    a, b = str(old), str(new)
    same = NUMBER.sub("#", a) == NUMBER.sub("#", b)
    pairs = zip(NUMBER.findall(a), NUMBER.findall(b), strict=False)
    if not same or not all(_nearly(x, y) for x, y in pairs):
        found.words(what, f"{a!r} became {b!r}")


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
    same = len(ours) == len(theirs)
    if old["tolerance"]:  # the samples that both have
        same = same and bool(np.abs(ours - theirs).max(initial=0.0) <= INSTANTS)
        near = np.abs(ours[:, None] - theirs)
        rows = np.flatnonzero(near.min(axis=1, initial=np.inf) <= INSTANTS)
        there = near[rows].argmin(axis=1) if len(rows) else rows
        if not len(rows) and len(ours):
            found.words("samples", "none in common")
    elif not same:
        found.words("samples", f"{len(ours)} became {len(theirs)}")
        return
    else:
        rows = there = np.arange(len(ours))
    found.measure("instants", "samples", float(np.abs(ours[rows] - theirs[there]).max(initial=0.0)), INSTANTS)
    events = [one["t"] for one in (*old["occurrences"], *new["occurrences"]) if one["kind"] != "unresolved"]
    early = ours[rows] < min(events, default=np.inf) - INSTANTS
    for name in sorted({*old["arrays"]} - {"t"}):
        if not same and name in SINCE_LAST:
            continue
        a, b = old["arrays"][name], new["arrays"].get(name)
        if b is None or a.shape[1:] != b.shape[1:] or a.dtype.kind != b.dtype.kind:
            found.words(name, f"{_shape(a)} became {_shape(b)}")
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
    for how, here, bar in parts:
        found.measure(how, name, float(here.max(initial=0.0)), bar, f", at sample {int(here.argmax())}")
