"""`holdfast view`: show a result folder or a scene in the browser, or write it as one HTML file."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from holdfast.cli.console import is_standard, print_document, stdout, write_stdout
from holdfast.cli.options import Changes, OutFile, PackageOptions, Switch, Targets
from holdfast.cli.results import labels, opened_scene, recorded, refuse_scene_options
from holdfast.cli.streams import say
from holdfast.errors import ModelError, ResultError, SingularChainError, StateError
from holdfast.io.typed import refusal
from holdfast.scenario.build import Scenario
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.state import Inputs
from holdfast.view.live import watch
from holdfast.view.page import MOST_PAGES, export_page
from holdfast.view.playback import Playback, playback_of_instant

LAST_PORT = 65535


def view(
    targets: Targets = (),
    export: OutFile = None,
    port: int = 0,
    rate: float = 30.0,
    overwrite: bool = False,
    changes: Changes = (),
    json: Switch = False,
    trust_xacro: Switch = False,
    packages: PackageOptions = (),
) -> int:
    """Show a run, or the initial state of a scene, in the browser; Ctrl-C ends it.

    Args:
        targets: a result folder, or a scene file, - for a scene on stdin; of several, one is chosen in the page.
        export: write one HTML file that can be opened from disk instead; - for stdout.
        port: the port of the viewer, on this machine only; 0 for any free port.
        rate: number of frames shown per second of the run.
        overwrite: replace an existing HTML file.
        changes: set a key of the scene, such as simulation.step=0.001; may be repeated.
        json: print one JSON document instead of lines.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
        packages: the folder of a package that a robot's file refers to; may be repeated.

    Returns:
        0, also after Ctrl-C, which ends the viewer.

    Raises:
        HoldfastError: the target does not exist, cannot be read, or cannot be shown.
    """
    if not 0 <= port <= LAST_PORT:
        raise ModelError(f"port: expected 0 (any that is free) to {LAST_PORT}, got {port}")
    if is_standard(export) and json:
        raise ResultError("--export -: stdout takes the page or, with --json, a report; try one of them")
    if export is not None and not is_standard(export) and os.path.lexists(export) and not overwrite:
        raise ResultError(f"{export}: exists already; try --overwrite, or another --export")
    titles = labels(targets, MOST_PAGES, "RESULT|SCENE")
    playbacks = [_playback(target, rate, trust_xacro, changes, packages) for target in targets]
    if len(playbacks) > 1:
        playbacks = [replace(one, title=title) for one, title in zip(playbacks, titles, strict=True)]
    if export is not None and is_standard(export):
        write_stdout(lambda path: export_page(playbacks, path), "page.html")
        return 0
    if export is not None:
        export_page(playbacks, export)
        frames, runs = sum(map(len, playbacks)), f"{len(playbacks)} runs, " if len(playbacks) > 1 else ""
        if json:
            print_document({"file": str(export), "bytes": export.stat().st_size, "moments": frames})
            return 0
        size, plural = export.stat().st_size / 2**20, "" if frames == 1 else "s"
        stdout().print(f"{export}: {size:.1f} MiB, {runs}{frames} frame{plural}", soft_wrap=True)
        return 0
    try:
        watch(playbacks, _announce_json if json else _announce, port)
    except KeyboardInterrupt:
        if not json:
            stdout().print("closed")
    return 0


def _announce(address: str) -> None:
    console = stdout()
    console.print(f"{address}   (Ctrl-C stops it)")
    console.file.flush()


def _announce_json(address: str) -> None:
    print_document({"address": address})
    sys.stdout.flush()


def _playback(
    target: Path, rate: float, trust_xacro: bool, changes: Sequence[str], packages: Sequence[str]
) -> Playback:
    piped = is_standard(target)
    if not piped and not os.path.exists(target):  # Path.exists raises an error for names that are too long
        raise refusal(str(target), "no such file or folder; expected a result folder or a scene file")
    if piped or not os.path.isdir(target):
        return _playback_of_scene(opened_scene(target, trust_xacro, changes, packages), target)
    refuse_scene_options(changes, packages, f"the result folder {target}")
    setting, result = recorded(target, trust_xacro)
    return _noted(replace(result.trajectory, setting=setting).playback(rate))


def _playback_of_scene(scenario: Scenario, source: Path) -> Playback:
    """Return a playback of the scene's initial state, with the controller's torques."""
    world = Environment(
        scenario.chain, scenario.options.get("base_motion", {}), scenario.options.get("inputs") or Inputs()
    )
    try:
        return _noted(
            playback_of_instant(
                evaluate(world, scenario.controller, 0.0, scenario.state, None), scenario.name, scenario.controller
            )
        )
    except (SingularChainError, StateError) as cause:
        raise type(cause)(f"{source}: {cause}") from cause


def _noted(playback: Playback) -> Playback:
    """Return the playback; print on stderr which meshes cannot be read."""
    for note in playback.notes:
        say(f"note: {note}")
    return playback
