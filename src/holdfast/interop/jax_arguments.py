"""Arguments of functions of JAX: names, shapes and 64-bit numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from holdfast.errors import StateError
from holdfast.interop.jax_import import jax_numpy, require_jax
from holdfast.model import checks


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
