"""Importing JAX, an optional dependency, when it is first needed."""

from __future__ import annotations

from typing import Any

from holdfast.errors import MissingExtra, StateError


def require_jax() -> Any:
    """Return the module `jax`, after checking that 64-bit numbers are enabled.

    Raises:
        MissingExtra: JAX is not installed, or too old.
        StateError: 64-bit numbers are disabled.
    """
    try:
        import jax
        import jax.custom_batching
        import jax.ffi
    except ImportError as cause:
        raise MissingExtra("to_jax needs jax; try pip install 'holdfast[jax]'") from cause
    config: Any = jax.config
    if not config.jax_enable_x64:
        raise StateError(
            'to_jax: expected 64-bit numbers, got jax_enable_x64 off; try jax.config.update("jax_enable_x64", True)'
            " before the first array is made"
        )
    return jax


def jax_numpy() -> Any:
    """Return `jax.numpy`, for functions that run within a JAX program."""
    import jax.numpy

    return jax.numpy
