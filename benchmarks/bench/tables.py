"""The document of a run as text tables for the terminal and for Markdown."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.bench.entries import LIBRARY, PUBLIC

Document = dict[str, Any]
INEXACT = "*"
MISSING = "-"
STEADY = 1.1  # largest ratio of upper to lower quartile of an undisturbed time


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes:
        title: title above the table.
        header: titles of the columns.
        rows: rows of cells.
        notes: notes below the table.
    """

    title: str
    header: list[str]
    rows: list[list[str]]
    notes: list[str] = field(default_factory=list)

    def cut(self, columns: int) -> list[Table]:
        """Return several tables with a limited number of columns after the first; the last one has the notes."""
        starts = list(range(1, len(self.header), columns))
        return [
            Table(
                self.title,
                [self.header[0], *self.header[start : start + columns]],
                [[row[0], *row[start : start + columns]] for row in self.rows],
                self.notes if start == starts[-1] else [],
            )
            for start in starts
        ]

    def markdown(self) -> str:
        """Return the table as Markdown, without its title."""
        lines = ["| " + " | ".join(row) + " |" for row in (self.header, ["---"] * len(self.header), *self.rows)]
        return "\n".join([*lines, *(f"\n{note}" for note in self.notes)]) + "\n"


def number(x: float) -> str:
    """Return a number with about three digits."""
    return f"{x:,.0f}" if abs(x) >= 100 else f"{x:.1f}" if abs(x) >= 10 else f"{x:.2f}" if abs(x) >= 1 else f"{x:.3f}"


def ratios(document: Document) -> Table:
    """Return the times of all peers relative to our checked call, from the same rounds."""
    notes = [
        f"Over one checked call of `{PUBLIC}`. {INEXACT} answers further than {document['accuracy']:g} from the exact"
        " ones (MuJoCo's welds are soft by design; see the errors). The row without grasps is a floor, no competitor.",
        "The tree form lacks one grasp wrench: that of the arm whose hand the object is part of. Ours gives all.",
    ]
    return _by_system(document, "Time over ours", lambda e: number(e["ratios"][PUBLIC]), notes, own=False)


def times(document: Document) -> Table:
    """Return microseconds per evaluation."""

    def short(entry: dict[str, Any]) -> str:
        steady = entry["upper_quartile"] <= STEADY * entry["lower_quartile"]
        return ("" if steady else "~") + number(entry["microseconds"])

    notes = [
        f"Medians of {document['rounds']} rounds. These are this machine's; the ratios travel better. ~ the quartiles"
        f" are more than {round(100 * (STEADY - 1))} % apart: others used the machine."
    ]
    return _by_system(document, "Microseconds per evaluation", short, notes)


def errors(document: Document) -> Table:
    """Return the largest relative error of the joint accelerations, after the timing."""

    def short(entry: dict[str, Any]) -> str:
        return f"{entry['error']:.0e}" if entry["error"] else "exact"

    notes = ["Largest over the states, after the timing; against the answers taken as exact."]
    return _by_system(document, "Relative error of the joint accelerations", short, notes, floors=False)


def settings(document: Document) -> Table:
    """Return the settings of `lcaba` at every size."""

    def short(entry: dict[str, Any]) -> str:
        found = re.match(r"mu = (\S+), (\d+)", entry["note"])
        return f"{found[1]}, {found[2]}" if found else MISSING

    notes = ["The fewest iterations, and then the best mu, that keep the accuracy call after call."]
    table = _by_system(document, "lcaba: mu, iterations", short, notes, own=False)
    return replace(table, rows=[row for row in table.rows if "lcaba" in row[0]])


def batches(document: Document) -> Table:
    """Return microseconds per state of batches on one thread, and the times of the peers' loops relative to ours."""
    found = document["batches"]
    rivals = list(found["sizes"][0]["ratios"]) if found["sizes"] else []
    rows = [
        [f"{row['size']:,}", number(row["microseconds"]), *(number(row["ratios"][name]) for name in rivals)]
        for row in found["sizes"]
    ]
    header = ["states in one call", "us per state", *(f"{name} / ours" for name in rivals)]
    notes = ["The peers take the same states one by one in a loop."]
    return Table(f"Batches of {found['system']}, one thread", header, rows, notes)


def rollouts(document: Document) -> Table:
    """Return microseconds per step of one system, and the gap at its grasps."""
    found = document["rollouts"]
    ours = next((row["name"] for row in reversed(found["entries"]) if row["name"].startswith("rk4")), "")
    rows = [
        [
            f"{row['library']} {row['name']}",
            number(row["microseconds"]),
            f"{row['steps_per_second']:,.0f}",
            number(row["ratios"][ours]),
            f"{row['gap']:.0e}",
        ]
        for row in found["entries"]
    ]
    header = ["way to step", "us per step", "steps a second", f"over {ours}", "gap [m or rad]"]
    notes = [
        f"{found['steps']} steps of {1e3 * found['step']:g} ms from each of the states, torques held, one thread. A"
        " step of ours is the scheme's evaluations, projection of positions and velocities, margins. The gap is that"
        " of the worst grasp at the end."
    ]
    return Table(f"Steps of {found['system']} in time", header, rows, notes)


