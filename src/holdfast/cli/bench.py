"""`holdfast bench`: the speed of closed-chain forward dynamics, compared with other libraries."""

from __future__ import annotations

from json import dumps

from rich.console import Console
from rich.table import Table

from holdfast.bench import tables
from holdfast.bench.run import FULL, QUICK, run
from holdfast.cli.console import stdout
from holdfast.cli.options import Switch
from holdfast.cli.streams import say
from holdfast.progress import progress_bar

ABREAST = 7  # systems in a batch
ONLY_ON_THE_PAGE = (tables.settings, tables.growth)


def bench(json: Switch = False, quick: Switch = False) -> int:
    """Compare the speed of forward dynamics with other libraries, which must give the same results.

    Args:
        json: print one JSON document instead of tables.
        quick: measure only a few small sizes, in half a minute instead of several minutes.
    """
    with progress_bar("measuring", say=say, time_left=False) as show:
        document = run(QUICK if quick else FULL, lambda doing, part: show(part, doing))
    if json:
        print(dumps(document, indent=1))
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
