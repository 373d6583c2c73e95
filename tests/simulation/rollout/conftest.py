"""The tests share a cache of machine code with those of `tests/compiled`, apart from the user's."""

from tests.compiled.conftest import own_cache

__all__ = ["own_cache"]