def trunks(document: Document) -> Table:
    """Return the times for chains with a trunk relative to those without it, and Pinocchio's relative to ours."""
    rows = []
    for record in document["trunks"]:
        own = (record["call"], record["bound"], record["batch"])
        ours = [f"{number(one['microseconds'])} ({number(one['ratios']['2 x 7'])})" for one in own]
        theirs = [[peer["name"], *map(number, peer["ratios"].values())] for peer in record["peers"]]
        rows += [[record["name"], *ours, *cells] for cells in theirs or [[MISSING] * 4]]
    header = ["system", "us: checked call", "bound call", "in a batch", "Pinocchio", "/ checked", "/ bound", "/ batch"]
    notes = [
        "Two Pandas and their box; in brackets over the same without a trunk. Batches are one call on one thread, per"
        " state. Ratios are from the same rounds."
    ]
    return Table("Arms on a trunk", header, rows, notes)


def derivatives(document: Document) -> Table:
    """Return the times of derivatives relative to forward dynamics, and of Pinocchio's Jacobian relative to ours."""
    theirs = {
        (row["system"], name): ratio
        for row in document["derivatives"]
        if row["library"] != LIBRARY
        for name, ratio in row["ratios"].items()
    }
    rows = []
    for row in document["derivatives"]:
        own = row["library"] == LIBRARY
        over = number(next(iter(row["ratios"].values()))) if own else MISSING
        rival = theirs.get((row["system"], f"{row['what']}, {row['way']}")) if own else None
        what = f"{row['what']}, {row['way']}" if own else f"{row['what']}, {row['library']}"
        cells = [number(row["microseconds"]), over, MISSING if rival is None else number(rival), f"{row['error']:.0e}"]
        rows.append([row["system"], what, *cells])
    header = ["arms x joints", "derivatives", "us", "/ forward dynamics", "Pinocchio / it", "error"]
    notes = [
        "Forward dynamics included, over the same call, bound form or batch of it alone. VJP: gradients by q, qd, tau,"
        " object pose and twist; JVP: rates of qdd, grasp wrenches, object acceleration along one direction of these;"
        " Jacobian: of qdd and grasp wrenches by q, qd, tau. Pinocchio: `constraintDynamics` and"
        " `computeConstraintDynamicsDerivatives`. Errors at one state, against the equations on NumPy."
    ]
    return Table("Derivatives of forward dynamics", header, rows, notes)


def compiling(document: Document) -> Table:
    """Return seconds from `compile` to the first result in a new process, and numbers of operations."""
    operations = {record["name"]: record["operations"] for record in document["systems"]}
    rows = [
        [
            row["system"],
            f"{row['cold']['first_answer']:.2f}",
            f"{row['cached']['first_answer']:.4f}",
            f"{operations[row['system']]:,}" if row["system"] in operations else MISSING,
        ]
        for row in document["compile"]
    ]
    header = ["system", "cold [s]", "from the cache [s]", "operations of one evaluation"]
    return Table("Compiling, the first answer included", header, rows)


def acceptance_checks(document: Document) -> Table:
    """Return the acceptance checks that this run measured, and whether they are met."""
    rows, left = [], 0
    for check in document["bars"]:
        if check["value"] is None:
            left += 1
            continue
        value = f"{check['value']:.1e}" if check["goal"] < 1e-3 else number(check["value"])
        goal = f"{check['sense']} {check['goal']:g}"
        rows.append([check["what"], goal, value, "met" if check["met"] else "MISSED", check["note"]])
    notes = [f"{left} more need the full run."] if left else []
    return Table("Acceptance checks", ["check", "goal", "value", "", "against"], rows, notes)


def growth(document: Document) -> Table:
    """Return our time at a larger size relative to that at a smaller one."""
    rows = [[f"{row['larger']} / {row['smaller']}", number(row["ratio"])] for row in document["growth"]]
    return Table("Growth of our time", ["systems", "ratio"], rows)


def distribution(document: Document) -> Table:
    """Return the times of the distribution of forces, in multiples of forward dynamics."""
    rows = [[row["kind"], row["name"], number(row["microseconds"]), number(row["ratio"])]
        for row in document.get("distribution", ())]  # fmt: skip
    notes = ["Two Pandas with a box; ratios to a bound call of forward dynamics of the same chain, on one thread."]
    return Table("Distribution of forces", ["grasps", "computation", "us", "ratio"], rows, notes)


def absences(document: Document) -> list[str]:
    """Return a line for each comparison that is missing, with the reason."""
    lines = [f"{name}: not compared: {peer['absent']}" for name, peer in document["peers"].items() if "absent" in peer]
    for record in document["systems"]:
        lines += [
            f"{way['library']} {way['name']} at {record['name']}: skipped: {way['reason']}" for way in record["skipped"]
        ]
    return lines


def _by_system(
    document: Document, title: str, cell: Any, notes: list[str], *, own: bool = True, floors: bool = True
) -> Table:
    """Return a table with a row per entry and a column per system."""
    systems = document["systems"]
    names: dict[tuple[str, str], dict[str, Any]] = {}
    for record in systems:
        for entry in record["entries"]:
            if (own or entry["library"] != LIBRARY) and (floors or not entry["floor"]):
                names.setdefault((entry["library"], entry["name"]), entry)
    rows = []
    for library, name in names:
        row = [f"{library} {name}"]
        for record in systems:
            entry = next((e for e in record["entries"] if (e["library"], e["name"]) == (library, name)), None)
            inexact = entry is not None and not entry["accurate"] and not entry["floor"]
            row.append(MISSING if entry is None else cell(entry) + (INEXACT if inexact else ""))
        rows.append(row)
    return Table(title, ["arms x joints", *(record["name"] for record in systems)], rows, notes)


# in the order of the page
ALL = (
    ratios,
    times,
    errors,
    settings,
    batches,
    rollouts,
    trunks,
    derivatives,
    distribution,
    growth,
    compiling,
    acceptance_checks,
)
