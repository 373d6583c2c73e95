"""Public functions say what they take, return and refuse; those of the dynamics what they cost."""

import inspect
import re

import pytest

from tests.surface import PUBLIC

COSTED = ("holdfast.dynamics", "holdfast.forces")


FUNCTIONS = {name: value for name, value in PUBLIC.items() if inspect.isfunction(value)}


def missing(f) -> list[str]:
    """Return what a docstring does not say."""
    doc = inspect.getdoc(f) or ""
    described = doc.partition("Args:")[2]
    found = [
        name
        for name in inspect.signature(f).parameters
        if not re.search(rf"^\s+(\w+, )*\*{{0,2}}{name}\b.*:", described, re.MULTILINE)
    ]
    if not doc.startswith(("Return", "Write", "Make")) and "Returns:" not in doc:
        found.append("what it returns")
    if "Raises:" not in doc:
        found.append("what it refuses")
    if f.__module__.startswith(COSTED) and "O(" not in doc:
        found.append("what it costs")
    return found


@pytest.mark.parametrize("name", FUNCTIONS)
def test_docstring(name):
    """Nothing is missing."""
    assert missing(FUNCTIONS[name]) == []


def test_the_lint_finds_what_is_missing():
    """A docstring of one line lacks everything."""

    def bare(x):
        """Do something."""

    assert missing(bare) == ["x", "what it returns", "what it refuses"]
