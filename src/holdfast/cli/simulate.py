"""`holdfast simulate`: a scene in; a result folder, a summary and two plots out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from holdfast.errors import ClosureError, MissingExtra, SingularChainError
from holdfast.io.load_result import load_result
from holdfast.io.result_folder import ResultWriter
from holdfast.scenario.build import Scenario, load_scene
from holdfast.simulation.simulate import simulate as run_simulation
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import Trajectory
from holdfast.view.plots import save_plots
from holdfast.view.summary_table import summary_table

OK, REFUSED, INTERRUPTED = 0, 3, 130


def simulate(scene: Path, out: Path | None = None, overwrite: bool = False, with_plots: bool = True) -> int:
    """Simulate a scene and return the exit code: 0, 3 (physics refused) or 130 (interrupted).

    Args:
        scene: the scene file.
        out: result folder; `results/<scene's name>` if None.
        overwrite: replace an earlier result there.
        with_plots: write the plots too.

    Raises:
        HoldfastError: bad input, or a result folder that cannot be used; nothing is written.
    """
    from rich.console import Console

    console, errors = (Console(stderr=err, highlight=False, markup=False, soft_wrap=True) for err in (False, True))
    folder = Path("results") / scene.stem if out is None else out
    try:
        scenario = load_scene(scene)
        writer = ResultWriter(folder, scenario, overwrite=overwrite)
        run = _run(scenario, writer, console)
    except (ClosureError, SingularChainError) as refusal:
        errors.print(f"holdfast: {_one_line(refusal)}")
        return REFUSED

    if run is None:
        writer.finish(None, stopped="interrupted")
        if not writer.samples:
            errors.print("holdfast: interrupted before the first step; nothing was written")
            return INTERRUPTED
        run = load_result(folder).trajectory
        console.print(summary_table(summarise(scenario.chain, run)))
        errors.print(f"holdfast: interrupted after t = {run.t[-1]:.6g} s; what was done until then is in {folder}/")
        return INTERRUPTED

    summary = summarise(scenario.chain, run)
    writer.finish(summary, stopped=run.stopped)
    console.print(summary_table(summary))
    look_at = ["summary.json", *(_plots(scenario, run, folder, errors) if with_plots else [])]
    if run.stopped is not None:
        errors.print(f"holdfast: {scene}: {_one_line(run.stopped)}")
    console.print(f"Look at {', '.join(str(folder / name) for name in look_at)}")
    console.print(f'All samples: holdfast.io.load_result.load_result("{folder}").trajectory')
    return OK if run.stopped is None else REFUSED


def _run(scenario: Scenario, writer: ResultWriter, console: Any) -> Trajectory | None:
    """Return the run, None if the user interrupted it; samples go to the writer either way."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    clock = TextColumn("{task.completed:.3f} of {task.total:g} s", markup=False)
    title = TextColumn("{task.description}", markup=False)
    if not console.is_terminal:
        steps = -(-scenario.duration // scenario.step)
        console.print(f"simulating {scenario.name}: {scenario.duration:g} s in {steps:.0f} steps")
    with Progress(title, BarColumn(), clock, TimeRemainingColumn(), console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"simulating {scenario.name}", total=scenario.duration)
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


def _plots(scenario: Scenario, run: Trajectory, folder: Path, errors: Any) -> list[str]:
    """Write the plots and return their names; without matplotlib say so and go on."""
    try:
        return save_plots(scenario.chain, run, folder)
    except MissingExtra as missing:
        errors.print(f"holdfast: no plots: {missing}")
        return []


def _one_line(text: object) -> str:
    return " ".join(str(text).split())
