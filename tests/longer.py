"""Which values of a parameter `make test` takes; `make test-slow` or `make acceptance` takes the others."""

from collections.abc import Container, Iterable
from typing import Any

import pytest


def mostly_slow(values: Iterable[Any], soon: Container[Any]) -> list[Any]:
    """Return the values of a parameter, or tuples of several, marked `slow` but for some."""
    return _marked(values, soon, pytest.mark.slow)


def mostly_long(values: Iterable[Any], soon: Container[Any]) -> list[Any]:
    """Return the values of a parameter, or tuples of several, marked `long` but for some."""
    return _marked(values, soon, pytest.mark.long)


def _marked(values: Iterable[Any], soon: Container[Any], mark: pytest.MarkDecorator) -> list[Any]:
    return [x if x in soon else pytest.param(*(x if isinstance(x, tuple) else (x,)), marks=mark) for x in values]
