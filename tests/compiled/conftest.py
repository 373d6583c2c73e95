"""The tests leave the user's cache of machine code alone."""

import pytest


@pytest.fixture(autouse=True, scope="package")
def no_cache():
    """Every program is compiled, unless a test sets a cache of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOLDFAST_CACHE", "off")
        yield
