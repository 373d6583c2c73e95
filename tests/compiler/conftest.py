"""The tests of this package compile every program; the fixture is not to be imported, lest it be others' too."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def no_cache():
    """Every program is compiled, unless a test sets a cache of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOLDFAST_CACHE", "off")
        yield
