"""Two arms lift a box by friction: the least force that keeps the hands from slipping, at 80 % of the effort."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.control import ObjectImpedance, PostureControl, RestToRest, cooperative_law
from holdfast.forces.margins import joint_limits
from holdfast.robots import panda
from holdfast.view.figure_style import BLACK, BLUE, DANGER, DPI, STYLE, VERMILLION

OUT = Path(__file__).parent / "out"
STIFFNESS, DAMPING = np.repeat([20.0, 400.0], 3), np.repeat([8.0, 100.0], 3)  # N m/rad, N/m; N m s/rad, N s/m
RUBBER, MARGIN, EFFORT = hf.Friction(mu=0.8, torsion_radius=0.02), 2.0, 0.8  # m; N; share of the drives' limits


def main(out: Path = OUT) -> dict[str, float]:
    """Return the numbers that this example prints."""
    arms = {"left": panda([1, 0, 0, 0, -0.55, 0, 0]), "right": panda([0, 0, 0, 1, 0.55, 0, 0])}
    sides = {"left": np.array([-1, 0, 0]), "right": np.array([1, 0, 0])}
    grasps = {n: hf.Grasp("softfinger", hf.contact_frame(0.15 * s, into=-s), contact=RUBBER) for n, s in sides.items()}
    box = hf.HeldObject.box(3.0, 0.3, 0.2, 0.2)
    chain, state = hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.62])
    limits = hf.forces.ForceLimits(effort=EFFORT, least_margin=MARGIN)
    path = RestToRest(state.object_frame, displacement=[0, 0, 0.2], duration=0.8)
    motion, posture = ObjectImpedance(path, STIFFNESS, DAMPING), PostureControl(rest=state.q, clearance=0.1)
    law = cooperative_law(chain, motion, posture=posture, limits=limits)
    run = hf.simulate(chain, state, law, duration=1.0, step=0.005)

    # What the least force is compared with: the force at rest that is furthest from slipping.
    firm = hf.forces.distribute(chain, state, np.zeros(6), limits=hf.forces.ForceLimits(effort=EFFORT), form="margin")
    heaviest = hf.forces.lift_margin(chain, state, payload=True, limits=limits)

    # The left hand presses along x; friction carries the load, and a moment about x that counts as one on a ring.
    moment, _, _, squeeze, *sideways = run.grasp_wrench[:, 0].T
    friction = np.sqrt(np.square([*sideways, moment / RUBBER.torsion_radius]).sum(axis=0))
    used = np.abs(run.tau / joint_limits(chain).effort).max(axis=1)
    found = {
        "squeeze_at_rest": float(squeeze[0]),
        "largest_squeeze": float(squeeze.max()),
        "coulomb_error": float(np.abs(RUBBER.mu * squeeze - friction - MARGIN).max()),
        "least_margin": float(run.margin.min()),
        "most_effort": float(used.max()),
        "firmest_squeeze": float(firm.grasp_wrench[0, 3]),
        "firmest_margin": firm.margin,
        "payload": box.mass * heaviest.value,
        "lifted": float(run.object_pose[-1, 6] - run.object_pose[0, 6]),
    }
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.plot(run.t, squeeze, color=BLUE, label="squeeze")
        left.plot(run.t, friction / RUBBER.mu, "--", color=BLACK, label="onset of slip")
        left.plot(run.t, run.margin.min(axis=1), color=VERMILLION, label="least margin")
        left.set(xlabel="t [s]", ylabel="force of the left hand [N]", ylim=(0, None))
        left.legend(frameon=False)
        right.plot(run.t, 100 * used, color=BLUE)
        right.axhline(100 * EFFORT, color=DANGER, linestyle="--")
        right.set(xlabel="t [s]", ylabel="largest torque [% of its limit]", ylim=(0, 100))
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "16_lift_a_box.png", dpi=DPI)

    print(f"squeeze: {found['squeeze_at_rest']:.2f} N at rest, at most {found['largest_squeeze']:.2f} N in motion")
    print(f"margin of the grasps: at least {found['least_margin']:.4f} N; drives: at most {found['most_effort']:.0%}")
    print(f"furthest from slipping, {firm.margin:.1f} N, is a squeeze of {found['firmest_squeeze']:.1f} N")
    print(f"the heaviest box that can be held so: {found['payload']:.2f} kg")
    return found


if __name__ == "__main__":
    main()
