"""Write how far simulators let a closed chain come apart: docs/images/drift.png and docs/drift.md.

python benchmarks/drift_figure.py

The motion is that of `circling.py`. Every simulator starts from the same closed state and is given the same torques of
time and joint state, asked for at every stage. The gap is always found from joint positions and object pose by
`holdfast.dynamics.closure`: the largest of any grasp.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.bench.mujoco_peer import inputs, mjcf
from benchmarks.bench.pinocchio_peer import PinocchioModel
from benchmarks.bench.rollout_entries import DEFAULT_IMPEDANCE
from benchmarks.bench.systems import System
from benchmarks.circling import PERIOD, RADIUS, Circling, circling
from holdfast import ControlLaw, State, compile_rollout
from holdfast.dynamics import closure
from holdfast.interop.mjcf_writer import HARDEST
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style
from holdfast.view.figure_style import BLUE, COLUMN, GREEN, ORANGE, PURPLE, SKY, STYLE, VERMILLION

DURATION = 10.0  # s
STEP = 1e-3  # s
SMALL_STEP = 1e-4  # s, of MuJoCo once more
SAMPLES_EVERY = 5e-3  # s
GAINS = (30.0, 100.0, 200.0, 300.0, 500.0, 800.0, 1000.0)  # rad/s: Baumgarte's, critically damped
TRIAL = 1.5  # s, about a period, in which the best gain is found
ITERATIONS = 1000  # MuJoCo's most

Positions = tuple[Array, Array]  # joint positions, object pose wxyz_xyz


@dataclass(frozen=True, eq=False)
class Run:
    """A simulator with its settings, and what came of it.

    Attributes:
        library: with its version.
        way: how it steps, in a few words.
        settings: everything that was set.
        step: its step [s].
        gap: (samples,) of the worst grasp, every 5 ms [m or rad].
    """

    library: str
    way: str
    settings: str
    step: float
    gap: Array

    @property
    def t(self) -> Array:
        """(samples,) [s]."""
        return SAMPLES_EVERY * np.arange(1, len(self.gap) + 1)


def runs(report: Callable[[str], None] = print) -> Iterator[Run]:
    """Yield the run of every simulator that is here."""
    motion = circling()
    report("holdfast")
    yield by_holdfast(motion)
    ways: list[tuple[Callable[..., Run], tuple[object, ...]]]
    ways = [(by_pinocchio, ("Euler",)), (by_pinocchio, ("RK4",))]
    ways += [(by_mujoco, ("Euler", STEP, False))]
    ways += [(by_mujoco, (*way, True)) for way in (("implicitfast", STEP), ("RK4", STEP), ("RK4", SMALL_STEP))]
    for run, arguments in ways:
        report(f"{run.__name__} {arguments}")
        try:
            yield run(motion, *arguments)
        except ImportError as missing:
            report(f"left out: {missing}")


def by_holdfast(motion: Circling) -> Run:
    """Return the rollout of one system."""
    law = ControlLaw(lambda t, state, memory, given: (motion.torque(t, state.q, state.qd), memory))
    rollout, start = compile_rollout(motion.chain, law), motion.state(0.0)
    systems = rollout.start(start.q, start.qd, start.object_pose, start.object_twist)
    every = round(SAMPLES_EVERY / STEP)
    record = rollout.run(systems, DURATION, STEP, every=every, record=("q", "object_pose"))
    positions = zip(record["q"][1:, 0], record["object_pose"][1:, 0], strict=True)
    return Run("holdfast", "RK4, projected", "no tuning parameter", STEP, _gaps(motion, positions))


def by_pinocchio(motion: Circling, integrator: str) -> Run:
    """Return `constraintDynamics` under Baumgarte's feedback of the best of several gains."""
    pin: Any = import_module("pinocchio")

    def gaps(gain: float, duration: float) -> Array:
        return _gaps(motion, _pinocchio_positions(motion, integrator, gain, duration))

    best = min(GAINS, key=lambda gain: np.median(gaps(gain, TRIAL)))
    settings = (
        f"constraintDynamics, free object, {integrator}, Kp = {best * best:g}, Kd = {2 * best:g} (the best of"
        f" {len(GAINS)} critically damped pairs, {GAINS[0]:g} to {GAINS[-1]:g} rad/s)"
    )
    way = f"{integrator}, Baumgarte at {best:g} rad/s"
    return Run(f"Pinocchio {pin.__version__}", way, settings, STEP, gaps(best, DURATION))


