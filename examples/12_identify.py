"""Two arms carry an unknown box: its mass, centre of mass and inertia are estimated from noisy wrist sensors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.control import ObjectTracking
from holdfast.control.paths import Target
from holdfast.identification import Identification, Recording
from holdfast.robots import HOME, panda
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, cos, sin
from holdfast.view.figure_style import BLUE, DANGER, DPI, STYLE

OUT = Path(__file__).parent / "out"
STEP, DURATION, NOISE = 0.02, 3.0, 0.05  # s, s, of the sensors' root mean square
RATES = 2 * np.pi * np.array([0.9, 0.6, 1.1, 0.8, 0.7, 1.0])  # rad/s
PAYLOAD = hf.HeldObject(3.0, np.diag([0.06, 0.03, 0.05]), com=[0.03, -0.02, 0.05])  # what it is
MODEL = hf.HeldObject.box(mass=2.0, x=0.4, y=0.3, z=0.2)  # what it is thought to be


def chain_with(payload: hf.HeldObject) -> tuple[hf.ClosedChain, hf.State]:
    """Return two Pandas that hold a payload."""
    arms = {"left": panda().at(hf.Pose.translation(0, 0.35, 0)), "right": panda().at(hf.Pose.translation(0, -0.35, 0))}
    grasps = {
        "left": hf.Grasp("rigid", hf.contact_frame([0, 0.15, 0], into=[0, -1, 0])),
        "right": hf.Grasp("rigid", hf.contact_frame([0, -0.15, 0], into=[0, 1, 0])),
    }
    chain, state = hf.assemble(arms, payload, grasps, q=dict.fromkeys(arms, HOME["panda"]))
    return chain, state


def swing(chain: hf.ClosedChain, state: hf.State, turn: float, shift: float) -> Recording:
    """Return what is recorded while the box swings by sines, turned by up to `turn` rad and shifted by `shift` m."""
    size, start = np.array([turn] * 3 + [shift] * 3), state.object_frame

    def path(t: Scalar) -> Target:
        grown = t * t / (t * t + 0.25)  # the controller makes up for what the rates below leave out
        x, v, a = sin(RATES * t), RATES * cos(RATES * t), -RATES * RATES * sin(RATES * t)
        off: Array = grown * size * x
        pose = hf.Pose.unchecked(rotation.exp(off[:3]) @ start.R, start.p + off[3:])
        return Target(pose, grown * size * v, grown * size * a)

    run = hf.simulate(chain, state, ObjectTracking(chain, path, internal_force=20.0), DURATION, STEP)
    return Recording.of_run(run)


def with_noise(recording: Recording) -> Recording:
    """Return a recording whose wrist sensors have noise, moments and forces of their own sizes."""
    w = np.asarray(recording.wrist_wrench)
    sizes = np.repeat([np.sqrt((w[..., half] ** 2).mean()) for half in (slice(0, 3), slice(3, 6))], 3)
    return replace(recording, wrist_wrench=w + NOISE * sizes * np.random.default_rng(0).normal(size=w.shape))


def main(out: Path = OUT) -> dict[str, Identification]:
    """Return what was found without turning the box, and with."""
    chain, state = chain_with(PAYLOAD)
    model = replace(chain, held_object=MODEL)
    found = {}
    for name, turn in (("shifted", 0.0), ("turned", 0.3)):
        found[name] = hf.identify(model, with_noise(swing(chain, state, turn, 0.05)))
        print(f"{name}:\n{found[name]}\n")
    draw(out, found)
    return found


def draw(out: Path, found: dict[str, Identification]) -> None:
    """Draw the moments of inertia: the truth, the model, and what was found, with two standard deviations."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.8, 2.8), layout="constrained")
        axes, names = figure.subplots(), ["inertia xx", "inertia yy", "inertia zz"]
        for x, (truth, guess) in enumerate(zip(np.diag(PAYLOAD.inertia), np.diag(MODEL.inertia), strict=True)):
            axes.hlines(truth, x - 0.3, x + 0.3, color="black", label="" if x else "truth")
            axes.hlines(guess, x - 0.3, x + 0.3, color="black", linestyle=":", label="" if x else "model")
        for shift, (name, one), colour in zip((-0.1, 0.1), found.items(), (DANGER, BLUE), strict=True):
            values = [one.values[one.names.index(axis)] for axis in names]
            bars = [2 * one.deviations[axis] if np.isfinite(one.deviations[axis]) else 0.0 for axis in names]
            axes.errorbar(np.arange(3) + shift, values, bars, fmt="o", color=colour, label=name)
        axes.set_xticks(range(3), names)
        axes.set_ylabel("about the mass centre [kg m$^2$]")
        axes.legend(frameon=False)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "12_identify.png", dpi=DPI)


if __name__ == "__main__":
    main()
