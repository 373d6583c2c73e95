"""The tests leave the user's cache of machine code alone, and share one of their own."""

import os
from pathlib import Path

import pytest


@pytest.fixture(autouse=True, scope="package")
def own_cache(tmp_path_factory):
    """What one test compiles the others find, in every process of this run, or of all that `tests.portable` starts."""
    place = tmp_path_factory.getbasetemp()
    if place.name.startswith("popen-"):  # a worker's: its parent is the run's
        place = place.parent
    folder = Path(os.environ.get("HOLDFAST_TEST_CACHE") or place / "machine-code")
    folder.mkdir(mode=0o700, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOLDFAST_CACHE", str(folder))
        yield
