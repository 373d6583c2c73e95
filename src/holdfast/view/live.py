"""The live viewer: a film in the browser, with time, speed, cameras and the length of arrows to hand."""

from __future__ import annotations

import html
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from holdfast.view.arrow_scale import ArrowScale
from holdfast.view.cameras import cameras, upward
from holdfast.view.chain_scene import ChainScene
from holdfast.view.film import Film
from holdfast.view.page_panel import legend, plots
from holdfast.view.readout import chip, readout
from holdfast.view.scene_writer import Camera, SceneWriter, viewer_server

SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "4x")
TICK = 1 / 60  # s


def watch(film: Film, announce: Callable[[str], None], port: int = 0) -> None:
    """Show a film in the browser until KeyboardInterrupt; only this machine can see it.

    Args:
        film: what to show.
        announce: called with the address once it can be opened.
        port: to listen at; 0 for any that is free.

    Raises:
        MissingExtra: viser is not installed.
        HoldfastError: the port is not free.
        KeyboardInterrupt: the end; the server has been stopped.
    """
    with viewer_server(port) as server:
        scene = ChainScene(SceneWriter(server), film)
        controls = Controls(server, film, scene.scale)
        announce(f"http://127.0.0.1:{server.get_port()}")
        shown = None
        while True:
            moment, scale = controls.moment(time.monotonic()), controls.scale
            if (moment, scale) != shown:
                shown = moment, scale
                scene.scale = scale
                scene.show(moment)
                controls.tell(moment)
            time.sleep(TICK)


class Controls:
    """The controls beside the picture, and the clock that they govern."""

    def __init__(self, server: Any, film: Film, scale: ArrowScale) -> None:
        """Put the controls up.

        Args:
            server: of `viewer_server`.
            film: what is shown.
            scale: of the arrows at their usual length.
        """
        self._film, self._usual = film, scale
        self._playing, self._time, self._before = False, float(film.t[0]), time.monotonic()
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        key = " ".join(chip(i, name) for i, name in enumerate(film.chain.names))
        gui.add_html(f"<div style='padding:0 1em'><b>{html.escape(film.title)}</b><br>{key}</div>")
        if len(film) > 1:
            self._slider = gui.add_slider("time [s]", self._time, float(film.t[-1]), 1e-3, self._time)
            self._button = gui.add_button("Play")
            self._speed = gui.add_dropdown("speed", SPEEDS, initial_value="1x")
            self._button.on_click(lambda _: self._play(not self._playing))
        self._length = gui.add_slider("arrow length", 0.1, 5.0, 0.1, 1.0)
        views = {view.name: view for view in cameras(film)}
        buttons = gui.add_button_group("look from", tuple(views))
        buttons.on_click(lambda event: _look(event.client, views[buttons.value], upward(film.chain)))
        self._legend = gui.add_html("")
        self._numbers = gui.add_html("")
        for plot in plots(film) if len(film) > 1 else []:
            if plot["curves"]:
                _add_curves(gui, film, plot)

    @property
    def scale(self) -> ArrowScale:
        """The scale of the arrows that is asked for."""
        return ArrowScale(*(self._length.value * usual for usual in self._usual))

    def moment(self, now: float) -> int:
        """Return which moment of the film to show.

        Args:
            now: time of a clock that never goes back [s].
        """
        film, passed, self._before = self._film, now - self._before, now
        if len(film) == 1:
            return 0
        if abs(self._slider.value - self._time) > 1e-3:  # someone moved it
            self._time = float(self._slider.value)
        elif self._playing:
            later = self._time + float(self._speed.value[:-1]) * passed
            self._time = later if later <= film.t[-1] else float(film.t[0])
            self._slider.value = round(self._time, 3)
        return int(np.searchsorted(film.t, self._time + 1e-9, side="right").clip(1, len(film))) - 1

    def tell(self, moment: int) -> None:
        """Show the numbers of a moment."""
        self._legend.content = f"<div style='padding:0 1em;opacity:.75'>{legend(self._film, self.scale)}</div>"
        self._numbers.content = readout(self._film, moment)

    def _play(self, playing: bool) -> None:
        self._playing = playing
        self._button.label = "Pause" if playing else "Play"


def _look(client: Any, view: Camera, up: Any) -> None:
    """Move one viewer's camera."""
    if client is not None:
        with client.atomic():
            client.camera.up_direction = up
            client.camera.position, client.camera.look_at = view.position, view.target


def _add_curves(gui: Any, film: Film, plot: dict[str, Any]) -> None:
    """Add the curves of one of the panel's plots over time."""
    from viser import uplot

    series = [uplot.Series(label="t [s]")]
    for curve in plot["curves"]:
        dash = (6.0, 4.0) if curve["dashed"] else ()
        series.append(uplot.Series(label=curve["label"], stroke=curve["colour"], width=2, dash=dash))
    values = (np.array([np.nan if v is None else v for v in curve["values"]]) for curve in plot["curves"])
    scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(distr=3 if plot["log"] else 1)}
    gui.add_uplot((film.t, *values), tuple(series), title=plot["title"], scales=scales, aspect=1.8)
