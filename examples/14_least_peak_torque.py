"""Two arms carry a box from A to B: the path and the internal forces with the least peak torque."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.optimize import minimize
from scipy.special import softmax

import holdfast as hf
from holdfast.control.computed_torque import computed_torque
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.control.paths import RestToRest, Target
from holdfast.forces.margins import joint_limits
from holdfast.interop import value_and_gradient
from holdfast.robots import panda
from holdfast.spatial.scalar import cos, sin
from holdfast.view.figure_style import BLUE, DANGER, DPI, STYLE

OUT = Path(__file__).parent / "out"
STEP, STEPS, DURATION, SHARPNESS = 0.04, 40, 1.6, 200.0  # s, 1, s, of the smooth maximum
WAY, REACH = np.array([0.1, 0.3, 0.15]), 0.15  # m: from A to B; from the box's centre to either hand
WAVES = 2 * np.pi / DURATION * np.arange(1, 5)  # rad/s, of the bends
FIRST: dict[str, Any] = {"bend": np.zeros((4, 3)), "pull": np.zeros((4, 6))}  # m; 30 N and 3 N m


def chain_at_rest() -> tuple[hf.ClosedChain, hf.State]:
    """Return two Pandas that face each other and hold a box of 6 kg, at A."""
    arms = {"left": panda([1, 0, 0, 0, -0.55, 0, 0]), "right": panda([0, 0, 0, 1, 0.55, 0, 0])}
    sides = {"left": np.array([-1, 0, 0]), "right": np.array([1, 0, 0])}
    grasps = {name: hf.Grasp("rigid", hf.contact_frame(REACH * side, into=-side)) for name, side in sides.items()}
    box = hf.HeldObject.box(6.0, 2 * REACH, 0.2, 0.2)
    return hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, -0.2, 0.55])


def law_for(chain: hf.ClosedChain, start: hf.Pose) -> hf.ControlLaw:
    """Return computed torque along a bent way, the hands pulling at the box and thus at each other."""
    straight = RestToRest(start, WAY, duration=DURATION)

    def torque(t: Any, now: hf.State, memory: Any, given: Mapping[str, Any]) -> Any:
        (pose, *rates), wave = straight.at(t), WAVES * t
        shift = (1 - cos(wave)) @ given["bend"]
        bends = [np.array([0.0, 0.0, 0.0, *x @ given["bend"]]) for x in (WAVES * sin(wave), WAVES**2 * cos(wave))]
        bent = Target(hf.Pose.unchecked(pose.R, pose.p + shift), rates[0] + bends[0], rates[1] + bends[1])
        wanted = hf.control.ObjectTracking(chain, lambda t: bent).commanded_acceleration(t, now)
        moment, force = (cos(np.pi / DURATION * t * np.arange(4)) @ given["pull"]).reshape(2, 3) * [[3.0], [30.0]]
        lever = REACH * np.cross(now.object_frame.R[:, 0], force)
        pulls = np.array([[*lever + moment, *force], [*lever - moment, *-force]])  # about the hands; the sum is zero
        wrenches = commanded_wrenches(chain, now, wanted) + pulls
        return computed_torque(chain, now, wanted, wrenches, joint_damping=10.0), memory

    return hf.ControlLaw(torque, parameters={name: x.shape for name, x in FIRST.items()})


def main(out: Path = OUT) -> dict[str, Any]:
    """Return how much of the drives the straight way and the best one use, and the runs."""
    chain, state = chain_at_rest()
    law, most = law_for(chain, state.object_frame), joint_limits(chain)
    walls = {"q": (most.low, most.high), "qd": (-most.rate, most.rate)}  # before limits of joints and their rates

    def peak(records: Mapping[str, np.ndarray]) -> tuple[float, dict[str, np.ndarray]]:
        used = records["tau"] / most.effort
        value, share = np.logaddexp.reduce(SHARPNESS * used**2, axis=None) / SHARPNESS, softmax(SHARPNESS * used**2)
        slopes = {"tau": 2 * share * used / most.effort}
        for name, (low, high) in walls.items():
            x, half = records[name] - (low + high) / 2, (high - low) / 2
            beyond = np.maximum(np.abs(x) / half - 0.95, 0)
            value, slopes[name] = value + 1e2 * (beyond**2).sum(), 2e2 * beyond * np.sign(x) / half
        return float(value), slopes

    rollout = hf.compile_rollout(chain, law, scheme="midpoint")
    begin: dict[str, Any] = {name: getattr(state, name) for name in ("q", "qd", "object_pose", "object_twist")}
    cost = value_and_gradient(rollout, peak, of=["tau", *walls], by=[*FIRST], step=STEP, steps=STEPS, **begin, **FIRST)
    found = minimize(cost, cost.x0, jac=True, method="BFGS", options={"maxiter": 50})
    print(f"cost {cost(cost.x0)[0]:.3f} -> {found.fun:.3f} in {found.nfev} gradients by {len(cost.x0)} numbers")

    with rc_context(STYLE):
        figure, runs, used = Figure(figsize=(7.2, 2.8), layout="constrained"), {}, {}
        left, right = figure.subplots(1, 2)
        for name, given, colour in (("straight", FIRST, DANGER), ("optimised", cost.values(found.x), BLUE)):
            run = runs[name] = hf.simulate(chain, state, law, DURATION, STEP / 2, parameters=given, on_limit="stop")
            used[name] = np.abs(run.tau / most.effort).max(axis=1)
            print(f"{name}: at most {used[name].max():.3f} of a torque limit; {run.stopped or 'within all limits'}")
            left.plot(run.t, used[name], color=colour)
            right.plot(*run.object_pose[:, 5:].T, color=colour, label=name)
        left.set(xlabel="t [s]", ylabel="largest torque, part of its limit", ylim=(0, None))
        right.set(xlabel="y [m]", ylabel="z [m]", aspect="equal")
        right.legend(frameon=False)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "14_least_peak_torque.png", dpi=DPI)
    return {"used": used, "runs": runs, "cost": cost, "goal": state.object_frame.p + WAY}


if __name__ == "__main__":
    main()
