"""The tests leave the user's cache of machine code alone, and share one of their own."""

import pytest


@pytest.fixture(autouse=True, scope="package")
def own_cache(tmp_path_factory):
    """What one test compiles the others find, in every process of this run."""
    place = tmp_path_factory.getbasetemp()
    if place.name.startswith("popen-"):  # a worker's: its parent is the run's
        place = place.parent
    folder = place / "machine-code"
    folder.mkdir(mode=0o700, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOLDFAST_CACHE", str(folder))
        yield