def _pinocchio_positions(motion: Circling, integrator: str, gain: float, duration: float) -> Iterator[Positions]:
    pin: Any = import_module("pinocchio")
    posed = PinocchioModel(_system(motion), "free")
    model, data, n = posed.model, posed.model.createData(), motion.chain.joint_count
    for weld in posed.welds:
        weld.setBaumgarteCorrectorParameters(pin.BaumgarteCorrectorParameters(gain * gain, 2.0 * gain))
    weld_data = posed.weld_data()
    pin.initConstraintDynamics(model, data, posed.welds, weld_data)

    def acceleration(t: float, q: Array, v: Array) -> Array:
        tau = np.concatenate([motion.torque(t, q[:n], v[:n]), np.zeros(6)])
        return pin.constraintDynamics(model, data, q, v, tau, posed.welds, weld_data).copy()

    def euler(t: float, q: Array, v: Array) -> tuple[Array, Array]:
        return pin.integrate(model, q, STEP * v), v + STEP * acceleration(t, q, v)

    def rk4(t: float, q: Array, v: Array) -> tuple[Array, Array]:
        h, half = STEP, 0.5 * STEP
        a1 = acceleration(t, q, v)
        v2 = v + half * a1
        a2 = acceleration(t + half, pin.integrate(model, q, half * v), v2)
        v3 = v + half * a2
        a3 = acceleration(t + half, pin.integrate(model, q, half * v2), v3)
        v4 = v + h * a3
        a4 = acceleration(t + h, pin.integrate(model, q, h * v3), v4)
        return pin.integrate(model, q, h / 6 * (v + 2 * v2 + 2 * v3 + v4)), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    advance, every = {"Euler": euler, "RK4": rk4}[integrator], round(SAMPLES_EVERY / STEP)
    q, v, _ = posed.inputs[0]
    for k in range(round(duration / STEP)):
        q, v = advance(k * STEP, q, v)
        if (k + 1) % every == 0:
            yield q[:n], np.concatenate([q[n + 6 :], q[n + 3 : n + 6], q[n : n + 3]])


def by_mujoco(motion: Circling, integrator: str, step: float, hardest: bool) -> Run:
    """Return `mj_step` with its default equalities, or the hardest that it keeps stable."""
    mujoco: Any = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(motion.chain, "Newton", "dense"))
    model.opt.timestep = step
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    impedance = (HARDEST, HARDEST, 0.001, 0.5, 2.0) if hardest else DEFAULT_IMPEDANCE
    model.eq_solimp[:] = impedance
    if hardest:
        model.eq_solref[:] = 2.0 * step, 1.0  # twice the step: less is set to that
        model.opt.iterations, model.opt.tolerance = ITERATIONS, 0.0
    data, n = mujoco.MjData(model), motion.chain.joint_count
    data.qpos[:], data.qvel[:], _ = inputs(_system(motion))[0]

    def control(_: Any, at: Any) -> None:  # asked at every stage
        at.qfrc_applied[:n] = motion.torque(at.time, at.qpos[:n], at.qvel[:n])

    def positions() -> Iterator[Positions]:
        try:
            mujoco.set_mjcb_control(control)
            for _ in range(round(DURATION / SAMPLES_EVERY)):
                mujoco.mj_step(model, data, round(SAMPLES_EVERY / step))
                yield data.qpos[:n].copy(), np.concatenate([data.qpos[n + 3 :], data.qpos[n : n + 3]])
        finally:
            mujoco.set_mjcb_control(None)

    numbers = ", ".join(
        f"{name} = {' '.join(f'{x:g}' for x in values)}"
        for name, values in (("solref", model.eq_solref[0]), ("solimp", model.eq_solimp[0]))
    )
    settings = f"mj_step, Newton, {integrator}, {numbers}, {model.opt.iterations} iterations to {model.opt.tolerance:g}"
    way = f"{integrator}, {'hardest' if hardest else 'default'} welds"
    return Run(f"MuJoCo {mujoco.__version__}", way, settings, step, _gaps(motion, positions()))


def _system(motion: Circling) -> System:
    """Return the motion's start as the models of others take it."""
    at, n = motion.state(0.0), motion.chain.joint_count
    rows = (x[None] for x in (at.q, at.qd, np.zeros(n), at.object_pose, at.object_twist))
    return System("circling", motion.chain, *rows)


def _gaps(motion: Circling, positions: Iterable[Positions]) -> Array:
    """Return how far the worst grasp is open at each of the positions."""
    return np.array([_gap(motion, q, pose) for q, pose in positions])


