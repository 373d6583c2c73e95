"""What pages call by `hf.name` in running text is there, under that name."""

import re

import pytest

import holdfast
from tests.docs.pages import FENCE, PAGES, name

CALLED = re.compile(r"`hf\.([a-zA-Z_][\w.]*)")


def missing(text: str) -> set[str]:
    """Return names after `hf.` in code spans of a page's running text that do not exist."""
    absent = set()
    for dotted in set(CALLED.findall(FENCE.sub("", text))):
        found = holdfast
        for part in dotted.rstrip(".").split("."):
            found = getattr(found, part, None)
        if found is None:
            absent.add(f"hf.{dotted}")
    return absent


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_named_functions_exist(page):
    """Every `hf.something` in a sentence or a table can be called by that name."""
    assert missing(page.read_text(encoding="utf-8")) == set()


def test_a_wrong_name_is_found():
    """A name that does not exist is reported, one that does is not; listings are left to the tests that run them."""
    assert missing("use `hf.forward_dynamic(chain)` or `hf.dynamics.closure`\n```text\n`hf.nothing`\n```\n") == {
        "hf.forward_dynamic"
    }
