"""The acceptance checks of the benchmark."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from benchmarks.bench.distribution_entries import SOFT_FINGERS
from benchmarks.bench.entries import ACCURATE, BIND, BIND_COPYING, PUBLIC

Document = dict[str, Any]
Record = dict[str, Any]
Finding = tuple[float | None, str]  # the value, and the basis of the comparison
CHOLESKY = "constraintDynamics, free"
NOT_MEASURED: Finding = (None, "not measured in this run")


@dataclass(frozen=True)
class Check:
    """One acceptance check.

    Attributes:
        what: name of the measured quantity.
        at_least: True if the value must reach the goal, False if it must stay below it.
        goal: the goal.
        value: function that reads the value from the document, with a note.
    """

    what: str
    at_least: bool
    goal: float
    value: Callable[[Document], Finding]


def checked(document: Document) -> list[dict[str, Any]]:
    """Return for every check its goal, its value (None if it was not measured), whether it is met, and a note."""
    found = []
    for check in CHECKS:
        value, note = check.value(document)
        met = None if value is None else (value >= check.goal if check.at_least else value <= check.goal)
        sense = ">=" if check.at_least else "<="
        found.append({"what": check.what, "sense": sense, "goal": check.goal, "value": value, "met": met, "note": note})
    return found


def fastest(record: Record, library: str, method: str = "") -> Record | None:
    """Return a library's fastest accurate entry; if none is accurate, its fastest entry; None if it has no entry.

    Entries are compared by their ratio to ours from the same rounds, which other load on the machine affects less than
    times.

    Args:
        record: record of a system.
        library: name of the library.
        method: beginning of the names of the entries.
    """
    ways = [e for e in record["entries"] if e["library"] == library and e["name"].startswith(method) and not e["floor"]]
    accurate = [entry for entry in ways if entry["accurate"]]
    return min(accurate or ways, key=lambda entry: entry["ratios"][PUBLIC], default=None)


def _ratio(system: str, library: str, method: str = "", ours: str = PUBLIC) -> Callable[[Document], Finding]:
    """Return a function that reads the ratio of a peer's fastest time to ours."""

    def value(document: Document) -> Finding:
        record = _found(document["systems"], "name", system)
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
    """Return a function that reads the ratio of a peer's time in a loop to ours in one call, per state."""

    def value(document: Document) -> Finding:
        record = _found(document["systems"], "name", document["batches"]["system"])
        rival = fastest(record, "pinocchio") if record else None
        row = _found(document["batches"]["sizes"], "size", size)
        if row is None or rival is None:
            return NOT_MEASURED
        return row["ratios"][rival["name"]], f"pinocchio {rival['name']}, in a loop"

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


def _number(rows: str, key: str, name: str, *path: str, note: str = "") -> Callable[[Document], Finding]:
    """Return a function that reads the number at a path in the row with a given name."""

    def value(document: Document) -> Finding:
        found: Any = _found(document[rows], key, name)
        if found is None:
            return NOT_MEASURED
        for part in path:
            found = found[part]
        return float(found), note

    return value


def _distribution(name: str) -> Callable[[Document], Finding]:
    """Return a function that reads the time of a distribution of forces with soft fingers over forward dynamics."""

    def value(document: Document) -> Finding:
        rows = [row for row in document.get("distribution", ()) if (row["kind"], row["name"]) == (SOFT_FINGERS, name)]
        return (rows[0]["ratio"], "bound, of the same chain") if rows else NOT_MEASURED

    return value


def _compile(system: str, how: str) -> Callable[[Document], Finding]:
    return _number("compile", "system", system, how, "first_answer", note="first answer included")


def _agreement(document: Document) -> Finding:
    own = [e["error"] for r in document["systems"] for e in r["entries"] if e["library"] == "holdfast"]
    own += [row["error"] for row in document["batches"]["sizes"]]
    return (max(own), "largest relative error of qdd, all systems") if own else NOT_MEASURED


def _found(rows: list[Record], key: str, name: object) -> Record | None:
    return next((row for row in rows if row[key] == name), None)


CHECKS = (
    Check("2 x 7, checked call: fastest accurate Pinocchio / ours", True, 4.0, _ratio("2 x 7", "pinocchio")),
    Check("2 x 7, bound call: fastest accurate Pinocchio / ours", True, 5.0, _ratio("2 x 7", "pinocchio", "", BIND)),
    Check("2 x 7, checked call: fastest mj_forward / ours", True, 6.0, _ratio("2 x 7", "mujoco")),
    Check("2 x 7, batch of 4096, per state: fastest accurate Pinocchio / ours", True, 30.0, _batch(4096)),
    Check("2 x 7, rollouts by RK4: steps a second, one thread", True, 400_000.0, _steps_a_second),
    Check("2 x 7, a step by RK4: fastest mj_step by Euler / ours", True, 4.0, _against_mj_step),
    Check("16 x 7: lcaba / ours", True, 8.0, _ratio("16 x 7", "pinocchio", "lcaba")),
    Check("16 x 7: constraintDynamics, free / ours", True, 35.0, _ratio("16 x 7", "pinocchio", CHOLESKY)),
    Check("64 x 7: lcaba / ours", True, 9.0, _ratio("64 x 7", "pinocchio", "lcaba")),
    Check("64 x 7: constraintDynamics, free / ours", True, 400.0, _ratio("64 x 7", "pinocchio", CHOLESKY)),
    Check("2 x 96: lcaba / ours", True, 4.0, _ratio("2 x 96", "pinocchio", "lcaba")),
    Check("distribution of forces, bound, over forward dynamics", False, 25.0, _distribution("16 iterations, bound")),
    Check("the same in a batch, 12 iterations", False, 6.0, _distribution("12 iterations, batch")),
    Check("time of 64 x 7 / 16 x 7", False, 4.6, _number("growth", "larger", "64 x 7", "ratio")),
    Check("time of 2 x 96 / 2 x 24", False, 4.6, _number("growth", "larger", "2 x 96", "ratio")),
    Check("2 x 7: operations", False, 7500.0, _number("systems", "name", "2 x 7", "operations")),
    Check("2 x 7: seconds to compile, cold", False, 1.0, _compile("2 x 7", "cold")),
    Check("64 x 7: seconds to compile, cold", False, 1.5, _compile("64 x 7", "cold")),
    Check("2 x 96: seconds to compile, cold", False, 5.0, _compile("2 x 96", "cold")),
    Check("2 x 7: seconds to load from the cache", False, 0.03, _compile("2 x 7", "cached")),
    Check("64 x 7: seconds to load from the cache", False, 0.03, _compile("64 x 7", "cached")),
    Check("2 x 96: seconds to load from the cache", False, 0.03, _compile("2 x 96", "cached")),
    Check("answers as the exact peer's", False, ACCURATE, _agreement),
)
