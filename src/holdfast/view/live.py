"""The live viewer: a playback in the browser, with controls beside it and the numbers of the frame that is shown."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from holdfast.model.grasp_rows import GraspRow
from holdfast.view.cameras import cameras, upward
from holdfast.view.chain_scene import ChainScene
from holdfast.view.embedded import escaped
from holdfast.view.figure_style import DANGER, GREEN, ORANGE, part_colour
from holdfast.view.markers import ArrowScale, common_scale
from holdfast.view.page import different_playbacks, legend, meter, plots
from holdfast.view.playback import Playback
from holdfast.view.scene_writer import Camera, SceneWriter, viewer_server

SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "4x")
TICK = 1 / 60  # s


def watch(playbacks: Playback | Sequence[Playback], announce: Callable[[str], None], port: int = 0) -> None:
    """Show playbacks in the browser of this machine, one at a time, until KeyboardInterrupt.

    Args:
        playbacks: one or several playbacks, with different titles.
        announce: function that is called with the address when it can be opened.
        port: port of the server; 0 for any free port.

    Raises:
        MissingExtra: viser is not installed.
        ModelError: as for `export_page`.
        HoldfastError: the port is not free.
        KeyboardInterrupt: the user ended the viewer; the server has been stopped.
    """
    shown = different_playbacks(playbacks)
    titles, scale = [playback.title for playback in shown], common_scale(shown)
    with viewer_server(port) as server:
        controls, announced = None, False
        while True:
            playback = shown[0 if controls is None else titles.index(controls.chosen)]
            with server.atomic():
                server.scene.reset()
                server.gui.reset()
                scene = ChainScene(SceneWriter(server), playback, scale)
                controls = Controls(server, playback, scene.scale, titles, controls)
            if not announced:
                announce(f"http://127.0.0.1:{server.get_port()}")
                announced = True
            before = None
            while controls.chosen == playback.title:
                now = controls.frame(time.monotonic()), controls.scale
                if now != before:
                    before = now
                    frame, scene.scale = now
                    scene.show(frame)
                    controls.show_numbers(frame)
                time.sleep(TICK)


class Controls:
    """The controls beside the picture, and the clock of the playback."""

    def __init__(
        self,
        server: Any,
        playback: Playback,
        scale: ArrowScale,
        titles: Sequence[str] = (),
        earlier: Controls | None = None,
    ) -> None:
        """Create the controls.

        Args:
            server: the result of `viewer_server`.
            playback: the playback that is shown.
            scale: default scale of the arrows.
            titles: titles of all playbacks; there is no choice if there is only one.
            earlier: controls of the previous playback, whose time is kept.
        """
        self._playback, self._usual, self._choice = playback, scale, None
        first, last = float(playback.t[0]), float(playback.t[-1])
        self._playing, self._before = False, time.monotonic()
        self._time = first if earlier is None else min(max(earlier._time, first), last)
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        key = " ".join(chip(part_colour(playback.chain, name), name) for name in playback.chain.names)
        gui.add_html(f"<div style='padding:0 1em'><b>{escaped(playback.title)}</b><br>{key}</div>")
        if len(titles) > 1:
            self._choice = gui.add_dropdown("run", titles, initial_value=playback.title)
        if len(playback) > 1:
            self._slider = gui.add_slider("time [s]", first, last, 1e-3, self._time)
            self._button = gui.add_button("Play")
            self._speed = gui.add_dropdown("speed", SPEEDS, initial_value="1x")
            self._button.on_click(lambda _: self._play(not self._playing))
        self._length = gui.add_slider("arrow length", 0.1, 5.0, 0.1, 1.0)
        views = {view.name: view for view in cameras(playback)}
        buttons = gui.add_button_group("look from", tuple(views))
        buttons.on_click(lambda event: _set_camera(event.client, views[buttons.value], upward(playback.chain)))
        self._legend = gui.add_html("")
        self._numbers = gui.add_html("")
        for plot in plots(playback) if len(playback) > 1 else []:
            if plot["curves"]:
                _add_curves(gui, playback, plot)

    @property
    def chosen(self) -> str:
        """The title of the selected playback."""
        return self._playback.title if self._choice is None else str(self._choice.value)

    @property
    def scale(self) -> ArrowScale:
        """The selected scale of the arrows."""
        return ArrowScale(*(self._length.value * usual for usual in self._usual))

    def frame(self, now: float) -> int:
        """Return the index of the frame to show.

        Args:
            now: time of a monotonic clock [s].
        """
        playback, passed, self._before = self._playback, now - self._before, now
        if len(playback) == 1:
            return 0
        if abs(self._slider.value - self._time) > 1e-3:  # the user moved it
            self._time = float(self._slider.value)
        elif self._playing:
            later = self._time + float(self._speed.value[:-1]) * passed
            self._time = later if later <= playback.t[-1] else float(playback.t[0])
            self._slider.value = round(self._time, 3)
        return int(np.searchsorted(playback.t, self._time + 1e-9, side="right").clip(1, len(playback))) - 1

    def show_numbers(self, frame: int) -> None:
        """Show the numbers of a frame."""
        self._legend.content = f"<div style='padding:0 1em;opacity:.75'>{legend(self._playback, self.scale)}</div>"
        self._numbers.content = readout(self._playback, frame)

    def _play(self, playing: bool) -> None:
        self._playing = playing
        self._button.label = "Pause" if playing else "Play"


def _set_camera(client: Any, view: Camera, up: Any) -> None:
    """Move one viewer's camera."""
    if client is not None:
        with client.atomic():
            client.camera.up_direction = up
            client.camera.position, client.camera.look_at = view.position, view.target


