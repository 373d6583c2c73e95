"""The figure of a run's contacts with the world."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model.world.touching import Touching
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style as style

DIGITS_OF_GAPS = 9  # of millimetres: less is rounding


def shapes_touched(touching: Touching) -> dict[str, Array]:
    """Return the numbers of the contacts with each shape, by its name."""
    of = np.array([name.rpartition("/")[2] for name in touching.names])
    return {name: np.flatnonzero(of == name) for name in dict.fromkeys(of.tolist())}


def world_forces_figure(touching: Touching, run: Trajectory) -> Any:
    """Return a figure of the contacts with the world, one column of panels per shape that touches.

    The panels show the components of the net force on the object, world axes, and the gaps that close.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    shapes = {name: own for name, own in shapes_touched(touching).items() if run.touch_force[:, own].any()}
    with style.columns_of_panels(len(shapes), 2.8, 0.3, ("force [N]", "gap [mm]")) as (figure, columns):
        for (name, own), (force, gap) in zip(shapes.items(), columns, strict=True):
            force.set_title(style.drawn_text(name))
            net = run.touch_force[:, own].sum(axis=1)
            for axis, (label, colour, line) in enumerate(style.COMPONENTS):
                force.plot(run.t, net[:, axis], line, color=colour, label=label)
            for j in own[run.touch_force[:, own].any(axis=(0, 2))]:
                gap.plot(run.t, np.round(1e3 * run.touch_gap[:, j], DIGITS_OF_GAPS), color=style.BLACK, linewidth=0.8)
        handles = columns[0][0].lines if columns else []
        style.without_spikes(figure, columns)
        if handles:
            figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure
