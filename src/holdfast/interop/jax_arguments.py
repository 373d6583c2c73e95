"""JAX, an optional dependency that is imported when needed, and the arguments of functions for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from holdfast.errors import MissingExtra, StateError
from holdfast.model import checks


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


def require_names(what: str, names: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Return names, each once.

    Raises:
        StateError: they are no list, or one of them is not known.
    """
    checks.instance(names, (list, tuple), f"to_jax: {what}", StateError)
    for name in names:
        if name not in known:
            raise StateError(f"to_jax: {what}: no {checks.short(name)}.{checks.did_you_mean(str(name), known)}")
    return tuple(dict.fromkeys(names))


def checked(given: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]], positional: int) -> list[Any]:
    """Return arguments as arrays of 64-bit numbers, in the order of their shapes.

    Args:
        given: the arguments by name.
        shapes: those that are expected.
        positional: how many of them, at the beginning, are no matter of choice.

    Raises:
        StateError: a name that is missing or not there, a wrong shape, numbers that are not real; JAX's 64-bit
            numbers are off.
    """
    require_jax()
    if given.keys() != shapes.keys():
        expected, got = (", ".join([*names][positional:]) or "none" for names in (shapes, given))
        raise StateError(f"parameters: expected {expected}, got {got}; see to_jax")
    return [_numbers(name, given[name], shape) for name, shape in shapes.items()]


def _numbers(name: str, value: Any, shape: tuple[int, ...]) -> Any:
    jnp = jax_numpy()
    try:
        x = jnp.asarray(value)
    except (TypeError, ValueError) as cause:
        raise StateError(f"{name}: expected real numbers, got {checks.short(value)}") from cause
    if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
        raise StateError(f"{name}: expected real numbers, got {x.dtype}")
    if x.shape != shape:
        raise StateError(f"{name}: expected shape {shape}, got {x.shape}; try jax.vmap for a batch")
    return x.astype(jnp.float64)
