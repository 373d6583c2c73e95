"""`holdfast simulate`: simulate a scene, write a result folder with plots, and print a summary."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path

from holdfast.cli.console import print_document, refuse_standard, stdout
from holdfast.cli.options import Changes, Folder, PackageOptions, SceneFile, Seconds, Switch
from holdfast.cli.results import opened_scene, scene_name
from holdfast.cli.streams import EXIT_INTERRUPTED, EXIT_REFUSED, complain, say
from holdfast.errors import ClosureError, MissingExtra, ResultError, SingularChainError, StateError
from holdfast.io.result_folder import ResultWriter, run_meta
from holdfast.io.result_reader import load_result
from holdfast.progress import of_time, progress_bar
from holdfast.scenario.build import Scenario
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.run_record import record_settings
from holdfast.simulation.simulate import simulate as run_simulation
from holdfast.simulation.summary import Summary, summarise
from holdfast.simulation.trajectory import Trajectory, text_of
from holdfast.view.figure_style import matplotlib
from holdfast.view.plots import save_plots
from holdfast.view.summary_table import summary_table


def simulate(
    scene: SceneFile,
    out: Folder = None,
    overwrite: bool = False,
    resume: Switch = False,
    plots: bool = True,
    sample_time: Seconds = None,
    delay: Seconds = None,
    changes: Changes = (),
    json: Switch = False,
    trust_xacro: Switch = False,
    packages: PackageOptions = (),
) -> int:
    """Simulate a scene and write a result folder.

    Args:
        scene: the scene, TOML; - for stdin.
        out: the result folder to write.
        overwrite: replace an existing result folder.
        resume: continue a run that was interrupted or killed; the result is identical to the bit.
        plots: draw the plots too (needs matplotlib); `holdfast plot` draws them later.
        sample_time: sample time of the controller, whose torques are held in between; by default the scene's.
        delay: delay from a sample until its torques act; by default the scene's.
        changes: set a key of the scene, such as simulation.step=0.001 or arms.left.q="[0, 0.5]"; may be repeated.
        json: print one JSON document instead of the summary table.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
        packages: the folder of a package that a robot's file refers to; may be repeated.

    Returns:
        0; 3 if the run was stopped by an event such as a slipping grasp; 130 if the user interrupted it. In both cases
        the samples until then are written.

    Raises:
        MissingExtra: matplotlib is needed for the plots and not installed; nothing is simulated.
        HoldfastError: the input is invalid, the initial state is unreachable or singular, or the result folder cannot
            be used; nothing is written.
    """
    if resume and overwrite:
        raise ResultError("--resume continues a result, --overwrite replaces it; try one of them")
    refuse_standard(out)
    folder = Path("results") / scene_name(scene) if out is None else out
    scenario = opened_scene(scene, trust_xacro, changes, packages)
    requested = {name: x for name, x in (("sample_time", sample_time), ("delay", delay)) if x is not None}
    scenario = replace(scenario, options=scenario.options | requested)
    if plots:
        _require_plots()
    robots = scenario.sources
    home = str(scene.parent.resolve()) if robots else ""
    sampled = scenario.options["sample_time"] is not None
    options = {name: scenario.options[name] for name in ("sample_time", "delay")} if sampled else {}
    record, every = scenario.options["record"], scenario.options["every"]
    options |= record_settings(record, every, scenario.step, scenario.chain).options
    meta = run_meta(scenario.chain, scenario.name, scenario.duration, scenario.step, scene_folder=home, **options)
    if resume:
        writer = ResultWriter.resume(folder, meta, scenario.text, robots=robots)
        if writer.start is None:
            say(f"{folder}: nothing to resume yet; the run starts from the beginning")
    else:
        writer = ResultWriter(folder, meta, scenario.text, robots=robots, overwrite=overwrite)
    try:
        run = _run(scenario, writer)
    except (ClosureError, SingularChainError, StateError) as cause:
        raise type(cause)(f"{scene}: {cause}") from cause
    if run is None:
        return _interrupted(scenario, writer, json)
    happened = run.occurrences
    if writer.start is not None:  # the first part is on disk
        writer.flush()
        run = replace(load_result(folder).trajectory, stopped=run.stopped, setting=run.setting)
    summary = summarise(scenario.chain, run) if run.has_every_array else None
    writer.finish(summary, stopped=run.stopped, occurrences=happened)
    if not json:
        _print(run, summary)
    if run.stopped is not None:
        complain(f"{scene}: {run.stopped}")
    written = [] if summary is None else ["summary.json"]
    for name in () if json else written:
        _point_to(folder, name)
    drawn = save_plots(scenario.chain, run, folder) if plots else []
    if json:
        files = [str(folder / name) for name in (*written, *drawn)]
        print_document(_document(folder, summary, run.stopped, files))
    for name in () if json else drawn:
        _point_to(folder, name)
    return 0 if run.stopped is None else EXIT_REFUSED


def _run(scenario: Scenario, writer: ResultWriter) -> Trajectory | None:
    """Return the run, or None if the user interrupted it; in both cases the writer has the samples."""
    whole, steps = scenario.duration, math.ceil(scenario.duration / scenario.step)

    def keep(part: Trajectory, checkpoint: Checkpoint) -> None:
        writer.add(part)
        writer.mark(checkpoint)

    with progress_bar(f"simulating {scenario.name}", f"{whole:g} s in {steps} steps", say) as show:
        try:
            return run_simulation(
                scenario.chain,
                scenario.state,
                scenario.controller,
                scenario.duration,
                scenario.step,
                **scenario.options,
                start=writer.start,
                progress=lambda t: show(*of_time(whole)(t)),
                on_samples=keep,
            )
        except KeyboardInterrupt:
            return None


def _print(run: Trajectory, summary: Summary | None) -> None:
    """Print the summary, or what was recorded if that is too little for one."""
    if summary is None:
        names = ", ".join(name for name in run.recorded if getattr(run, name).size)
        stdout().print(f"{text_of(run)}, with {names}, which is too little for a summary", soft_wrap=True)
    else:
        stdout().print(summary_table(summary))


def _document(folder: Path, summary: Summary | None, stopped: str | None, files: list[str]) -> dict[str, object]:
    numbers = None if summary is None else asdict(summary)
    return {"result": str(folder), "stopped": stopped, "files": files, "summary": numbers}


def _interrupted(scenario: Scenario, writer: ResultWriter, as_json: bool) -> int:
    """Write the samples so far, report this, and return 130."""
    writer.finish(None, stopped="interrupted")
    if not writer.samples:
        complain("interrupted before the first step; nothing was written")
        return EXIT_INTERRUPTED
    run = load_result(writer.folder).trajectory
    summary = summarise(scenario.chain, run) if run.has_every_array else None
    if as_json:
        print_document(_document(writer.folder, summary, "interrupted", []))
    else:
        _print(run, summary)
    complain(
        f"interrupted after t = {run.t[-1]:.6g} s; the results until then are in {writer.folder}, and --resume"
        " continues from there"
    )
    return EXIT_INTERRUPTED


def _require_plots() -> None:
    """Check before a run that its plots can be drawn, so that this does not fail at the end."""
    try:
        matplotlib()
    except MissingExtra as missing:
        raise MissingExtra(f"{missing}, or --no-plots now and `holdfast plot RESULT` later") from missing


def _point_to(folder: Path, name: str) -> None:
    stdout().print(f"look at {folder / name}", soft_wrap=True)
