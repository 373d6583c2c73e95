"""Which of many cases run at every turn; machine code of the others takes minutes to make."""

from __future__ import annotations

from collections.abc import Container, Iterable
from typing import Any

import pytest


def mostly_long(values: Iterable[Any], soon: Container[Any]) -> list[Any]:
    """Return the values of a parameter, marked `long` but for some."""
    return [x if x in soon else pytest.param(x, marks=pytest.mark.long) for x in values]
