"""What a call through JAX costs beside the machine code's own, and a gradient through a rollout: two Pandas with a box.

Run it with HOLDFAST_COMPILE unset, on a quiet machine: `python benchmarks/jax_calls.py`.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.clock import least_time
from benchmarks.bench.systems import facing_pandas

CALLS, ROUNDS = 2000, 7
STEP, STEPS, SYSTEMS = 1e-3, 50, 16


def main() -> None:
    """Print microseconds a call."""
    jax.config.update("jax_enable_x64", True)
    chain, state = facing_pandas()
    values = (state.q, state.qd, hf.holding_torques(chain, state), state.object_pose, state.object_twist)
    fast = hf.compile(chain)
    f = hf.interop.to_jax(fast, of=["qdd"])

    own = fast.forward_dynamics.bind("vjp", of=["qdd"])
    for name, x in zip(("q", "qd", "tau", "object_pose", "object_twist"), values, strict=True):
        own.arrays[name][...] = x
    own.given["qdd"][...] = 1.0
    assert own().name == "OK"

    given = [jnp.asarray(x) for x in values]
    empty = jax.jit(lambda *x: x)
    forward = jax.jit(f)
    gradient = jax.jit(jax.grad(lambda *x: jnp.sum(f(*x)["qdd"]), argnums=(0, 1, 2, 3, 4)))

    def of(program: Callable[..., Any]) -> float:
        return least_time(lambda: jax.block_until_ready(program(*given)), CALLS, ROUNDS)

    vjp, dispatch = least_time(own.run, CALLS, ROUNDS), of(empty)
    print(f"route {f.route}")
    print(f"machine code's own gradient {1e6 * vjp:6.1f} us; an empty jit {1e6 * dispatch:6.1f} us")
    print(f"JAX: forward dynamics       {1e6 * of(forward):6.1f} us")
    through = of(gradient)
    ratio = through / (vjp + dispatch)
    print(f"JAX: gradient               {1e6 * through:6.1f} us, {ratio:.2f} times both together")
    of_rollouts(hf.compile_rollout(chain, scheme="midpoint"), state, np.asarray(values[2]))


def of_rollouts(rollout: Any, state: hf.State, tau: np.ndarray) -> None:
    """Print milliseconds of a value and its gradient through steps of many systems, by the tape and in JAX."""
    given = (state.q, state.qd, state.object_pose, state.object_twist)
    torques = tau + np.random.default_rng(0).normal(size=(SYSTEMS, len(tau)))
    run = hf.interop.to_jax(rollout, of=["q"], step=STEP, steps=STEPS)

    def by_tape() -> Any:
        systems = rollout.start(np.tile(state.q, (SYSTEMS, 1)), *given[1:], tau=torques)
        tape = rollout.tape(systems, STEP, steps=STEPS, record=["q"])
        return tape.vjp(along={"q": np.ones_like(tape.records["q"])}, by=["tau"]).tau

    whole = jax.jit(jax.value_and_grad(lambda tau: jax.vmap(lambda one: run(*given, tau=one)["q"].sum())(tau).sum()))
    assert np.allclose(whole(torques)[1], by_tape(), rtol=1e-9, atol=0)
    own, through = (least_time(call, 5, ROUNDS) for call in (by_tape, lambda: jax.block_until_ready(whole(torques))))
    print(f"rollout of {SYSTEMS} systems, {STEPS} steps: value and gradient by the tape {1e3 * own:.1f} ms, ", end="")
    print(f"in JAX {1e3 * through:.1f} ms, {through / own:.2f} times as much")


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
