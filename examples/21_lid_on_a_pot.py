"""Two arms, two objects: a lid comes down on a pot, is joined to it, and stays there when its hand lets go."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.control import GravityCompensation
from holdfast.view.figure_style import DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
OBJECTS = {"pot": hf.HeldObject.cylinder(3.0, 0.12, 0.2), "lid": hf.HeldObject.cylinder(0.5, 0.12, 0.01)}
RIM = hf.Pose.translation(0, 0, 0.105)  # the lid's place on the pot
HEIGHT, SPEED, STEP = 0.02, 0.1, 2e-2  # of the lid above it [m], downwards [m/s], [s]
BASES = {"pot": [1, 0, 0, 0, -0.6, 0, 0], "lid": [0, 0, 0, 1, 0.5, 0, 0]}
CONTACTS = {
    "pot": hf.contact_frame([-0.12, 0, 0], into=[1, 0, 0]),
    "lid": hf.contact_frame([0, 0, 0.005], into=[0, 0, -1]),
}


def kitchen() -> tuple[hf.ClosedChain, hf.State]:
    """Return one hand at the side of the pot, and one on top of the lid, which comes down."""
    places = {"pot": hf.Pose.translation(0, 0, 0.5), "lid": hf.Pose.translation(0, 0, 0.5 + HEIGHT) @ RIM}
    twists = {"pot": np.zeros(6), "lid": np.array([0, 0, 0, 0, 0, -SPEED])}
    arms, q, qd = {}, [], []
    for name, place in places.items():  # each hand finds its object by itself
        arm, grasp = hf.robots.panda(BASES[name]), hf.Grasp("rigid", CONTACTS[name])
        q.append(hf.assemble({"hand": arm}, OBJECTS[name], {"hand": grasp}, object_pose=place).state.q)
        qd.append(np.linalg.pinv(hf.dynamics.tip_jacobian(arm, q[-1])) @ twists[name])
        arms[f"{name}'s hand"] = arm
    grasps = {f"{name}'s hand": hf.Grasp("rigid", frame, of=name) for name, frame in CONTACTS.items()}
    chain = hf.ClosedChain(arms, objects=OBJECTS, grasps=grasps)
    poses = [place.wxyz_xyz for place in places.values()]
    return chain, hf.State(np.concatenate(q), np.concatenate(qd), poses, [*twists.values()])


def main(out: Path = OUT) -> dict[str, float]:
    """Return what is lost when the lid touches, and what each hand carries before, together, and at the end."""
    out.mkdir(parents=True, exist_ok=True)
    chain, state = kitchen()
    runs: list[Any] = [hf.simulate(chain, state, GravityCompensation(chain), HEIGHT / SPEED, STEP)]
    before, rest = runs[0].state(-1), hf.Closure("pot", "lid", hf.Grasp("rigid"), RIM)
    touched: Any = hf.dynamics.attach(chain, before, "rest", rest, here=True)
    jump = OBJECTS["pot"].mass * (touched.state.object_twist - before.object_twist)[0, 3:]
    on_pot = touched.by_grasp["pot's hand"] - touched.by_grasp["rest"]
    print(f"touched: {1e3 * touched.energy_change:.2f} mJ, impulse {touched.by_grasp['rest'][5]:.3f} N s on the lid")
    alone = hf.dynamics.release(touched.chain, "lid's hand")
    now = touched.state
    for one in (touched.chain, alone):
        runs += [hf.simulate(one, now, GravityCompensation(one, joint_damping=0.5), 0.2, STEP)]
        now = runs[-1].state(-1)
        found = hf.diagnose(one, now)
        print(f"{found.status}, rank {found.rank}, mobility {found.mobility}:", end=" ")
        print(", ".join(f"{name} {force:.2f} N up" for name, force in carried(runs[-1]).items()))
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 2.6), layout="constrained")
        axes, begun = figure.subplots(), 0.0
        for run in runs:
            for k, name in hands(run):
                label = name if run is runs[0] else None
                axes.plot(begun + run.t, run.grasp_wrench[:, k, 5], color=arm_style(k)[0], label=label)
            begun += run.t[-1]
            axes.axvline(begun, color="0.7", linewidth=0.6)
        axes.set(xlabel="time [s]", ylabel="force of a hand, upward [N]")
        axes.legend()
        figure.savefig(out / "21_lid_on_a_pot.png", dpi=DPI)
    lost = np.diff([hf.dynamics.kinetic_energy(*pair) for pair in ((chain, before), (touched.chain, touched.state))])[0]
    return {"lost": touched.energy_change, "energy_error": float(abs(lost - touched.energy_change)),
            "momentum_error": float(np.abs(jump - on_pot[3:]).max()), "end": carried(runs[-1])["pot's hand"],
            "imbalance": max(float(np.abs(run.imbalance).max()) for run in runs)}  # fmt: skip


def carried(run: hf.simulation.Trajectory) -> dict[str, float]:
    """Return the upward force of each hand at the end of a run [N]."""
    return {name: float(run.grasp_wrench[-1, k, 5]) for k, name in hands(run)}


def hands(run: hf.simulation.Trajectory) -> list[tuple[int, str]]:
    """Return the rows of the hands in a run's wrenches, and their names."""
    return [(k, name) for k, name in enumerate(run.rows) if name.endswith("hand")]


if __name__ == "__main__":
    main()
