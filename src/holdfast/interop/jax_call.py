"""Calling machine code from JAX programs; under vmap, a batch is computed in one call."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from holdfast.compiled.foreign_code import ForeignCode, handler
from holdfast.interop.jax_arguments import jax_numpy, require_jax
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

JaxRoute = Literal["ffi", "callback"]
JaxCall = Callable[[int | None, Sequence[Any]], tuple[Any, ...]]  # (number of systems or None, given arrays) -> results
HostCall = Callable[[int | None, Sequence[Array]], tuple[Array, ...]]  # the same on NumPy's arrays
_TARGET = "holdfast"


@functools.cache
def available_route() -> JaxRoute:
    """Return how JAX programs call machine code: by its address or, if JAX does not support this, through Python."""
    jax = require_jax()
    if jax.default_backend() != "cpu":
        return "callback"
    try:
        jax.ffi.register_ffi_target(_TARGET, handler(), platform="cpu")
    except RuntimeError:  # this version of JAX has another foreign function interface
        return "callback"
    return "ffi"


def operation(
    chain: ClosedChain, code: ForeignCode, given: Sequence[str], route: JaxRoute
) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Return machine code as a JAX function from named arrays to named results; vmap makes it one call for a batch.

    Args:
        chain: the chain to which the code belongs.
        code: the machine code.
        given: names of the arrays with which the function will be called; the others are taken from the chain.
        route: how the code is called.
    """
    run = _by_address(code, given) if route == "ffi" else _through_python(chain, code, given)
    call = batched(run, [len(code.externals[name].shape) for name in given])

    def named(arrays: Mapping[str, Any]) -> dict[str, Any]:
        return dict(zip(code.results, call(*(arrays[name] for name in given)), strict=True))

    return named


def _by_address(code: ForeignCode, given: Sequence[str]) -> JaxCall:
    """Return a function that calls the code from within an XLA program."""
    ffi, key = require_jax().ffi, np.int64(code.publish())
    inputs = [name for name, external in code.externals.items() if external.role != "output"]
    outputs = [name for name, external in code.externals.items() if external.role == "output"]
    places = [outputs.index(name) for name in code.results.values()]

    def run(batch: int | None, arrays: Sequence[Any]) -> tuple[Any, ...]:
        known = dict(code.own) | dict(zip(given, arrays, strict=True))
        call = ffi.ffi_call(_TARGET, _shapes([code.externals[name].shape for name in outputs], batch))
        found = call(*(known[name] for name in inputs), key=key)
        return tuple(found[k] for k in places)

    return run


def _through_python(chain: ClosedChain, code: ForeignCode, given: Sequence[str]) -> JaxCall:
    """Return a function that calls the code by callbacks into Python, which every backend of JAX supports."""
    outputs = list(code.results.values())

    def host(batch: int | None, values: Sequence[Array]) -> tuple[Array, ...]:
        result = code.run(chain, dict(zip(given, values, strict=True)), batch)
        return tuple(result.array(name) for name in outputs)

    return callback(host, [code.externals[name].shape for name in outputs])


def callback(host: HostCall, shapes: Sequence[tuple[int, ...]]) -> JaxCall:
    """Return a JAX function that calls a function of NumPy arrays, for one system or a batch.

    Args:
        host: function of the number of systems (None for one) and the arrays that returns the results.
        shapes: shapes of the results for one system.
    """
    jax = require_jax()

    def run(batch: int | None, arrays: Sequence[Any]) -> tuple[Any, ...]:
        def called(*values: Any) -> tuple[Array, ...]:
            return host(batch, [np.require(x, np.float64, ["C", "A"]) for x in values])

        return tuple(jax.pure_callback(called, tuple(_shapes(shapes, batch)), *arrays))

    return run


def _shapes(shapes: Sequence[tuple[int, ...]], batch: int | None) -> list[Any]:
    lead = () if batch is None else (batch,)
    jax, jnp = require_jax(), jax_numpy()
    return [jax.ShapeDtypeStruct((*lead, *shape), jnp.float64) for shape in shapes]


def batched(run: JaxCall, ranks: Sequence[int]) -> Callable[..., tuple[Any, ...]]:
    """Return the call for one system; its vmap, also a nested one, is one call for a batch."""
    custom_vmap, jnp = require_jax().custom_batching.custom_vmap, jax_numpy()

    @custom_vmap
    def one(*arrays: Any) -> tuple[Any, ...]:
        return run(None, arrays)

    @custom_vmap
    def many(*arrays: Any) -> tuple[Any, ...]:
        return run(next(len(x) for x, rank in zip(arrays, ranks, strict=True) if x.ndim > rank), arrays)

    @one.def_vmap
    def _(size: int, batched: Sequence[bool], *arrays: Any) -> Any:
        found = many(*arrays)
        return found, (True,) * len(found)

    @many.def_vmap
    def _(size: int, batched: Sequence[bool], *arrays: Any) -> Any:
        outer = [x if is_batched else x[None] for x, is_batched in zip(arrays, batched, strict=True)]
        inner = next((x.shape[1] for x, rank in zip(outer, ranks, strict=True) if x.ndim == rank + 2), 1)

        def flat(x: Any, rank: int, is_batched: bool) -> Any:
            own = x.shape[x.ndim - rank :]
            if not is_batched and x.ndim == rank + 1:
                return x[0]  # shared by all systems
            rows = x if x.ndim == rank + 2 else x[:, None]
            return jnp.broadcast_to(rows, (size, inner, *own)).reshape(size * inner, *own)

        found = many(*map(flat, outer, ranks, batched))
        whole = tuple(x.reshape(size, inner, *x.shape[1:]) for x in found)
        return whole, (True,) * len(whole)

    return one
