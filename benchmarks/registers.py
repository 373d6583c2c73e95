"""How machine code uses registers and memory, and how near it comes to what the processor can do.

python benchmarks/registers.py [computation ...] [--write docs/benchmarks.md]

Counts are those of LLVM's assembly: of the functions that compute, as often as they run, without copies into lanes and
back. Times are those of machine code called with fixed arrays on one thread, all of a computation in the same rounds.
Each is loaded three times and the fastest copy counts, because its time depends on where in memory it lies.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks import kernel_examples, roofline
from benchmarks.bench.clock import Effort, timed
from benchmarks.bench.entries import LIBRARY, Timed
from benchmarks.bench.tables import Table, number
from benchmarks.bench_page import REGISTERS, with_table
from holdfast.compiler.program import Program
from holdfast.compiler.schedule import Schedule
from holdfast.compiler.targets import batch_module, cpu, single_module
from holdfast.compiler.targets.layout import Layout
from holdfast.compiler.targets.llvm.functions import Module

LEVELS = ("x86-64-v3", "x86-64-v4")
COPIES, EFFORT = 3, Effort(turn=0.001, rounds=40)


class Counts(NamedTuple):
    """What the machine code of one computation does in one run, for one system or for all lanes.

    Attributes:
        operations: arithmetic operations.
        instructions: instructions of the processor.
        loads: instructions that read memory.
        stores: instructions that write to memory.
        bytes: bytes that these read and write.
        spilled: bytes that go to the stack, and come from there, because there are too few registers.
        live: how many numbers are in use at each instruction of the graph, in order.
    """

    operations: int
    instructions: int
    loads: int
    stores: int
    bytes: int
    spilled: int
    live: list[int]


def counts(schedule: Schedule, lanes: int, systems: int, quick: bool = False) -> Counts:
    """Return the counts of a schedule for one system (`systems` is 1), or for as many systems as there are lanes."""
    text, _ = single_module(schedule, lanes) if systems == 1 else batch_module(schedule, lanes)
    functions = instructions(cpu.assembly(text, quick))
    total: Counter[str] = Counter()
    live: list[int] = []
    for name, program, runs in runs_of(schedule, lanes, systems):
        total.update({what: runs * n for what, n in functions[name].items()})
        live += program.live_numbers * runs
    found = (total[what] for what in ("instructions", "loads", "stores", "bytes", "spilled"))
    return Counts(schedule.operation_count * systems, *found, live=live)


def runs_of(schedule: Schedule, lanes: int, systems: int) -> Iterator[tuple[str, Program, int]]:
    """Yield the name of every function in the order of calls, the program that it computes, and how often it runs."""
    layout = Layout(schedule, lanes, systems)
    module = Module(layout)
    for call in schedule.prepare:  # its functions are the first to be written
        module.written(call)
    for call in schedule.calls:
        made = module.written(call)
        runs = len(layout.places(call, made.split)) if made.split.writes else 0
        for name, part in zip(made.parameters, made.split.parts, strict=True):
            yield name, part.program, runs


_LABEL, _STACK = re.compile(r"^([\w.$]+):"), re.compile(r"(\d+)-byte (?:Folded )?(?:Spill|Reload)")
_WIDTH = {"z": 64, "y": 32, "x": 16}  # bytes of a register


def instructions(assembly: str) -> dict[str, Counter[str]]:
    """Return the counts of every function of a module in the assembly of x86-64."""
    found: dict[str, Counter[str]] = {}
    own: Counter[str] = Counter()
    for line in assembly.splitlines():
        if label := _LABEL.match(line):
            own = found.setdefault(label[1], Counter())
        if not re.match(r"\t[a-z]", line):
            continue
        own["instructions"] += 1
        code, _, comment = line.partition("#")
        name, _, operands = code.strip().partition("\t")
        if "(" in operands and not name.startswith(("lea", "nop")):
            own["stores" if operands.rstrip().endswith(")") else "loads"] += 1
            own["bytes"] += _bytes(name, operands)
        own["spilled"] += sum(int(size) for size in _STACK.findall(comment))
    return found


def _bytes(name: str, operands: str) -> int:
    """Return how many bytes an instruction reads or writes."""
    if "broadcastsd" in name or "{1to" in operands or name.endswith("sd"):
        return 8
    register = re.search(r"%([xyz])mm", operands)
    return _WIDTH[register[1]] if register else 8


class Row(NamedTuple):
    """One computation on one level of the processor.

    Attributes:
        name: the computation.
        level: the level.
        wide: whether it is code for systems in lanes.
        systems: for how many systems it runs.
        counts: what it does in one run.
        nanoseconds: how long that takes.
    """

    name: str
    level: str
    wide: bool
    systems: int
    counts: Counts
    nanoseconds: float

    @property
    def rate(self) -> float:
        """Operations in a nanosecond."""
        return self.counts.operations / self.nanoseconds

    @property
    def intensity(self) -> float:
        """Operations for every byte that is read or written."""
        return self.counts.operations / self.counts.bytes


def measured(name: str) -> list[Row]:
    """Return the rows of one computation, which are timed in the same rounds."""
    ways: list[tuple[str, bool, int, Counts]] = []
    entries: list[Timed] = []
    for level in LEVELS:
        with cpu.made_for(cpu.level(level)):
            example = kernel_examples.EXAMPLES[name]()
            for wide in (False, True) if example.single else (True,):
                lanes = cpu.lanes() if wide else 1
                found = counts(example.schedule, cpu.lanes(), lanes, example.quick)
                systems = min(lanes, example.systems)
                found = found._replace(operations=found.operations * systems // lanes)
                ways.append((level, wide, systems, found))
                sweeps = [example.batch_sweep() if wide else example.single_sweep() for _ in range(COPIES)]
                entries += [Timed("", LIBRARY, run, runs) for run, runs in sweeps]
    seconds = np.quantile(timed(entries, EFFORT), 0.1, axis=0).reshape(len(ways), COPIES).min(axis=1)
    return [Row(name, *way, 1e9 * taken) for way, taken in zip(ways, seconds, strict=True)]


def table(rows: list[Row]) -> str:
    """Return the rows as Markdown."""
    alone = {(row.name, row.level): row for row in rows if not row.wide}
    header = ["computation", "processor", "systems", "operations", "live: most", "mean"]
    header += ["instructions", "loads", "stores", "spilled bytes / operation", "ns", "ns / operation", "single / it"]
    cells = []
    for row in rows:
        of, single = row.counts, alone.get((row.name, row.level))
        speed = number(row.rate / single.rate) if single and single is not row else "-"
        live = (f"{max(of.live)}", f"{np.mean(of.live):.0f}")
        sizes = (f"{n:,}" for n in (of.instructions, of.loads, of.stores))
        times = (f"{of.spilled / of.operations:.2f}", number(row.nanoseconds), f"{1 / row.rate:.3f}", speed)
        cells.append([row.name, row.level, f"{row.systems}", f"{of.operations:,}", *live, *sizes, *times])
    return Table("", header, cells).markdown()


TEXT = """\
Generated by `make registers`: counts of LLVM's assembly for one run, of the functions that compute, and the run's time
on this machine. *Live* is how many numbers are in use at an instruction of the graph; AVX2 (`x86-64-v3`) has 16
registers, AVX-512 (`x86-64-v4`) 32. *Spilled* are bytes written to the stack and read again, since there are too few.
*single / it*: how many times as long an operation takes for one system. A step of `simulate` runs code for lanes,
compiled quickly, for one system. In the figure, lines are the limits of this processor in lanes: bytes from its nearest
cache, and arithmetic.

"""


def main() -> None:
    """Print the table, or write it between the markers of a page, and the figure beside it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("computation", nargs="*", help=", ".join(kernel_examples.EXAMPLES))
    parser.add_argument("--write", type=Path, help="the page")
    given = parser.parse_args()
    if unknown := [name for name in given.computation if name not in kernel_examples.EXAMPLES]:
        parser.error(f"expected some of {', '.join(kernel_examples.EXAMPLES)}, got {', '.join(unknown)}")
    rows = [row for name in given.computation or kernel_examples.EXAMPLES for row in measured(name)]
    if given.write is None:
        print(table(rows))
        return
    picture = roofline.save(rows, given.write.parent / "images")
    text = f"{TEXT}{table(rows)}\n![Roofline](images/{picture})\n"
    given.write.write_text(with_table(given.write.read_text(), text, REGISTERS))


if __name__ == "__main__":
    main()
