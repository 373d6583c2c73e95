"""`holdfast bench`: the speed of closed-chain forward dynamics, compared with other libraries."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from holdfast.bench import tables
from holdfast.bench.run import FULL, QUICK, Report, run
from holdfast.cli.console import stdout

ABREAST = 7  # systems in a batch
ONLY_ON_THE_PAGE = (tables.settings, tables.growth)


def bench(as_json: bool, quick: bool) -> int:
    """Measure, and print tables or one JSON document."""
    with _progress() as report:
        document = run(QUICK if quick else FULL, report)
    if as_json:
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


@contextmanager
def _progress() -> Iterator[Report]:
    """Show on stderr what is being measured, if stderr is a terminal."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task("starting", total=1.0)

        def report(doing: str, part: float) -> None:
            progress.update(task, description=doing, completed=part)

        yield report
