"""The table of equations: every number of the paper is in it, every place it names exists."""

import importlib
import re

import pytest

from holdfast.dynamics import METHODS
from tests.docs.pages import DOCS, ROOT

PAGE = (DOCS / "theory" / "equations.md").read_text(encoding="utf-8")
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in PAGE.splitlines() if line.startswith("| (")]
EQUATIONS = [row for row in ROWS if len(row) == 4]

# last letter of every numbered equation, "" for one that has none
LETTERS = {
    "2": ["d", "", "d", "", "b", "", "b", "b", "", "c", "", "", "b", "", "b"],
    "3": ["", "", "", "", "b", "b"],
    "4": ["b", "b", "", "", "", "", "", "", "h"],
    "5": ["d", "b", "", "", "d", "b", "b", "b", "c", "g", "", "b", "", "d"],
    "6": ["c", "", "", "f", "b", "", "", "b", "b", "c", "j", "", "", "", "", "", "", "e", "b", "", "", "h"],
    "a": [""] * 10,
    "b": ["f", "", "", "c", "b", "c", "b", "", "f", "", "", "", "", ""],
}


def letters(first: str, last: str) -> list[str]:
    """Return the letters from one to another."""
    return [chr(k) for k in range(ord(first), ord(last) + 1)]


def numbers_of_paper() -> set[str]:
    """Return every equation number, such as 2.1a."""
    return {
        f"{section}.{k}{letter}"
        for section, ends in LETTERS.items()
        for k, end in enumerate(ends, start=1)
        for letter in (letters("a", end) if end else [""])
    }


def numbers_in(cell: str) -> list[str]:
    """Return the numbers a cell names: (2.1a), (2.3a-d), (5.10b, c)."""
    found = []
    for number, which in re.findall(r"\(([2-6ab]\.\d+)([a-j]?(?:[-,] ?[a-j])*)\)", cell):
        for part in which.split(",") if which else [""]:
            first, _, last = part.strip().partition("-")
            found += [number + letter for letter in (letters(first, last) if last else [first])]
    return found


def test_every_number_once():
    """The table has every numbered equation of the paper, each once."""
    listed = [number for row in EQUATIONS for number in numbers_in(row[0])]
    assert sorted(listed) == sorted(numbers_of_paper())


@pytest.mark.parametrize("row", EQUATIONS, ids=lambda row: row[0])
def test_places_exist(row):
    """Every name can be imported, every test file speaks of the equation or of the function."""
    places = re.findall(r"`([\w.]+)`", row[2])
    assert places or row[2].startswith("not ")
    for place in places:
        parts = place.split(".")
        for end in range(len(parts) - 1, 0, -1):
            try:
                found = importlib.import_module(".".join(["holdfast.dynamics", *parts[:end]]))
            except ModuleNotFoundError:
                continue
            for name in parts[end:]:
                assert hasattr(found, name) or name in getattr(found, "__annotations__", {}), place
                found = getattr(found, name, None)
            break
        else:
            pytest.fail(f"no module for {place}")
    (held_by,) = re.findall(r"`(\w+)`", row[3])
    (file,) = (ROOT / "tests" / "dynamics").rglob(f"{held_by}.py")
    text = file.read_text(encoding="utf-8")
    about = [place.split(".")[-1] for place in places] + [f"({n.rstrip('abcdefghij')}" for n in numbers_in(row[0])]
    about += ["METHODS"] if about[0] in METHODS else []  # a test over every method
    assert any(word in text for word in about)


def test_misprints():
    """All 22 misprints are listed; every equation listed is marked in the table."""
    listed = PAGE.partition("## Printed differently")[2]
    rows = [line for line in listed.splitlines() if line.startswith("| ") and not line.startswith("| where")]
    assert len(rows) == 22
    marked = {n.rstrip("abcdefghij") for row in EQUATIONS if "≠" in "".join(row) for n in numbers_in(row[0])}
    wrong = {number for row in rows for number in re.findall(r"([2-6ab]\.\d+)", row.split("|")[1])}
    # after (2.15), (5.1), (6.13) stand notes; before (b.10) lines without a number
    assert wrong - marked <= {"2.15"}
