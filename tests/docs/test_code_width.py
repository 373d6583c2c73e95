"""Code on the site is at most as wide as its column, so that no block scrolls sideways."""

import pytest

from tests.docs.pages import DOCS, PAGES, fences, name

WIDEST = 88  # characters
TEXT = {"{math}", "{glossary}", "{eval-rst}"}


@pytest.mark.parametrize("page", [page for page in PAGES if DOCS in page.parents], ids=name)
def test_code_fits(page):
    """Every line of every fenced block; equations, the glossary and directives are no code."""
    wide = [line for language, text in fences(page) if language not in TEXT for line in text.splitlines()]
    assert [line for line in wide if len(line) > WIDEST] == []
