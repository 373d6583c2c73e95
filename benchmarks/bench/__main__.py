"""Compares the speed of forward dynamics with other libraries, which must give the same results.

python -m benchmarks.bench [--json] [--quick]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from benchmarks.bench import tables
from benchmarks.bench.run import FULL, QUICK, run
from holdfast.cli.console import stdout
from holdfast.errors import HoldfastError
from holdfast.progress import progress_bar, say

ABREAST = 7  # systems in a batch
ONLY_ON_THE_PAGE = (tables.settings, tables.growth)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the tables or one JSON document, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of tables")
    parser.add_argument("--quick", action="store_true", help="measure only a few small sizes, in half a minute")
    chosen = parser.parse_args(arguments)
    try:
        with progress_bar("measuring", say=say, time_left=False) as show:
            document = run(QUICK if chosen.quick else FULL, lambda doing, part: show(part, doing))
    except HoldfastError as error:
        say(f"error: {' '.join(str(error).split())}")
        return 2
    if chosen.json:
        print(json.dumps(document, indent=1))
        return 0
    console = stdout()
    for make in tables.ALL:
        for part in make(document).cut(ABREAST) if make not in ONLY_ON_THE_PAGE else ():
            if part.rows:
                _print(console, part)
    for line in tables.absences(document):
        console.print(line)
    return 0


def _print(console: Console, table: tables.Table) -> None:
    shown = Table(*table.header, title=table.title, title_justify="left")
    for column in shown.columns[1:]:
        column.justify = "right"
        column.no_wrap = len(table.header) > 5
    for row in table.rows:
        shown.add_row(*row)
    console.print(shown)
    for note in table.notes:
        console.print(note)
    console.print()


if __name__ == "__main__":
    sys.exit(main())
