"""Descriptions of the arrays of exported functions for the C header."""

from __future__ import annotations

import math
from collections.abc import Iterable

from holdfast.compiled.derivative_schedule import FOUND, WITH
from holdfast.compiler.schedule import External
from holdfast.questions.arrays import ARRAYS, Row
from holdfast.questions.question import QUESTIONS

LAST, CONTROL = "last.", "control."  # prefixes of the arrays that a step carries on, and of its torques


def fields_of(externals: Iterable[str]) -> dict[str, str]:
    """Return the C names of arrays, without prefix where possible."""
    found: dict[str, str] = {}
    taken = {"workspace", *_KEYWORDS}
    for name in externals:
        field = name.removeprefix(LAST).removeprefix(CONTROL).replace(".", "_")
        while field in taken:
            field += "_"
        taken.add(field)
        found[name] = field
    return found


def meaning(name: str) -> str:
    """Return the description of an array; "" for a parameter of a law."""
    rows = {**ARRAYS, **{row: of for question in QUESTIONS.values() for row, of in question.rows.items()}}
    for prefix, words in ((WITH, "what is multiplied, as"), (FOUND, "derivatives by or of")):
        if name.startswith(prefix):
            rest = name.removeprefix(prefix)
            return f"{words} {described(rows[rest])}" if rest in rows else f"{words} {rest}"
    row = rows.get(name.removeprefix(LAST).removeprefix(CONTROL))
    return "" if row is None else described(row)


def described(row: Row) -> str:
    """Return an array's meaning and unit."""
    return f"{row.meaning} [{row.unit}]" if row.unit else row.meaning


def extent(external: External) -> str:
    """Return an array's shape in C syntax; [1] for a number."""
    return "".join(f"[{n}]" for n in external.shape) if math.prod(external.shape) and external.shape else "[1]"


_KEYWORDS = frozenset(
    """
    alignas alignof and asm auto bool break case catch char class const continue default delete do double else enum
    explicit export extern false float for friend goto if inline int long mutable namespace new not operator or
    private protected public register restrict return short signed sizeof static struct switch template this throw
    true try typedef typename union unsigned using virtual void volatile while
    """.split()  # noqa: SIM905
)
