"""`holdfast view`: a result folder or a scene in; a viewer in the browser, or one HTML file, out."""

from __future__ import annotations

import os
from pathlib import Path

from holdfast.cli.console import stdout
from holdfast.cli.results import opened_scene, recorded
from holdfast.cli.streams import say
from holdfast.errors import ModelError, ResultError, SingularChainError, StateError
from holdfast.io.typed import refusal
from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.scenario.build import Scenario
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.state import Inputs
from holdfast.view.film import Film, Looks, film_of_instant, film_of_run
from holdfast.view.live import watch
from holdfast.view.page import export_page
from holdfast.view.pieces import pieces_in_files

LAST_PORT = 65535


def view(target: Path, page: Path | None, port: int, rate: float, overwrite: bool, trust_xacro: bool) -> int:
    """Show a run, or a scene's closed initial state, until the user has seen enough; or write it as a page.

    Args:
        target: a result folder, or a scene file.
        page: the HTML file to write; None to serve the viewer instead.
        port: to serve at; 0 for any that is free.
        rate: moments a second that are shown.
        overwrite: replace an existing file.
        trust_xacro: expand xacro files that a scene names.

    Returns:
        0, also after Ctrl-C, which is how a viewer ends.

    Raises:
        HoldfastError: what is not there, cannot be read, or cannot be shown.
    """
    if not 0 <= port <= LAST_PORT:
        raise ModelError(f"port: expected 0 (any that is free) to {LAST_PORT}, got {port}")
    if page is not None and os.path.lexists(page) and not overwrite:
        raise ResultError(f"{page}: is there already; try --overwrite, or another --export")
    film = _film(target, rate, trust_xacro)
    if page is not None:
        export_page(film, page)
        moments = "1 moment" if len(film) == 1 else f"{len(film)} moments"
        stdout().print(f"{page}: {page.stat().st_size / 2**20:.1f} MiB, {moments}", soft_wrap=True)
        return 0
    try:
        watch(film, _announce, port)
    except KeyboardInterrupt:
        stdout().print("closed")
    return 0


def _announce(address: str) -> None:
    console = stdout()
    console.print(f"{address}   (Ctrl-C ends it)")
    console.file.flush()


def _film(target: Path, rate: float, trust_xacro: bool) -> Film:
    if not os.path.exists(target):  # Path.exists raises at names that are too long
        raise refusal(str(target), "no such file or folder; expected a result folder or a scene file")
    if not os.path.isdir(target):
        return _film_of_scene(opened_scene(target, trust_xacro), target)
    setting, result = recorded(target, trust_xacro)
    return film_of_run(setting.chain, result.trajectory, setting.name, rate, setting.base_motion, _looks(setting.chain))


def _film_of_scene(scenario: Scenario, source: Path) -> Film:
    """Return the one moment in which the scene begins, under its controller's torques."""
    world = Environment(
        scenario.chain, scenario.options.get("base_motion", {}), scenario.options.get("inputs") or Inputs()
    )
    try:
        return film_of_instant(
            evaluate(world, scenario.controller, 0.0, scenario.state, None), scenario.name, _looks(scenario.chain)
        )
    except (SingularChainError, StateError) as cause:
        raise type(cause)(f"{source}: {cause}") from cause


def _looks(chain: ClosedChain) -> Looks:
    """Return the surfaces of arms and trunk whose files have them; say on stderr whose meshes are not to be had."""
    looks, missing = pieces_in_files(chain)
    for name, (first, *others) in missing.items():
        more = f", and {len(others)} more" if others else ""
        what = name if name == TRUNK else f"arm '{name}'"
        say(f"note: {what} is drawn with simple solids: {first}{more}")
    return looks
