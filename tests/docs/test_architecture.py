"""The page on the house: each room has its row, and what is named as a place to touch is there."""

import re
from pathlib import Path

import holdfast
from tests.docs.pages import DOCS

PACKAGE = Path(holdfast.__file__).parent
PAGE = (DOCS / "architecture.md").read_text(encoding="utf-8")
PLANNED = "*(planned)*"
ROWS = [line for line in PAGE.splitlines() if line.startswith("| ")]
FIRST = {row.split("|")[1]: PLANNED in row for row in ROWS}
NAMED = {name.rstrip("/"): planned for cell, planned in FIRST.items() for name in re.findall(r"`([\w/.]+)`", cell)}


def exists(name: str) -> bool:
    """Return whether a folder or a module of the package has this name; attributes of modules count."""
    return any((PACKAGE / place).exists() for place in (name, f"{name}.py", f"{name.rpartition('.')[0]}.py"))


def test_every_room_has_a_row():
    """Each folder and each module at the top of the package is in the table, and what is planned is not there yet."""
    files = [path for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()]
    here = {path.name for path in files if not path.name.startswith("__")}
    assert {name for name, planned in NAMED.items() if not planned and "/" not in name} - {"__init__.pyi"} == here
    assert [name for name, planned in NAMED.items() if planned == exists(name)] == []


def test_places_to_touch_exist():
    """Paths in code spans of the page are those of the package."""
    planned = "\n".join(row for row in PAGE.splitlines() if PLANNED in row)
    named = set(re.findall(r"`(\w+/[\w/.]*)`", PAGE)) - set(re.findall(r"`(\w+/[\w/.]*)`", planned))
    assert len(named) > 30
    assert [name for name in named if not exists(name) and not (DOCS.parent / name).exists()] == []
