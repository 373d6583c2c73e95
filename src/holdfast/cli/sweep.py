"""`holdfast sweep`: simulate the runs of a scene with a `[sweep]` table, and print a summary."""

from __future__ import annotations

import os
from pathlib import Path

from rich.table import Table

from holdfast.cli.console import is_standard, print_document, refuse_standard, stdout
from holdfast.cli.options import Changes, Folder, PackageOptions, RunNumber, SchedulerAddress, Swept, Switch
from holdfast.cli.results import opened_scene, scene_name
from holdfast.cli.streams import EXIT_INTERRUPTED, complain, say
from holdfast.errors import SceneError, StateError
from holdfast.progress import progress_bar
from holdfast.sweeps import Sweep, load_sweep, sweep_scene
from holdfast.sweeps.of_scene import kept_scene

SHOWN_LEVELS = {"least": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "largest": 1.0}


def sweep(
    target: Swept,
    out: Folder = None,
    workers: int = 1,
    cluster: SchedulerAddress = None,
    run: RunNumber = None,
    changes: Changes = (),
    json: Switch = False,
    trust_xacro: Switch = False,
    packages: PackageOptions = (),
) -> int:
    """Run or continue the sweep that a scene describes: many runs, whose results are written to a folder.

    Args:
        target: a scene with a [sweep] table, - for stdin; or the folder of a sweep.
        out: the folder of the scene's sweep; runs that it already contains are not repeated.
        workers: number of processes on this computer.
        cluster: address of a Dask scheduler, tcp://...; or local for a Dask cluster of these workers.
        run: repeat only this run, and write it as a result folder inside the sweep's, for view and plot.
        changes: set a key of the scene, such as sweep.count=1000; may be repeated.
        json: print one JSON document instead of tables.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
        packages: the folder of a package that a robot's file refers to; may be repeated.

    Returns:
        0, even if runs failed, which the summary counts; 130 if the user interrupted the sweep.

    Raises:
        HoldfastError: the input is invalid, the scene cannot be swept, or the folder cannot be used.
    """
    refuse_standard(out)
    is_folder = not is_standard(target) and os.path.isdir(target)
    if is_folder and (out is not None or changes or packages):
        option = "--set" if changes else "--package" if packages else "--out"
        raise SceneError(
            f"{option}: expected a scene, got the folder {target}, which contains its own scene; try without it"
        )
    folder = target if is_folder else Path("results") / f"{scene_name(target)}_sweep" if out is None else out
    if run is not None:
        if not is_folder:
            raise SceneError(
                f"--run: expected the folder of a sweep, got {target}; try holdfast sweep {folder} --run {run}"
            )
        return _again(load_sweep(folder), run, workers, cluster, json)
    scenario = kept_scene(target) if is_folder else opened_scene(target, trust_xacro, changes, packages)
    try:
        with progress_bar(f"sweeping {scenario.name}", say=say, time_left=False) as show:
            report = lambda at: show(at.done / at.count, str(at))  # noqa: E731
            found = sweep_scene(scenario, folder, workers=workers, cluster=cluster, progress=report)
    except KeyboardInterrupt:
        complain(f"interrupted; what was finished is in {folder}, and the same command continues from there")
        return EXIT_INTERRUPTED
    _report(found, json)
    return 0


def _again(found: Sweep, number: int, workers: int, cluster: str | None, as_json: bool) -> int:
    """Repeat one run, and write it as a result folder."""
    if workers != 1 or cluster is not None:
        raise StateError("--run: repeats one run in this process; try without --workers and --cluster")
    run = found.run(number)
    place = run.save(found.folder / f"run_{number}", overwrite=True)
    if as_json:
        print_document({"sweep": str(found.folder), "run": number, "result": str(place), "stopped": run.stopped})
        return 0
    stdout().print(f"{place}: {len(run)} samples, {run.stopped or 'complete'}", soft_wrap=True)
    stdout().print(f"try `holdfast view {place}`", soft_wrap=True)
    return 0


def _report(found: Sweep, as_json: bool) -> None:
    """Print how the runs ended, and the distributions of their recorded outputs."""
    counts, rows = found.status_counts, found.table(list(SHOWN_LEVELS.values()))
    if as_json:
        kept = {"levels": list(SHOWN_LEVELS.values()), "quantiles": {title: x.tolist() for title, x in rows.items()}}
        print_document({"sweep": str(found.folder), "runs": len(found), "statuses": counts, **kept})
        return
    console, statuses = stdout(), Table("status", "runs")
    for name, count in sorted(counts.items()):
        statuses.add_row(name.lower(), str(count))
    console.print(statuses)
    if rows:
        table = Table("of running runs", *SHOWN_LEVELS)
        for title, x in rows.items():
            table.add_row(title, *(f"{value:.6g}" for value in x))
        console.print(table)
    console.print(f"{len(found)} runs in {found.folder}; --run NUMBER repeats one", soft_wrap=True)
