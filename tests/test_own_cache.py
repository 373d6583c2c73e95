"""All tests share one cache of machine code: a fixture that turns it off for some must not leak to the others."""

from __future__ import annotations

import os
import re
from pathlib import Path

TESTS = Path(__file__).parent
FROM_CONFTEST = re.compile(r"^from \S*conftest import (.*)$", re.MULTILINE)


def test_the_cache_is_on():
    """A test that needs none is within `tests/compiler`, or turns it off for itself."""
    assert Path(os.environ["HOLDFAST_CACHE"]).is_dir()


def test_no_fixture_is_imported_from_a_conftest():
    """One that applies by itself would apply until the whole run ends; constants may be imported."""
    imported = [(path.name, name) for path in TESTS.rglob("*.py") for name in FROM_CONFTEST.findall(path.read_text())]
    assert [(path, name) for path, name in imported if not name.isupper()] == []
