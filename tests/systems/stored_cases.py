"""Stored problems by name, each built when it is first asked for: to collect tests takes their names alone."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from holdfast.io.case_file import parse_cases

DATA = Path(__file__).parents[1] / "data"


class StoredCases(Mapping[str, Any]):
    """The problems of a file, by name in its order.

    Attributes:
        raw: what the file says of each.
    """

    def __init__(self, file: str) -> None:
        self.raw = {case["name"]: case for case in json.loads((DATA / file).read_text())["cases"]}
        self._built: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._built:
            (self._built[name],) = parse_cases(json.dumps([self.raw[name]]).encode(), name)
        return self._built[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.raw)

    def __len__(self) -> int:
        return len(self.raw)


@cache
def stored_cases(file: str) -> StoredCases:
    """Return the problems of a file in tests/data."""
    return StoredCases(file)
