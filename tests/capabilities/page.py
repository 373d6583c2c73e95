"""Write docs/coverage.md: every kind of chain against every question.

python -m tests.capabilities.page [--write docs/coverage.md]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tests.capabilities.chains import CHAINS, FORESTS, chain_with
from tests.capabilities.questions import TABLES, Answer, answer

REFUSED = (
    *("expected serial arms", "expected one object", "a chain that is answered as a forest"),
    *("no wrench can carry", "one that the chain can have"),  # an object that nothing holds
)
HEAD = """# Coverage

A smoke test: which functions work with which kinds of chain? `make capabilities` (`tests/capabilities/`) generates this
page by trying all of them. Each section lists the gaps first, with the message of the error raised; everything else
works. Each row of a table is a chain with one special feature, with two arms of seven joints unless it says otherwise;
each column is a function. *Yes* means that it returned finite numbers. Whether the numbers are right is checked by
other tests.
"""


def answers(title: str, capability: str) -> list[Answer]:
    """Return how a kind of chain answers the questions of a table."""
    return [answer(question, chain_with(capability)) for question in TABLES[title]]


def table(title: str, ask: Callable[..., Iterable[Any]] = map) -> str:
    """Return a section: the refusals in words, and the table of answers.

    Args:
        title: of the table.
        ask: `map`, or one that calls in several processes.
    """
    questions = TABLES[title]
    rows = [["", *(q.name for q in questions)], ["---"] * (len(questions) + 1)]
    refusals: dict[tuple[str, str], list[str]] = {}
    for capability, found in zip(CHAINS, ask(answers, repeat(title), CHAINS), strict=True):
        rows.append([f"**{capability}**", *(f"`{a.refused_by}`" if a.refused_by else "yes" for a in found)])
        for q, a in zip(questions, found, strict=True):
            if a.refused_by:
                refusals.setdefault((q.name, a.message), []).append(capability)
    lines = [f"| {' | '.join(row)} |" for row in rows]
    said = [f"* {name}, with {' / '.join(kinds)}: *{message}*" for (name, message), kinds in refusals.items()]
    return "\n".join([f"## {title}", "", *(said or ["No gaps."]), "", *lines]) + "\n"


def forests() -> str:
    """Return a section: what chains that are answered as forests are asked, and what they refuse."""
    rows = ["|  | answered | refused: all else |", "| --- | --- | --- |"]
    for capability in FORESTS:
        asked = [(q.name, answer(q, chain_with(capability))) for questions in TABLES.values() for q in questions]
        refused = [a for _, a in asked if a.refused_by]
        assert all(any(words in a.message for words in REFUSED) for a in refused[1:]), refused
        answered = ", ".join(name for name, a in asked if not a.refused_by)
        said = next(a.message for a in refused if "expected serial arms" in a.message)
        rows.append(f"| **{capability}** | {answered} | {len(refused)} questions: *{said}* |")
    head = "Two arms of seven joints with [branches, loops or several objects](how_to/branches.md), which are forests."
    return "\n".join(["## Branches, loops, several objects", "", head, "", *rows]) + "\n"


def page() -> str:
    """Return the whole page; every processor takes part."""
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        return "\n".join([HEAD, *(table(title, pool.map) for title in TABLES), forests()])


def main() -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="the file to write")
    path, text = parser.parse_args().write, page()
    print(text) if path is None else path.write_text(text)


if __name__ == "__main__":
    main()
