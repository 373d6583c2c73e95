"""A folder that takes the place of an earlier one as a whole."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from holdfast.errors import ResultError
from holdfast.io.files import LONGEST_NAME, one_line, reason_of


@contextmanager
def replaced_folder(folder: Path, owns: Callable[[str], bool]) -> Iterator[Path]:
    """Yield a new folder to write in, which takes the place of another one when all went well.

    What was there stays until then, also if the writer fails or is killed. A writer that is killed leaves
    `<folder>.<random>.part` beside it.

    Args:
        folder: the place; whatever is in it may be replaced.
        owns: whether a file of this name goes with the old folder; the others are taken over.

    Raises:
        ResultError: it cannot be written.
    """
    token = secrets.token_hex(4)
    try:
        place = Path(os.path.realpath(folder))
        if place == Path.cwd() or place in Path.cwd().parents:
            raise ResultError(
                f"{folder}: cannot be replaced, because it contains the working directory; try a new folder"
            )
        beside, aside = (place.with_name(f"{place.name}.{token}{end}.part") for end in ("", ".old"))
        beside.mkdir(parents=True)
    except (OSError, ValueError) as cause:
        raise ResultError(f"{one_line(str(folder), LONGEST_NAME)}: cannot be written: {reason_of(cause)}") from cause
    try:
        yield beside
        _swap(place, beside, aside)
    except OSError as cause:
        raise ResultError(f"{folder}: cannot be written: {reason_of(cause)}") from cause
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    if aside.exists():
        for path in aside.iterdir():
            if not owns(path.name) and not (place / path.name).exists():
                os.replace(path, place / path.name)
        shutil.rmtree(aside, ignore_errors=True)


def _swap(place: Path, beside: Path, aside: Path) -> None:
    """Move the new folder to its place and the old one aside; if that fails, the old one is back."""
    if not place.exists():
        os.replace(beside, place)
        return
    os.replace(place, aside)
    try:
        os.replace(beside, place)
    except BaseException:
        os.replace(aside, place)
        raise
