"""docs/coverage.md says how every question is answered."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.capabilities.page import forests, page, table
from tests.capabilities.questions import TABLES

PAGE = Path(__file__).parents[2] / "docs" / "coverage.md"
QUICK = [title for title, questions in TABLES.items() if all(q.quick for q in questions)]


@pytest.mark.slow
@pytest.mark.parametrize("title", QUICK)
def test_page_answers_as_the_library_does(title):
    """Each cell, and each refusal's words."""
    assert table(title) in PAGE.read_text()


@pytest.mark.long
def test_forests():
    """Chains with branches, loops or several objects answer what the page says, and refuse all else by name."""
    assert forests() in PAGE.read_text()


@pytest.mark.long
def test_whole_page():
    """Runs, machine code and derivatives too."""
    assert page() == PAGE.read_text()
