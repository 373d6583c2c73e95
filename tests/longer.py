"""Which values of a parameter `make test` takes; `make acceptance` takes the others."""

from collections.abc import Container, Iterable
from typing import Any

import pytest


def mostly_long(values: Iterable[Any], soon: Container[Any]) -> list[Any]:
    """Return the values of a parameter, or tuples of several, marked `long` but for some."""
    return [x if x in soon else _long(*(x if isinstance(x, tuple) else (x,))) for x in values]


def _long(*values: Any) -> Any:
    return pytest.param(*values, marks=pytest.mark.long)
