"""One HTML file that plays a playback beside a panel of curves, without network access or this program."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.dynamics.near_singular import NEAR_SINGULAR, NEARING, chain_strength
from holdfast.errors import ModelError
from holdfast.io.files import file_path, write_atomically
from holdfast.simulation.run_outputs import FRAME_RATE
from holdfast.spatial.scalar import Array
from holdfast.view.cameras import cameras
from holdfast.view.chain_scene import ChainScene
from holdfast.view.embedded import data_element, escaped
from holdfast.view.figure_style import BLACK, NOISE, TRUNK_COLOUR, part_colour, usual_range
from holdfast.view.markers import ArrowScale, common_scale
from holdfast.view.playback import Playback, base_travel, torque_shares
from holdfast.view.scene_writer import SceneWriter, viewer_server
from holdfast.view.world_figure import shapes_touched


def export_page(playback: Playback | Sequence[Playback], path: str | PathLike[str]) -> None:
    """Write playbacks as one HTML file, either completely or not at all; the page offers a choice of several playbacks.

    The player starts at once and repeats; the space bar pauses it. A playback of one frame stands still. A change to
    another playback keeps time and camera, and pauses.

    Args:
        playback: the playback, or at most 12 playbacks with different titles.
        path: the file.

    Raises:
        MissingExtra: viser is not installed.
        ModelError: a value is not a playback, there are too many, or two have the same title.
        ResultError: the file cannot be written.
    """
    several = different_playbacks(playback)
    place = file_path(path, "path")
    scale = common_scale(several)
    pages = [page(one, scale) for one in several]
    text = pages[0] if len(pages) == 1 else with_chooser(pages, [one.title for one in several])
    write_atomically(place, text.encode("utf-8"))


def page(playback: Playback, scale: ArrowScale | None = None) -> str:
    """Return the text of the HTML file of one playback; the same playback gives the same text.

    Args:
        playback: the playback.
        scale: scale of the arrows; None for the playback's own.

    Raises:
        MissingExtra: viser is not installed.
    """
    with viewer_server() as server:
        scene = ChainScene(SceneWriter(server), playback, scale)
        recording = server.get_scene_serializer()
        for k in range(1, len(playback)):
            recording.insert_sleep(float(playback.t[k] - playback.t[k - 1]))
            scene.show(k)
        if len(playback) > 1:
            recording.insert_sleep(1 / FRAME_RATE)  # otherwise the player would be at the beginning when it ends
        return with_panel(recording.as_html(), playback, scene.scale)


HERE = Path(__file__).parent
DIGITS = 4
GAP = "\u00a0"  # a space without a line break
GONE = 1e-3  # strength at the end of the meter


def with_panel(page: str, playback: Playback, scale: ArrowScale) -> str:
    """Return viser's page with the panel and the playback's title.

    Args:
        page: the page returned by viser's recording.
        playback: the recorded playback.
        scale: scale of the arrows.
    """
    style, script = ((HERE / f"page_panel.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    head, body = f"<style>{style}</style></head>", page.rindex("</body>")
    data = data_element("holdfast-data", panel_data(playback, scale))
    panel = f'<aside id="holdfast"></aside>{data}<script>{script}</script>'
    page = page[:body] + panel + page[body:]
    return page.replace("<title>Viser</title>", f"<title>{escaped(playback.title)}</title>", 1).replace(
        "</head>", head, 1
    )


def panel_data(playback: Playback, scale: ArrowScale) -> dict[str, Any]:
    """Return the content of the panel as plain data; times count from the first frame [s]."""
    return {
        "title": playback.title,
        "start": float(playback.t[0]),
        "times": _rounded(playback.t - playback.t[0], 6),
        "cameras": [
            {"name": view.name, "position": view.position.tolist(), "target": view.target.tolist()}
            for view in cameras(playback)
        ],
        "notes": [legend(playback, scale), *playback.notes],
        "bars": bars(playback),
        "plots": plots(playback),
        "meters": [meter(playback)] if playback.rows else [],  # a free object has nothing that can be singular
    }


def legend(playback: Playback, scale: ArrowScale) -> str:
    """Return a few sentences that explain arrows and cones."""
    whose = "at a grasp or a loop" if playback.chain.beyond_serial else "on the object"
    newtons, sentences = f"(0.1{GAP}m is {0.1 / scale.force:.3g}{GAP}N)", []
    if playback.rows:
        sentences.append(
            f"Arrows in an arm's colour are its force {whose} {newtons}, with two heads its moment (0.1{GAP}m is"
            f" {0.1 / scale.moment:.3g}{GAP}N{GAP}m)."
        )
    if playback.touch_force is not None:
        size = "" if sentences else f" {newtons}"
        sentences.append(f"Dark grey arrows are forces of the world on the object{size}.")
    if playback.internal.size:
        sentences.append("Purple arrows are the internal force.")
    if playback.commanded is not None:
        sentences.append("Below them, in dark purple, is what the controller commands.")
    if any(row.grasp is not None and row.grasp.contact is not None for row in playback.rows):
        sentences.append("Friction cones turn from green to red as a contact approaches slipping.")
    if playback.chain.trunk is not None:
        sentences.append("Grey is the trunk.")
    return " ".join(sentences)


def bars(playback: Playback) -> list[dict[str, Any]]:
    """Return the bars of limits in use, one group for each arm and the trunk: torques, and the friction at its grasp.

    `allowed` is the share of the effort limits that the controller may use [%].
    """
    chain, found = playback.chain, []
    effort = None if playback.limits is None else playback.limits.effort
    for name, joints in chain.joints_of.items():
        shares = torque_shares(chain, name, playback.tau).T
        used = {str(j + 1): shares[j] for j, joint in enumerate(joints) if np.isfinite(joint.effort_limit)}
        for row in playback.rows:
            if row.arm == name and row.grasp is not None and row.grasp.contact is not None:
                used["grip" if row.name == name else row.name.partition("/")[2]] = playback.grip_use(row.name)
        group = [{"label": label, "values": _rounded(100 * share, 3)} for label, share in used.items()]
        allowed = 100.0 if effort is None else 100.0 * effort
        found.append({"title": name, "colour": part_colour(chain, name), "bars": group, "allowed": allowed})
    return [one for one in found if one["bars"]]


def plots(playback: Playback) -> list[dict[str, Any]]:
    """Return the panel's curves: forces, moments, the world's, margins, torques, condition; none that is all zero.

    Internal forces have a plot of their own if the controller commands them.
    """
    names = [row.name for row in playback.rows]
    force, moment, internal_force = (
        np.linalg.norm(part, axis=2)
        for part in (playback.wrench[..., 3:], playback.wrench[..., :3], playback.internal[..., 3:])
    )
    moment[moment < NOISE * force.max(initial=0.0)] = 0.0
    parts = {name: part_colour(playback.chain, name) for name in playback.chain.joints_of}
    colours = parts | {name: playback.colour(name) for name in names}
    held = [(name, names.index(name)) for name in playback.holding]
    forces = [_curve(name, colours[name], force[:, i]) for name, i in held]
    split = held if playback.internal.size else []
    inside = [_curve(f"{name}, internal", colours[name], internal_force[:, i], dashed=True) for name, i in split]
    commands: list[dict[str, Any]] = []
    if playback.commanded is None:
        forces += inside
    else:
        asked = np.linalg.norm(playback.commanded[..., 3:], axis=2)
        commands = [_curve(name, colours[name], internal_force[:, i]) for name, i in held]
        commands += [_curve(f"{name}, commanded", colours[name], asked[:, i], dashed=True) for name, i in held]
    moments = [_curve(name, colours[name], moment[:, i]) for name, i in held]
    limited = [(name, i) for name, i in held if np.isfinite(playback.margin[:, i]).any()]
    margins = [_curve(name, colours[name], playback.margin[:, i]) for name, i in limited]
    uses = {name: playback.torque_use(name) for name in parts}
    torques = [_curve(name, colours[name], 100 * use) for name, use in uses.items() if use is not None]
    travel = base_travel(playback.trunk_pose)._asdict() if playback.chain.floats else {}
    away = [
        _curve(name, TRUNK_COLOUR, np.linalg.norm(way, axis=1), dashed=name == "turn") for name, way in travel.items()
    ]
    condition = [_curve(_closures(playback).removeprefix("the "), BLACK, playback.condition)] if playback.rows else []
    whose = "at grasps and loops" if playback.chain.beyond_serial else "on the object"
    found = [
        _plot(f"force {whose} [N]", forces),
        _plot("internal force [N]", commands),
        _plot(f"moment {whose} [N m]", moments),
        _plot("force of the world on the object [N]", _of_world(playback)),
        _plot("margin of the grasp [N], gives way below 0", margins, lines=[0.0]),
        _plot("largest torque [% of its limit]", torques),
        _plot("floating base from its start [m, rad]", away),
        _plot(f"condition of {_closures(playback)} [1]", condition, log=True),
    ]
    return [plot for plot in found if any(any(curve["values"]) for curve in plot["curves"])]


def _of_world(playback: Playback) -> list[dict[str, Any]]:
    """Return the size of the net force of each shape that the object may touch."""
    touching, force = playback.chain.touching, playback.touch_force
    if touching is None or force is None:
        return []
    own = [(name, force[:, rows].sum(axis=1)) for name, rows in shapes_touched(touching).items()]
    return [_curve(name, BLACK, np.linalg.norm(net, axis=1), dashed=k % 2 == 1) for k, (name, net) in enumerate(own)]


def meter(playback: Playback) -> dict[str, Any]:
    """Return the singularity meter, green up to 1/3, orange up to 2/3, then red, and the part nearest to a singularity.

    It shows the weaker of the grasp constraint and the weakest arm, on the scale of `near_singular`.
    """
    strengths = np.column_stack([chain_strength(playback.condition), playback.strength])
    nearest = np.argmin(strengths, axis=1)
    weakest = np.maximum(strengths.min(axis=1), GONE)
    values = np.interp(-np.log(weakest), -np.log([1.0, NEARING, NEAR_SINGULAR, GONE]), [0.0, 1 / 3, 2 / 3, 1.0])
    return {
        "title": "singularity meter",
        "values": _rounded(values),
        "names": [_closures(playback), *playback.chain.names],
        "nearest": nearest.tolist(),
        "ends": ["regular", "singular"],
    }


def _closures(playback: Playback) -> str:
    return "grasps and loops" if playback.chain.beyond_serial else "the grasps"


def _plot(title: str, curves: list[dict[str, Any]], lines: list[float] | None = None, log: bool = False) -> Any:
    cut = None if log else usual_range([np.array(curve["values"], dtype=float) for curve in curves])
    return {"title": title, "curves": curves, "lines": lines or [], "log": log, "range": cut}


def _curve(label: str, colour: str, values: Array, dashed: bool = False) -> dict[str, Any]:
    return {"label": label, "colour": colour, "dashed": dashed, "values": _rounded(values)}


def _rounded(values: Array, digits: int = DIGITS) -> list[float | None]:
    """Return values rounded for display; None for values that are not finite."""
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in values]


MOST_PAGES = 12  # browsers draw at most 16 players at once


def different_playbacks(given: Any) -> list[Playback]:
    """Return one or several playbacks as a list for a chooser.

    Raises:
        ModelError: a value is not a playback, there are none or too many, or two have the same title.
    """
    playbacks = list(given) if isinstance(given, list | tuple) else [given]
    for one in playbacks:
        if not isinstance(one, Playback):
            raise ModelError(
                f"playback: expected a playback, got a {type(one).__name__}; try playback_of_run(chain, run)"
            )
    if not 1 <= len(playbacks) <= MOST_PAGES:
        raise ModelError(f"playbacks: expected 1 to {MOST_PAGES}, got {len(playbacks)}; try several files")
    titles = [one.title for one in playbacks]
    for k, title in enumerate(titles):
        if title in titles[:k]:
            raise ModelError(
                f"playbacks: expected a title of its own for each, got '{title}' twice; try"
                " dataclasses.replace(playback, title=...)"
            )
    return playbacks


def with_chooser(pages: Sequence[str], titles: Sequence[str]) -> str:
    """Return a page that shows one of several pages; a change of page keeps time and camera.

    Args:
        pages: the result of `page` for each playback.
        titles: titles of the playbacks, all different.
    """
    data = data_element("pages", {"titles": list(titles), "pages": list(pages)})
    style, script = ((HERE / f"chooser.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escaped(", ".join(titles))}</title>'
        f"<style>{style}</style></head><body><nav></nav><main></main>"
        f"{data}<script>{script}</script></body></html>\n"
    )
