"""What the tests of JAX share."""

import pytest


@pytest.fixture
def wide():
    """64-bit numbers of JAX for a test, and what was there before after it."""
    import jax

    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)
