"""Which cases of a file a command works on, and how it prints data about them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from holdfast.io.case_file import Case, load_cases
from holdfast.io.files import one_line
from holdfast.io.typed import refusal
from holdfast.model import checks


def chosen_cases(file: Path, name: str | None) -> list[Case]:
    """Return all cases of a file, or the named one.

    Raises:
        SceneError: the file is unreadable or invalid, or has no such case.
    """
    if file.suffix.lower() == ".toml":
        raise refusal(str(file), "expected problem cases (JSON), got a scene; try holdfast simulate, view or diagnose")
    cases = load_cases(file)
    if name is None:
        return cases
    known = [case.name for case in cases]
    if name not in known:
        raise refusal(str(file), f"no case '{one_line(name, 60)}'.{checks.did_you_mean(name, known)}")
    return [cases[known.index(name)]]


def print_json(items: Sequence[dict[str, object]]) -> None:
    """Print a JSON list on stdout, one item a line; NaN or infinity in it is a fault of ours."""
    lines = [json.dumps(item, allow_nan=False) for item in items]
    print("[" + ",\n ".join(lines) + "]")
