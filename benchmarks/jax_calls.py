"""What a call through JAX costs beside the machine code's own, and a gradient through a rollout: two Pandas with a box.

Run it with HOLDFAST_COMPILE unset, on a quiet machine: `python benchmarks/jax_calls.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import holdfast as hf
from holdfast.robots import panda

CALLS, ROUNDS = 2000, 7
STEP, STEPS, SYSTEMS = 1e-3, 50, 16


def seconds(call: Callable[[], Any], calls: int = CALLS) -> float:
    """Return the least process time of a call over several rounds [s]."""
    call()
    rounds = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        for _ in range(calls):
            call()
        rounds.append((time.process_time() - begin) / calls)
    return min(rounds)


def main() -> None:
    """Print microseconds a call."""
    jax.config.update("jax_enable_x64", True)
    arms = {
        "left": panda(hf.Pose.translation(-0.55, 0, 0)),
        "right": panda(hf.Pose.from_rpy(0, 0, np.pi, [0.55, 0, 0])),
    }
    places = {"left": ([-0.15, 0, 0], [1, 0, 0]), "right": ([0.15, 0, 0], [-1, 0, 0])}
    grasps = {name: hf.Grasp("rigid", hf.contact_frame(at, into=into)) for name, (at, into) in places.items()}
    box = hf.HeldObject.box(mass=3.0, x=0.3, y=0.2, z=0.2)
    chain, state = hf.assemble(arms, box, grasps, object_pose=hf.Pose.translation(0, 0, 0.72))
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
        return seconds(lambda: jax.block_until_ready(program(*given)))

    vjp, dispatch = seconds(own.run), of(empty)
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
    own, through = seconds(by_tape, 5), seconds(lambda: jax.block_until_ready(whole(torques)), 5)
    print(f"rollout of {SYSTEMS} systems, {STEPS} steps: value and gradient by the tape {1e3 * own:.1f} ms, ", end="")
    print(f"in JAX {1e3 * through:.1f} ms, {through / own:.2f} times as much")


if __name__ == "__main__":
    main()
