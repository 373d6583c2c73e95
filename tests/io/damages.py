"""Damage to files of a folder: flipped bits, lost and exchanged files, other JSON, additional files."""

import json
import random
import shutil
from pathlib import Path
from typing import Any

from tests.io.mutations import at, places

UNREAD = {"lock", "log.jsonl"}  # no number comes from these
NOT_JSON = [b"", b"{}", b"[]", b"null", b'{"format":', b"\xff\xfe{}", b"[" * 5000, b'"\\ud800"', b"NaN"]
VALUES: list[Any] = [None, True, -1, 0, 2.5, 10**30, "", "x", "../x", [], [1], {}, {"x": 1}]


def flipped(folder: Path, _twin: Path, dice: random.Random) -> str:
    """Flip one bit."""
    name = _any(folder, dice)
    content = bytearray((folder / name).read_bytes())
    content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
    (folder / name).write_bytes(content)
    return name


def truncated(folder: Path, _twin: Path, dice: random.Random) -> str:
    """Cut a file off, perhaps to nothing."""
    name = _any(folder, dice)
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: dice.choice((0, dice.randrange(len(content)), len(content) - 1))])
    return name


def scrambled(folder: Path, _twin: Path, dice: random.Random) -> str:
    """Replace some bytes, or insert them."""
    name = _any(folder, dice)
    content = bytearray((folder / name).read_bytes())
    begin = dice.randrange(len(content))
    content[begin : begin + dice.choice((0, 8, 100))] = dice.randbytes(dice.choice((1, 8, 100)))
    (folder / name).write_bytes(content)
    return name


def deleted(folder: Path, _twin: Path, dice: random.Random) -> str:
    """Delete a file."""
    name = _any(folder, dice)
    (folder / name).unlink()
    return name


def exchanged(folder: Path, _twin: Path, dice: random.Random) -> str:
    """Exchange two files of one kind."""
    names = [name for name in _files(folder) if name.endswith((".npz", ".parquet"))]
    first = dice.choice(names)
    other = dice.choice([name for name in names if name != first])
    contents = [(folder / name).read_bytes() for name in (other, first)]
    for name, content in zip((first, other), contents, strict=True):
        (folder / name).write_bytes(content)
    return first


def foreign(folder: Path, twin: Path, dice: random.Random) -> str:
    """Take a file from the folder of another run, sometimes as another chunk."""
    name = dice.choice([name for name in _files(folder) if (twin / name).exists()])
    shutil.copyfile(twin / name, folder / name)
    return name


def other_json(folder: Path, _twin: Path, dice: random.Random) -> str:
    """Replace JSON by something else, or an entry by another one, or leave a key out."""
    name = dice.choice([name for name in _files(folder) if name.endswith(".json")])
    data = json.loads((folder / name).read_text())
    where = dice.choice(list(places(data)))
    how = dice.randrange(4)
    if how == 0:
        (folder / name).write_bytes(dice.choice(NOT_JSON))
        return name
    if how == 1:
        del at(data, where[:-1])[where[-1]]
    else:
        at(data, where[:-1])[where[-1]] = dice.choice(VALUES)
    (folder / name).write_text(json.dumps(data, indent=dice.choice((None, 2))))
    return name


def added(folder: Path, twin: Path, dice: random.Random) -> str:
    """Add a file that is not part of the folder: a chunk more, a temporary file, somebody's notes."""
    chunk = dice.choice([name for name in _files(folder) if "_00" in name])
    name = dice.choice((chunk.replace("_00", "_77"), f"{chunk}.part", "notes.txt"))
    shutil.copyfile(dice.choice((folder, twin)) / chunk, folder / name)
    return name


DAMAGES = (flipped,) * 6 + (truncated, scrambled, deleted, exchanged, foreign, other_json, other_json, added)


def damage(folder: Path, twin: Path, seed: int) -> str:
    """Do one damage, and return what was done to which file."""
    dice = random.Random(seed)
    one = dice.choice(DAMAGES)
    return f"{one.__name__} {one(folder, twin, dice)}"


def _files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.is_file() and path.stat().st_size)


def _any(folder: Path, dice: random.Random) -> str:
    """Return a file, large ones not more often than others."""
    return dice.choice([name for name in _files(folder) if name not in UNREAD])
