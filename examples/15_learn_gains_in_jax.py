"""Two arms hold a box that is pushed: JAX learns their joint stiffness and damping through rollouts, for any push."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.robots import panda
from holdfast.view.figure_style import BLUE, DANGER, DPI, STYLE

OUT = Path(__file__).parent / "out"
STEP, STEPS, PUSHES, ROUNDS, RATE = 4e-3, 100, 8, 40, 0.15  # s, and of Adam's steps
EFFORT = 2e-3  # price of a squared newton metre against that of a squared centimetre
FIRST = np.log(np.array([[60.0] * 14, [2.0] * 14]))  # stiffness [N m/rad], damping [N m s/rad]


def chain_at_rest() -> tuple[hf.ClosedChain, hf.State]:
    """Return two Pandas that face each other and hold a box."""
    arms = {"left": panda([1, 0, 0, 0, -0.55, 0, 0]), "right": panda([0, 0, 0, 1, 0.55, 0, 0])}
    sides = {"left": np.array([-1, 0, 0]), "right": np.array([1, 0, 0])}
    grasps = {name: hf.Grasp("rigid", hf.contact_frame(0.15 * side, into=-side)) for name, side in sides.items()}
    box = hf.HeldObject.box(mass=3.0, x=0.3, y=0.2, z=0.2)
    return hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.65])


def reflex(chain: hf.ClosedChain, state: hf.State) -> hf.ControlLaw:
    """Return springs and dampers about a configuration, beside the torques that hold it."""
    home, hold = state.q, hf.holding_torques(chain, state)

    def torque(t: Any, now: hf.State, memory: Any, given: Mapping[str, Any]) -> Any:
        return hold - given["stiffness"] * (now.q - home) - given["damping"] * now.qd, memory

    return hf.ControlLaw(torque, parameters={"stiffness": (14,), "damping": (14,)})


def main(out: Path = OUT) -> dict[str, Any]:
    """Return the costs on the way, and how far boxes with other pushes are off before and after."""
    config: Any = jax.config
    config.update("jax_enable_x64", True)
    chain, state = chain_at_rest()
    rollout, hold = hf.compile_rollout(chain, reflex(chain, state), scheme="midpoint"), hf.holding_torques(chain, state)
    run = hf.interop.to_jax(rollout, of=["object_pose", "tau"], step=STEP, steps=STEPS)

    def off(gains: Any, twist: Any) -> tuple[Any, Any]:
        stiffness, damping = jnp.exp(gains)
        found = run(state.q, state.qd, state.object_pose, twist, stiffness=stiffness, damping=damping)
        return 100 * (found["object_pose"][:, 4:] - state.object_frame.p), found["tau"] - hold  # cm, N m

    @jax.jit
    def cost(gains: Any, twists: Any) -> Any:
        shift, effort = jax.vmap(off, (None, 0))(gains, twists)  # one rollout of all boxes
        return ((shift**2).sum(-1) + EFFORT * (effort**2).sum(-1)).mean()

    seen, unseen = np.random.default_rng(0).normal(size=(2, PUSHES, 6)) * 0.2  # rad/s, m/s
    learn, gains, mean, square, costs = jax.jit(jax.value_and_grad(cost)), FIRST, 0.0, 0.0, list[float]()
    for k in range(1, ROUNDS + 1):
        value, slope = learn(gains, seen)
        costs.append(float(value))
        mean, square = 0.9 * mean + 0.1 * slope, 0.99 * square + 0.01 * slope * slope  # Adam
        gains = gains - RATE * mean / (1 - 0.9**k) / (jnp.sqrt(square / (1 - 0.99**k)) + 1e-12)
    both = {"first": FIRST, "learnt": gains}
    others = {name: float(cost(x, unseen)) for name, x in both.items()}
    print(f"cost {costs[0]:.3g} -> {costs[-1]:.3g} in {ROUNDS} gradients of {PUSHES} runs each")
    print(f"pushes not used in training: {others['first']:.3g} -> {others['learnt']:.3g}")
    shifts = {name: np.array(jax.vmap(off, (None, 0))(x, unseen)[0]) for name, x in both.items()}
    draw(out, costs, shifts)
    return {"costs": costs, "unseen": others, "gains": np.exp(np.array(gains)), "learn": learn, "seen": seen}


def draw(out: Path, costs: list[float], shifts: Mapping[str, np.ndarray]) -> None:
    """Draw the cost while it is learnt, and how far boxes with other pushes move."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.8), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.semilogy(costs, color=BLUE)
        left.set(xlabel="gradients", ylabel="cost")
        for (name, shift), colour in zip(shifts.items(), (DANGER, BLUE), strict=True):
            far = np.linalg.norm(shift, axis=2).T
            lines = right.plot(STEP * np.arange(1, STEPS + 1), far, color=colour, linewidth=0.8)
            lines[0].set_label(name)
        right.set(xlabel="t [s]", ylabel="box off, pushes not learnt from [cm]")
        right.legend(frameon=False)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "15_learn_gains_in_jax.png", dpi=DPI)


if __name__ == "__main__":
    main()
