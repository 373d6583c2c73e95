"""The wrenches at the grasps, and what of the forces moves the object."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.trajectory import Trajectory
from holdfast.view import figure_style
from holdfast.view.figure_style import BLACK, COLUMN, COMPONENTS, INTERNAL, STYLE

ARMS_ABREAST = 4


def grasp_wrench_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the grasp wrenches, one column of panels per arm that holds.

    Force and moment of the arm on the object about the contact, world axes, and the norms
    of the force's motion and internal parts.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    Figure, rc_context = figure_style.matplotlib()
    held = [i for i in range(len(chain.names)) if run.holding[:, i].any()]
    abreast = min(max(len(held), 1), ARMS_ABREAST)
    bands = -(-max(len(held), 1) // abreast)
    internal = run.internal_wrench[..., 3:]
    norms = (np.linalg.norm(part, axis=2) for part in (run.grasp_wrench[..., 3:] - internal, internal))
    parts = list(zip(("motion part", "internal part"), norms, ("-", "--"), (BLACK, INTERNAL), strict=True))
    with rc_context(STYLE):
        figure = Figure(figsize=(COLUMN * max(1.0, abreast / 2), 4.2 * bands + 0.3), layout="constrained")
        panels = figure.subplots(3 * bands, abreast, sharex=True, sharey="row", squeeze=False)
        for k, i in enumerate(held):
            band, column = divmod(k, abreast)
            force, moment, split = panels[3 * band : 3 * band + 3, column]
            force.set_title(_title(chain, i))
            for panel, first in ((force, 3), (moment, 0)):
                for axis, (label, colour, line) in enumerate(COMPONENTS):
                    panel.plot(run.t, run.grasp_wrench[:, i, first + axis], line, color=colour, label=label)
            for label, norm, line, colour in parts:
                split.plot(run.t, norm[:, i], line, color=colour, label=label)
            split.set_ylim(bottom=0)
            split.set_xlabel("time [s]")
            split.tick_params(labelbottom=True)
            if column == 0:
                for panel, label in ((force, "force [N]"), (moment, "moment [N m]"), (split, "|force| [N]")):
                    panel.set_ylabel(label)
        for panel in panels.flat:
            if not panel.lines:
                panel.set_axis_off()
        figure.align_ylabels()
        if held:
            handles = [line for panel in (panels[0, 0], panels[2, 0]) for line in panel.lines]
            figure.legend(handles=handles, loc="outside upper center", ncols=5, columnspacing=1.0)
    return figure


def _title(chain: ClosedChain, arm: int) -> str:
    """Return an arm's name and, if it begins with one, its grasp's kind."""
    name = chain.names[arm]
    return f"{name} ({chain.grasps[name].kind})" if name in chain.grasps else name