def _add_curves(gui: Any, playback: Playback, plot: dict[str, Any]) -> None:
    """Add the curves of one of the panel's plots over time."""
    from viser import uplot

    series = [uplot.Series(label="t [s]")]
    widths = np.linspace(4.0, 2.0, len(plot["curves"]))  # so that both of two equal curves are visible
    for curve, width in zip(plot["curves"], widths, strict=True):
        dash = (6.0, 4.0) if curve["dashed"] else ()
        series.append(uplot.Series(label=curve["label"], stroke=curve["colour"], width=float(width), dash=dash))
    values = (np.array([np.nan if v is None else v for v in curve["values"]]) for curve in plot["curves"])
    cut: Any = {"range": tuple(plot["range"])} if plot["range"] else {}  # a spike goes beyond the axis
    scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(distr=3 if plot["log"] else 1, **cut)}
    gui.add_uplot((playback.t, *values), tuple(series), title=plot["title"], scales=scales, aspect=1.8)


HEADINGS = ("", "force [N]", "internal [N]", "moment [N\u00a0m]", "margin [N]", "torque [%]")
ZONES = f"{GREEN} 28%,{ORANGE} 38%,{ORANGE} 62%,{DANGER} 72%"
METER = f"height:8px;border-radius:4px;background:linear-gradient(90deg,{ZONES})"
NEEDLE = "position:relative;top:-3px;width:3px;height:14px;background:#000"


def readout(playback: Playback, frame: int) -> str:
    """Return the wrenches in a frame, the margins, the torques relative to their limits, and the condition."""
    rows = "".join(_row(playback, frame, i, row) for i, row in enumerate(playback.rows))
    head = "".join(f"<th style='text-align:right;font-weight:normal'>{heading}</th>" for heading in HEADINGS)
    body = f"<b>t = {playback.t[frame]:.3f} s</b>"
    if rows:  # of a free object there is no more to say
        shown = meter(playback)
        share, nearest = shown["values"][frame] or 0.0, shown["names"][shown["nearest"][frame]]
        body += (
            f"<table style='width:100%'><tr>{head}</tr>{rows}</table>"
            f"condition of the grasps {playback.condition[frame]:.3g}; regular to singular, nearest:"
            f" {escaped(nearest)}"
            f"<div style='{METER}'><div style='{NEEDLE};left:{99 * share:.1f}%'></div></div>"
        )
    return f"<div style='padding:0 1em;font-size:.8em'>{body}</div>"


def chip(colour: str, name: str) -> str:
    """Return a name after a square in a colour '#rrggbb', as HTML."""
    return f"<span style='color:{colour}'>&#9632;</span> {escaped(name)}"


def _row(playback: Playback, frame: int, i: int, row: GraspRow) -> str:
    use = None if row.arm is None else playback.torque_use(row.arm)
    internal = float(np.linalg.norm(playback.internal[frame, i, 3:])) if playback.internal.size else np.inf
    moments, forces = playback.wrench[frame, i, :3], playback.wrench[frame, i, 3:]
    values = (
        float(np.linalg.norm(forces)),
        internal,
        float(np.linalg.norm(moments)),
        float(playback.margin[frame, i]),
        np.inf if use is None else 100 * float(use[frame]),
    )
    cells = "".join(f"<td style='text-align:right'>{_short(value)}</td>" for value in values)
    return f"<tr><td style='white-space:nowrap'>{chip(playback.colour(row.name), row.name)}</td>{cells}</tr>"


def _short(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return "0" if abs(value) < 1e-9 else f"{value:.3g}"
