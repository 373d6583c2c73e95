"""Two arms hold a box that is pushed: gradients through many runs find their joint stiffness and damping."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.optimize import minimize

import holdfast as hf
from holdfast.interop import value_and_gradient
from holdfast.robots import HOME, panda
from holdfast.view.figure_style import BLUE, DANGER, DPI, STYLE

OUT = Path(__file__).parent / "out"
STEP, STEPS, SYSTEMS = 2e-3, 300, 16  # s
EFFORT = 10.0  # price of a squared newton metre against that of a squared milliradian
FIRST = np.log([*[60.0] * 14, *[2.0] * 14])  # stiffness [N m/rad], damping [N m s/rad]


def chain_at_rest() -> tuple[hf.ClosedChain, hf.State]:
    """Return two Pandas that hold a box."""
    arms = {"left": panda().at(hf.Pose.translation(0, 0.35, 0)), "right": panda().at(hf.Pose.translation(0, -0.35, 0))}
    box = hf.HeldObject.box(mass=3.0, x=0.4, y=0.3, z=0.2)
    grasps = {
        "left": hf.Grasp("rigid", hf.contact_frame([0, 0.15, 0], into=[0, -1, 0])),
        "right": hf.Grasp("rigid", hf.contact_frame([0, -0.15, 0], into=[0, 1, 0])),
    }
    return hf.assemble(arms, box, grasps, q=dict.fromkeys(arms, HOME["panda"]))


def reflex(chain: hf.ClosedChain, state: hf.State) -> hf.ControlLaw:
    """Return springs and dampers about a configuration, beside the torques that hold it."""
    home, hold = state.q, hf.holding_torques(chain, state)

    def torque(t: Any, now: hf.State, memory: Any, given: Mapping[str, Any]) -> Any:
        return hold - given["stiffness"] * (now.q - home) - given["damping"] * now.qd, memory

    return hf.ControlLaw(torque, parameters={"stiffness": (14,), "damping": (14,)})


def main(out: Path = OUT) -> dict[str, Any]:
    """Return the costs on the way, and how far the joints were off before and after."""
    chain, state = chain_at_rest()
    rollout = hf.compile_rollout(chain, reflex(chain, state), scheme="midpoint")
    hold, costs = hf.holding_torques(chain, state), list[float]()
    # Boxes that were pushed, each another way; the arms take their share at once.
    twists = np.random.default_rng(0).normal(size=(SYSTEMS, 6)) * [0.3, 0.3, 0.3, 0.1, 0.1, 0.1]
    begin: dict[str, Any] = {"q": state.q, "qd": state.qd, "object_pose": state.object_pose, "object_twist": twists}

    def price(runs: Mapping[str, np.ndarray]) -> tuple[float, dict[str, np.ndarray]]:
        off, effort, share = 1e3 * (runs["q"] - state.q), runs["tau"] - hold, STEP / SYSTEMS
        value = share * float((off**2).sum() + EFFORT * (effort**2).sum())
        return value, {"q": 2e3 * share * off, "tau": 2 * share * EFFORT * effort}

    def given(gains: np.ndarray) -> dict[str, Any]:
        return dict(zip(("stiffness", "damping"), np.exp(gains).reshape(2, 14), strict=True))

    of, by = ("q", "tau"), ("stiffness", "damping")
    runs = value_and_gradient(rollout, price, of=of, by=by, step=STEP, steps=STEPS, **begin, **given(FIRST))

    def cost(gains: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = runs(np.exp(gains))
        costs.append(value)
        return value, slope * np.exp(gains)

    best = minimize(cost, FIRST, jac=True, method="L-BFGS-B", options={"maxiter": 12})
    records = {}
    for name, gains in {"first": FIRST, "learnt": best.x}.items():
        record = rollout.run(rollout.start(**begin, **given(gains)), STEPS * STEP, STEP, record=("q",))
        records[name] = record.t, np.sqrt(((record["q"] - state.q) ** 2).mean(axis=(1, 2)))
    print(f"cost {costs[0]:.3g} -> {best.fun:.3g} in {len(costs)} gradients of {SYSTEMS} runs")
    draw(out, records, np.exp(best.x))
    return {"costs": costs, "off": {name: off for name, (_, off) in records.items()}, "gains": np.exp(best.x)}


def draw(out: Path, records: Mapping[str, tuple[np.ndarray, np.ndarray]], gains: np.ndarray) -> None:
    """Draw how far the joints are off, and the gains."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.8), layout="constrained")
        left, right = figure.subplots(1, 2)
        for (name, (t, off)), colour in zip(records.items(), (DANGER, BLUE), strict=True):
            left.plot(t, 1e3 * off, color=colour, label=name)
        left.set(xlabel="t [s]", ylabel="joints off, root mean square [mrad]")
        left.legend(frameon=False)
        for k, (what, colour) in enumerate((("stiffness [N m/rad]", BLUE), ("damping [N m s/rad]", DANGER))):
            right.semilogy(np.arange(1, 15), gains[14 * k : 14 * k + 14], "o", color=colour, label=what)
        right.set(xlabel="joint, left arm first")
        right.legend(frameon=False)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "13_learn_gains.png", dpi=DPI)


if __name__ == "__main__":
    main()
