"""`holdfast view`: show a result folder or a scene in the browser, or write it as one HTML file."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from holdfast.cli.console import print_document, stdout
from holdfast.cli.folders import labels
from holdfast.cli.results import opened_scene, recorded
from holdfast.cli.standard import is_standard, write_stdout
from holdfast.cli.streams import say
from holdfast.errors import ModelError, ResultError, SceneError, SingularChainError, StateError
from holdfast.io.typed import refusal
from holdfast.scenario.build import Scenario
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.state import Inputs
from holdfast.view.chooser import MOST_PAGES
from holdfast.view.live import watch
from holdfast.view.page import export_page
from holdfast.view.playback import Playback, playback_of_instant, playback_of_run

LAST_PORT = 65535


def view(
    targets: Sequence[Path],
    page: Path | None,
    port: int,
    rate: float,
    overwrite: bool,
    trust_xacro: bool,
    changes: Sequence[str] = (),
    as_json: bool = False,
) -> int:
    """Show runs, or closed initial states of scenes, until the user presses Ctrl-C; or write them as an HTML file.

    Args:
        targets: result folders or scene files, `-` for a scene on stdin; of several, one is chosen in the page.
        page: the HTML file to write, `-` for stdout; None to serve the viewer instead.
        port: the port of the viewer; 0 for any free port.
        rate: number of frames shown per second of the run.
        overwrite: replace an existing file.
        trust_xacro: expand xacro files that a scene names.
        changes: changes `key=value` of a scene.
        as_json: print one JSON document on stdout instead of lines.

    Returns:
        0, also after Ctrl-C, which ends the viewer.

    Raises:
        HoldfastError: the target does not exist, cannot be read, or cannot be shown.
    """
    if not 0 <= port <= LAST_PORT:
        raise ModelError(f"port: expected 0 (any that is free) to {LAST_PORT}, got {port}")
    if is_standard(page) and as_json:
        raise ResultError("--export -: stdout takes the page or, with --json, a report; try one of them")
    if page is not None and not is_standard(page) and os.path.lexists(page) and not overwrite:
        raise ResultError(f"{page}: exists already; try --overwrite, or another --export")
    titles = labels(targets, MOST_PAGES, "RESULT|SCENE")
    playbacks = [_playback(target, rate, trust_xacro, changes) for target in targets]
    if len(playbacks) > 1:
        playbacks = [replace(one, title=title) for one, title in zip(playbacks, titles, strict=True)]
    if page is not None and is_standard(page):
        write_stdout(lambda path: export_page(playbacks, path), "page.html")
        return 0
    if page is not None:
        export_page(playbacks, page)
        frames, runs = sum(map(len, playbacks)), f"{len(playbacks)} runs, " if len(playbacks) > 1 else ""
        if as_json:
            print_document({"file": str(page), "bytes": page.stat().st_size, "moments": frames})
            return 0
        size, plural = page.stat().st_size / 2**20, "" if frames == 1 else "s"
        stdout().print(f"{page}: {size:.1f} MiB, {runs}{frames} frame{plural}", soft_wrap=True)
        return 0
    try:
        watch(playbacks, _announce_json if as_json else _announce, port)
    except KeyboardInterrupt:
        if not as_json:
            stdout().print("closed")
    return 0


def _announce(address: str) -> None:
    console = stdout()
    console.print(f"{address}   (Ctrl-C stops it)")
    console.file.flush()


def _announce_json(address: str) -> None:
    print_document({"address": address})
    sys.stdout.flush()


def _playback(target: Path, rate: float, trust_xacro: bool, changes: Sequence[str]) -> Playback:
    if is_standard(target):
        return _playback_of_scene(opened_scene(target, trust_xacro, changes), target)
    if not os.path.exists(target):  # Path.exists raises an error for names that are too long
        raise refusal(str(target), "no such file or folder; expected a result folder or a scene file")
    if not os.path.isdir(target):
        return _playback_of_scene(opened_scene(target, trust_xacro, changes), target)
    if changes:
        raise SceneError(f"--set: expected a scene, whose keys it sets, got the result folder {target}")
    setting, result = recorded(target, trust_xacro)
    return _noted(playback_of_run(setting.chain, result.trajectory, setting.name, rate, setting.base_motion))


def _playback_of_scene(scenario: Scenario, source: Path) -> Playback:
    """Return a playback of the scene's initial state, with the controller's torques."""
    world = Environment(
        scenario.chain, scenario.options.get("base_motion", {}), scenario.options.get("inputs") or Inputs()
    )
    try:
        return _noted(
            playback_of_instant(evaluate(world, scenario.controller, 0.0, scenario.state, None), scenario.name)
        )
    except (SingularChainError, StateError) as cause:
        raise type(cause)(f"{source}: {cause}") from cause


def _noted(playback: Playback) -> Playback:
    """Return the playback; print on stderr which meshes cannot be read."""
    for note in playback.notes:
        say(f"note: {note}")
    return playback
