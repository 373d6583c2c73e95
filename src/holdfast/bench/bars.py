"""What the benchmark has to show, and whether it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from holdfast.bench.entry import ACCURATE
from holdfast.bench.own_entries import BIND, BIND_COPYING, PUBLIC

Document = dict[str, Any]
Record = dict[str, Any]
Finding = tuple[float | None, str]  # the value, and what it was compared with
CHOLESKY = "constraintDynamics, free"
NOT_MEASURED: Finding = (None, "not measured in this run")


@dataclass(frozen=True)
class Bar:
    """One promise.

    Attributes:
        what: in words.
        at_least: whether the value must reach the goal, or stay below it.
        goal: the number.
        value: reads it from the document, with a note.
    """

    what: str
    at_least: bool
    goal: float
    value: Callable[[Document], Finding]


def bars(document: Document) -> list[dict[str, Any]]:
    """Return every bar with its goal, value (None: not measured), whether it is met, and a note."""
    found = []
    for bar in BARS:
        value, note = bar.value(document)
        met = None if value is None else (value >= bar.goal if bar.at_least else value <= bar.goal)
        sense = ">=" if bar.at_least else "<="
        found.append({"what": bar.what, "sense": sense, "goal": bar.goal, "value": value, "met": met, "note": note})
    return found


def fastest(record: Record, library: str, method: str = "") -> Record | None:
    """Return a library's fastest accurate entry; if none is accurate the fastest of all; None without any.

    Fastest by the ratio to ours: it comes from the same rounds, so others on the machine move it less than the times.

    Args:
        record: of a system.
        library: whose entries.
        method: what their names begin with.
    """
    ways = [e for e in record["entries"] if e["library"] == library and e["name"].startswith(method) and not e["floor"]]
    accurate = [entry for entry in ways if entry["accurate"]]
    return min(accurate or ways, key=lambda entry: entry["ratios"][PUBLIC], default=None)


def _ratio(system: str, library: str, method: str = "", ours: str = PUBLIC) -> Callable[[Document], Finding]:
    """Return a reader of: a peer's time over ours, the fastest of its ways."""

    def value(document: Document) -> Finding:
        record = _record(document["systems"], system)
        rival = fastest(record, library, method) if record else None
        if rival is None:
            return NOT_MEASURED
        note = f"{library} {rival['name']}"
        if not rival["accurate"]:
            note += f", error {rival['error']:.1e}"
        if ours == BIND:
            note += f"; with five arrays copied in: {rival['ratios'][BIND_COPYING]:.2f}"
        return rival["ratios"][ours], note

    return value


def _batch(size: int) -> Callable[[Document], Finding]:
    def value(document: Document) -> Finding:
        record = _record(document["systems"], document["batches"]["system"])
        rival = fastest(record, "pinocchio") if record else None
        for row in document["batches"]["sizes"]:
            if row["size"] == size and rival is not None:
                return row["ratios"][rival["name"]], f"pinocchio {rival['name']}, in a loop"
        return NOT_MEASURED

    return value


def _steps_a_second(document: Document) -> Finding:
    found = _fastest_rollout(document)
    return (found["steps_per_second"], found["name"]) if found else NOT_MEASURED


def _against_mj_step(document: Document) -> Finding:
    found = _fastest_rollout(document)
    rivals = [row for row in document["rollouts"]["entries"] if row["name"].startswith("mj_step, Euler")]
    if not found or not rivals:
        return NOT_MEASURED
    ratio, rival = min((row["ratios"][found["name"]], row["name"]) for row in rivals)
    return ratio, f"{rival}; ours: {found['name']}"


def _fastest_rollout(document: Document) -> Record | None:
    """Return our fastest batch of Runge-Kutta steps of order 4."""
    ways = [row for row in document["rollouts"]["entries"] if row["name"].startswith("rk4")]
    return min(ways, key=lambda row: row["microseconds"], default=None)


def _growth(larger: str) -> Callable[[Document], Finding]:
    def value(document: Document) -> Finding:
        for row in document["growth"]:
            if row["larger"] == larger:
                return row["ratio"], ""
        return NOT_MEASURED

    return value


def _compile(system: str, how: str) -> Callable[[Document], Finding]:
    def value(document: Document) -> Finding:
        row = next((row for row in document["compile"] if row["system"] == system), None)
        return (row[how]["first_answer"], "first answer included") if row else NOT_MEASURED

    return value


def _operations(system: str) -> Callable[[Document], Finding]:
    def value(document: Document) -> Finding:
        record = _record(document["systems"], system)
        return (float(record["operations"]), "") if record else NOT_MEASURED

    return value


def _agreement(document: Document) -> Finding:
    own = [e["error"] for r in document["systems"] for e in r["entries"] if e["library"] == "holdfast"]
    own += [row["error"] for row in document["batches"]["sizes"]]
    return (max(own), "largest relative error of qdd, all systems") if own else NOT_MEASURED


def _record(systems: list[Record], name: str) -> Record | None:
    return next((record for record in systems if record["name"] == name), None)


BARS = (
    Bar("2 x 7, checked call: fastest accurate Pinocchio / ours", True, 4.0, _ratio("2 x 7", "pinocchio")),
    Bar("2 x 7, bound call: fastest accurate Pinocchio / ours", True, 5.0, _ratio("2 x 7", "pinocchio", "", BIND)),
    Bar("2 x 7, checked call: fastest mj_forward / ours", True, 6.0, _ratio("2 x 7", "mujoco")),
    Bar("2 x 7, batch of 4096, per state: fastest accurate Pinocchio / ours", True, 30.0, _batch(4096)),
    Bar("2 x 7, rollouts by RK4: steps a second, one thread", True, 400_000.0, _steps_a_second),
    Bar("2 x 7, a step by RK4: fastest mj_step by Euler / ours", True, 4.0, _against_mj_step),
    Bar("16 x 7: lcaba / ours", True, 8.0, _ratio("16 x 7", "pinocchio", "lcaba")),
    Bar("16 x 7: constraintDynamics, free / ours", True, 35.0, _ratio("16 x 7", "pinocchio", CHOLESKY)),
    Bar("64 x 7: lcaba / ours", True, 9.0, _ratio("64 x 7", "pinocchio", "lcaba")),
    Bar("64 x 7: constraintDynamics, free / ours", True, 400.0, _ratio("64 x 7", "pinocchio", CHOLESKY)),
    Bar("2 x 96: lcaba / ours", True, 4.0, _ratio("2 x 96", "pinocchio", "lcaba")),
    Bar("time of 64 x 7 / 16 x 7", False, 4.6, _growth("64 x 7")),
    Bar("time of 2 x 96 / 2 x 24", False, 4.6, _growth("2 x 96")),
    Bar("2 x 7: operations", False, 7500.0, _operations("2 x 7")),
    Bar("2 x 7: seconds to compile, cold", False, 1.0, _compile("2 x 7", "cold")),
    Bar("64 x 7: seconds to compile, cold", False, 1.5, _compile("64 x 7", "cold")),
    Bar("2 x 96: seconds to compile, cold", False, 5.0, _compile("2 x 96", "cold")),
    Bar("2 x 7: seconds to load from the cache", False, 0.03, _compile("2 x 7", "cached")),
    Bar("64 x 7: seconds to load from the cache", False, 0.03, _compile("64 x 7", "cached")),
    Bar("2 x 96: seconds to load from the cache", False, 0.03, _compile("2 x 96", "cached")),
    Bar("answers as the exact peer's", False, ACCURATE, _agreement),
)
