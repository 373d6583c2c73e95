"""Several result folders in one command: labels that distinguish them, and checks of the arguments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from holdfast.errors import ResultError


def require_one_place(folders: Sequence[Path], out: Path | None) -> None:
    """Refuse a command without a run, or with several runs for one output.

    Raises:
        ResultError: there is no run, or there are several.
    """
    if not folders:
        raise ResultError("Missing: RESULT; expected one result folder or more")
    if out is not None and len(folders) > 1:
        raise ResultError(f"--out: expected one result folder, got {len(folders)}; try without it, or one by one")


def labels(places: Sequence[Path], most: int, what: str = "RESULT") -> list[str]:
    """Return for each place the shortest end of its path that distinguishes it from the others.

    Args:
        places: result folders or scenes.
        most: largest number that can be shown together.
        what: the kind of arguments that the command takes, for messages.

    Raises:
        ResultError: there are none, there are too many, or one is named twice.
    """
    if not places:
        raise ResultError(f"Missing: {what}; expected one or more")
    if len(places) > most:
        raise ResultError(f"{what}: expected at most {most} together, got {len(places)}; try some of them")
    parts = [place.resolve().parts for place in places]
    for i, one in enumerate(parts):
        if one in parts[:i]:
            raise ResultError(f"{what}: expected different ones, got {places[i]} twice; try each once")
    longest = max(map(len, parts))
    length = next(k for k in range(1, longest + 1) if len({one[-k:] for one in parts}) == len(parts))
    return ["/".join(one[-length:]) for one in parts]
