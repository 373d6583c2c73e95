"""Who carries how much of a box whose centre of mass is off the middle: the law of the lever, and half of it.

Two ball grasps on a line share a load as the lever says, 1/2 +- c / (2 d). Rigid hands bear moments too, and the
smallest wrenches that do it (moments counted at the length d) take half of the unequal part by them: 1/2 +- c / (4 d).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.robots import panda
from holdfast.view.figure_style import BLACK, DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
HALF = 0.15  # d: from the box's middle to each hand [m]


def main(out: Path = OUT) -> dict[str, np.ndarray]:
    """Return the numbers that this example prints; shares are (mass centres, arms)."""
    arms = {"left": panda([1, 0, 0, 0, -0.55, 0, 0]), "right": panda([0, 0, 0, 1, 0.55, 0, 0])}
    box = hf.HeldObject.box(mass=3.0, x=2 * HALF, y=0.2, z=0.2)
    contacts = {
        "left": hf.contact_frame([-HALF, 0, 0], into=[1, 0, 0]),
        "right": hf.contact_frame([HALF, 0, 0], into=[-1, 0, 0]),
    }
    offsets = np.linspace(-0.12, 0.12, 9)  # c: of the mass centre from the box's middle, towards the right hand [m]
    shares = {
        kind: shares_of(arms, box, {name: hf.Grasp(kind, frame) for name, frame in contacts.items()}, offsets)
        for kind in ("rigid", "ball")
    }
    draw(out, offsets, shares)
    for kind, share in shares.items():
        print(f"{kind:>5} grasps, mass centre 0.12 m to the right: left {share[-1, 0]:.1%}, right {share[-1, 1]:.1%}")
    return {"offsets": offsets, **shares}


def shares_of(
    arms: dict[str, hf.Arm], box: hf.HeldObject, grasps: dict[str, hf.Grasp], offsets: np.ndarray
) -> np.ndarray:
    """Return the part of the load that each arm carries, for every place of the mass centre."""
    chain, state = hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.72])
    found = []
    for offset in offsets:
        loaded = replace(chain, held_object=replace(box, com=[offset, 0, 0]))
        result = hf.forward_dynamics(loaded, state, hf.holding_torques(loaded, state))
        found.append(hf.forces.split(loaded, state, result.grasp_wrench).load_share)
    return np.array(found)


def draw(out: Path, offsets: np.ndarray, shares: dict[str, np.ndarray]) -> None:
    """Draw the shares over the place of the mass centre, and the two closed forms."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 2.8), layout="constrained")
        axes = figure.subplots()
        for (kind, share), marker, line, lever in zip(shares.items(), "os", ("-", "--"), (4, 2), strict=True):
            for k, name in enumerate(("left", "right")):
                part = 0.5 + (-1, 1)[k] * offsets / (lever * HALF)
                label, colour = None if k else f"1/2 ± c / {lever}d", arm_style(k)[0]
                axes.plot(offsets, 100 * part, line, color=BLACK, linewidth=0.7, label=label)
                axes.plot(offsets, 100 * share[:, k], marker, color=colour, markersize=4, label=f"{name}, {kind}")
        axes.set(xlabel="mass centre from the middle, c [m]", ylabel="share of the load [%]")
        figure.legend(loc="outside upper center", ncols=2)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "04_who_carries_what.png", dpi=DPI)


if __name__ == "__main__":
    main()
