"""`holdfast methods`: the forward dynamics algorithms."""

from __future__ import annotations

from rich.table import Table

from holdfast.cli.console import print_document, stdout
from holdfast.cli.options import Switch
from holdfast.dynamics.methods import METHODS


def methods(json: Switch = False) -> int:
    """List the forward dynamics algorithms, with their equation, cost and applicability.

    Args:
        json: print one JSON document instead of a table.
    """
    if json:
        keys = ("name", "equation", "cost", "applies")
        print_document([{key: getattr(method, key) for key in keys} for method in METHODS.values()])
        return 0
    table = Table("method", "equation", "cost", "applies to")
    for method in METHODS.values():
        table.add_row(method.name, method.equation, method.cost, method.applies)
    console = stdout()
    console.print(table)
    console.print("n joints in all, l arms, N joints an arm; 'sequential' is the default")
    return 0
