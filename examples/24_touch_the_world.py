"""A free part meets the world: pushed along a table, pressed on a wall with 20 N, and inserted into a hole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.spatial import rotation
from holdfast.view.figure_style import DPI, STYLE
from holdfast.world import Circle, HalfSpace, Hole, Rod, Sphere, Touching, corners

OUT = Path(__file__).parent / "out"
MASS, EDGES, MU, PUSH = 1.0, (0.2, 0.2, 0.1), 0.3, 5.0
PRESS, STIFFNESS, DAMPING, INTEGRAL = 20.0, 400.0, 80.0, 30.0


def run_of(body: Any, touching: Touching, at: Any, wrench: Any, duration: float, step: float, **how: Any) -> Any:
    """Return the run of a free body with an external wrench."""
    chain, start = hf.ClosedChain({}, body, {}, touching=touching), hf.State([], [], hf.Pose.translation(*at))
    return hf.simulate(chain, start, None, duration, step, inputs=wrench, **how)


def pushed() -> Any:
    """Return a box that is pushed along a table for 0.3 s, and slides until friction stops it."""
    table = HalfSpace(friction=MU)
    force = lambda t: hf.Inputs(object_wrench=[0, 0, 0, PUSH * (t < 0.3), 0, 0])  # noqa: E731
    box = hf.HeldObject.box(MASS, *EDGES)
    return run_of(box, Touching(corners(*EDGES), {"table": table}), [0, 0, 0.05], force, 0.6, 0.05, breakpoints=[0.3])


def pressed() -> Any:
    """Return a tool that is pressed on a wall: force along x by its integral, the other directions by springs."""
    wall, tip = HalfSpace(normal=[-1, 0, 0], offset=-0.1, friction=0.1), Sphere([0.05, 0, 0], 0.05)
    goal = np.array([0.0, 0.05, 0.0])

    def hybrid(t: float, state: hf.State) -> hf.Inputs:
        v = state.object_twist
        f = STIFFNESS * (goal - state.object_frame.p) - DAMPING * v[3:] + [0.0, 0.0, 9.81 * MASS]
        f[0] = PRESS * (1.0 - np.exp(-INTEGRAL * t)) - DAMPING * v[3]
        turning = -20.0 * rotation.log(state.object_frame.R) - 0.6 * v[:3]
        return hf.Inputs(object_wrench=[*turning, *f])

    body = hf.HeldObject.sphere(MASS, 0.1)
    return run_of(body, Touching({"tip": tip}, {"wall": wall}), [-0.01, 0, 0], hybrid, 0.6, 0.01, contacts="steps")


def inserted() -> Any:
    """Return a peg that begins 0.5 mm beside the hole, and is led into it by the chamfer."""
    hole = Hole(radius=0.0101, chamfer=0.002, friction=0.1)
    r, z = hole.sides[-1].foot
    touching = Touching(
        {"rim": Circle([0, 0, -0.0295], [0, 0, 1], 0.0095, 0.0005)},
        {"hole": hole},
        solids={"peg": Rod(radius=0.01, half_length=0.03, edge=0.0005, friction=0.1)},
        edges={"edge": Circle([0, 0, z], [0, 0, 1], r, hole.edge)},
    )
    line = np.array([0.0005, 0.0, 0.0305])

    def impedance(t: float, state: hf.State) -> hf.Inputs:
        v, now = state.object_twist, state.object_frame
        f = 2000.0 * (line - [0.0, 0.0, 0.08 * t] - now.p) - 126.0 * np.add(v[3:], [0.0, 0.0, 0.08]) + [0.0, 0.0, 19.62]
        return hf.Inputs(object_wrench=[*(-20.0 * rotation.log(now.R) - 0.6 * v[:3]), *f])

    body = hf.HeldObject(2.0, 5e-3 * np.eye(3))
    return run_of(body, touching, line, impedance, 0.2, 0.005, contacts="steps")


def main(out: Path = OUT) -> dict[str, float]:
    """Return how far the box slides, the force on the wall, and how deep the peg is."""
    out.mkdir(parents=True, exist_ok=True)
    box, tool, peg = pushed(), pressed(), inserted()
    found = {
        "distance": box.object_pose[-1, 4],
        "force": float(-tool.touch_force[-1, 0, 0]),
        "depth": 0.03 - peg.object_pose[-1, 6],
        "aside": float(np.hypot(*peg.object_pose[-1, 4:6])),
        "imbalance": max(float(np.abs(run.imbalance).max()) for run in (box, peg)),
    }
    print(f"the box stops after {found['distance']:.4f} m, the wall bears {found['force']:.3f} N,")
    print(f"the peg is {1e3 * found['depth']:.1f} mm deep, {1e3 * found['aside']:.3f} mm beside the axis")
    with rc_context(STYLE):
        figure = Figure((7.0, 2.4), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        left.plot(box.t, box.object_pose[:, 4])
        middle.plot(tool.t, -tool.touch_force[:, 0, 0])
        right.plot(peg.t, 1e3 * (0.03 - peg.object_pose[:, 6]))
        for axes, what in ((left, "way of the box [m]"), (middle, "force on the wall [N]"), (right, "depth [mm]")):
            axes.set(xlabel="t [s]", title=what)
        figure.savefig(out / "24_touch_the_world.png", dpi=DPI)
    return found


if __name__ == "__main__":
    main()