def _gap(motion: Circling, q: Array, pose: Any) -> float:
    if not (np.isfinite(q).all() and np.isfinite(pose).all()):
        return float("inf")
    unit = np.concatenate([pose[:4] / np.linalg.norm(pose[:4]), pose[4:]])
    residuals = closure(motion.chain, State(q, 0.0 * q, unit)).values()
    return max(float(np.abs(found.position).max()) for found in residuals)


DOCS = Path(__file__).parents[1] / "docs"
# In the order of the runs.
STYLES = ((BLUE, "-"), (VERMILLION, "-"), (ORANGE, "-"), (PURPLE, "-"), (GREEN, "-"), (SKY, "-"), (SKY, "--"))
FLOOR = 1e-17  # m or rad: a gap of zero is drawn there
SETTLED = 1.0  # s: from here on the table counts

PAGE = """\
# Drift

Generated by `python benchmarks/drift_figure.py`.

![How far the worst grasp opens, against time](images/drift.png)

{caption}

{table}

The torques are sums of sines of time, plus a spring and a damper on every joint (`benchmarks/circling.py`). Every
simulator starts from the same closed state, evaluates the torques at every stage, and has its most favourable
settings: Pinocchio the best of several feedback gains, MuJoCo once its defaults, otherwise the stiffest welds that
its step allows and iterations without a tolerance. The gap is computed from joint positions and object pose by the
same function for all, `holdfast.dynamics.closure`. A feedback acts on an error that exists already: it balances the
error that every step adds, and its gain is limited by the step. holdfast has no gain: after each step, positions and
velocities are projected onto the grasps.
"""


def main() -> None:
    """Run, draw, write."""
    found = list(runs())
    figure(found).savefig(DOCS / "images" / "drift.png", dpi=figure_style.DPI)
    (DOCS / "drift.md").write_text(PAGE.format(caption=caption(found), table=table(found)))
    print("wrote docs/images/drift.png and docs/drift.md")


def figure(found: list[Run]) -> Any:
    """Return the gaps against time, on a logarithmic scale."""
    Figure, rc_context = figure_style.matplotlib()
    with rc_context(STYLE):
        made = Figure(figsize=(1.6 * COLUMN, 3.6), layout="constrained")
        panel = made.subplots()
        for run, (colour, line) in zip(found, STYLES, strict=False):
            panel.semilogy(run.t, np.maximum(run.gap, FLOOR), line, color=colour, label=label(run), linewidth=0.9)
        panel.set_xlim(0.0, DURATION)
        panel.set_ylim(FLOOR, 1e-2)
        panel.set_yticks(10.0 ** np.arange(-16.0, -1.0, 2.0))
        panel.set_xlabel("time [s]")
        panel.set_ylabel("largest gap of a grasp [m or rad]")
        made.legend(loc="outside upper center", ncols=2, columnspacing=1.2)
    return made


def label(run: Run) -> str:
    """Return a run's name in the legend."""
    return f"{run.library.partition(' ')[0]}, {run.way}, {1e3 * run.step:g} ms"


def caption(found: list[Run]) -> str:
    """Return what the figure shows, in the figures of the runs."""
    ours, *others = found
    best = min(others, key=lambda run: _settled(run)[0]) if others else None
    text = (
        f"Two Pandas carry a 3 kg box round a circle of {RADIUS:g} m in {PERIOD:g} s, elbows swinging, for"
        f" {DURATION:g} s. With holdfast the worst grasp is never open by more than {ours.gap.max():.1e} m or rad, at"
        f" {1e3 * ours.step:g} ms steps"
    )
    if best is None:
        return text + "."
    median, _ = _settled(best)
    return (
        f"{text}; the best of the others, {best.library} ({best.way}, {1e3 * best.step:g} ms), is open by {median:.1e}"
        " in the median."
    )


def table(found: list[Run]) -> str:
    """Return settings and gaps of every run as Markdown."""
    lines = ["| | step | gap, median | gap, largest | settings |", "| --- | --- | --- | --- | --- |"]
    for run in found:
        median, largest = _settled(run)
        lines.append(
            f"| {run.library}: {run.way} | {1e3 * run.step:g} ms | {median:.1e} | {largest:.1e} | {run.settings} |"
        )
    return "\n".join([*lines, f"\nGaps in m or rad, from {SETTLED:g} s on."])


def _settled(run: Run) -> tuple[float, float]:
    """Return median and largest gap once transients are over."""
    gap = run.gap[run.t >= SETTLED]
    return float(np.median(gap)), float(gap.max())


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
