"""`holdfast methods`: the forward dynamics algorithms."""

from __future__ import annotations

from rich.table import Table

from holdfast.cli.console import stdout
from holdfast.dynamics.methods import METHODS


def methods() -> int:
    """Print every algorithm with its equation, cost and range."""
    table = Table("method", "equation", "cost", "applies to")
    for method in METHODS.values():
        table.add_row(method.name, method.equation, method.cost, method.applies)
    console = stdout()
    console.print(table)
    console.print("n joints in all, l arms, N joints an arm; 'sequential' is the default")
    return 0
