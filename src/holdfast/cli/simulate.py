"""`holdfast simulate`: a scene in; a result folder, a summary and two plots out."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from holdfast.cli import INTERRUPTED, REFUSED, complain
from holdfast.cli.console import stdout
from holdfast.errors import MissingExtra, SingularChainError, StateError
from holdfast.io.result_folder import ResultWriter, run_meta
from holdfast.io.result_reader import load_result
from holdfast.scenario.build import Scenario, load_scene
from holdfast.simulation.simulate import simulate as run_simulation
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import Trajectory
from holdfast.view.plots import save_plots
from holdfast.view.summary_table import summary_table


def simulate(scene: Path, out: Path | None = None, overwrite: bool = False, with_plots: bool = True) -> int:
    """Simulate a scene: progress on stderr, summary on stdout, everything in the result folder.

    Args:
        scene: the scene file.
        out: result folder; `results/<scene's name>` if None.
        overwrite: replace an earlier result there.
        with_plots: write the plots too.

    Returns:
        0; 3 if the run was stopped by physics; 130 if the user interrupted it. What was
        simulated until then is kept in both cases.

    Raises:
        HoldfastError: bad input, an unreachable or singular start, or a result folder that
            cannot be used; nothing is written.
    """
    folder = Path("results") / scene.stem if out is None else out
    scenario = load_scene(scene)
    meta = run_meta(scenario.chain, scenario.name, scenario.duration, scenario.step)
    writer = ResultWriter(folder, meta, scenario.text, overwrite=overwrite)
    try:
        run = _run(scenario, writer)
    except (SingularChainError, StateError) as cause:
        raise type(cause)(f"{scene}: {cause}") from cause
    if run is None:
        return _interrupted(scenario, writer)

    summary = summarise(scenario.chain, run)
    writer.finish(summary, stopped=run.stopped)
    stdout().print(summary_table(summary))
    if run.stopped is not None:
        complain(f"{scene}: {run.stopped}")
    look_at = ["summary.json", *(_plots(scenario, run, folder) if with_plots else [])]
    for name in look_at:
        stdout().print(f"look at {folder / name}", soft_wrap=True)
    return 0 if run.stopped is None else REFUSED


def _run(scenario: Scenario, writer: ResultWriter) -> Trajectory | None:
    """Return the run, None if the user interrupted it; samples go to the writer either way."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.completed:.3f} of {task.total:g} s", markup=False),
        TimeRemainingColumn(),
    )
    doing = f"simulating {scenario.name}"
    if not sys.stderr.isatty():
        steps = math.ceil(scenario.duration / scenario.step)
        print(f"{doing}: {scenario.duration:g} s in {steps} steps", file=sys.stderr, flush=True)
    with Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(doing, total=scenario.duration)
        try:
            return run_simulation(
                scenario.chain,
                scenario.state,
                scenario.controller,
                scenario.duration,
                scenario.step,
                progress=lambda t: bar.update(task, completed=t),
                on_sample=writer.add,
            )
        except KeyboardInterrupt:
            return None


def _interrupted(scenario: Scenario, writer: ResultWriter) -> int:
    """Save what there is, say so, and return 130."""
    writer.finish(None, stopped="interrupted")
    if not writer.samples:
        complain("interrupted before the first step; nothing was written")
        return INTERRUPTED
    run = load_result(writer.folder).trajectory
    stdout().print(summary_table(summarise(scenario.chain, run)))
    complain(f"interrupted after t = {run.t[-1]:.6g} s; what was simulated until then is in {writer.folder}")
    return INTERRUPTED


def _plots(scenario: Scenario, run: Trajectory, folder: Path) -> list[str]:
    """Write the plots and return their names; without matplotlib say so and go on."""
    try:
        return save_plots(scenario.chain, run, folder)
    except MissingExtra as missing:
        complain(f"no plots: {missing}")
        return []
