"""The torques of the joints against their limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.trajectory import Trajectory
from holdfast.view import figure_style
from holdfast.view.figure_style import BLACK, BLUE, COLUMN, DANGER, GREEN, ORANGE, PURPLE, SKY, STYLE

ARMS_ABREAST = 4
# no vermillion: the limit has it
JOINT_LOOKS = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (BLACK, "-"), (PURPLE, "--"), (SKY, "-."), (BLUE, ":"))


def joint_torque_figure(chain: ClosedChain, run: Trajectory) -> Any:
    """Return a figure of the drives' torques, and of their share of the limits, one column per arm.

    Of an arm with more than seven joints the seven that come nearest to their limits (or, without
    limits, with the largest torques) are told apart, the others are grey.

    Args:
        chain: the chain that was simulated.
        run: its run.

    Returns:
        A matplotlib Figure.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    Figure, rc_context = figure_style.matplotlib()
    abreast = min(len(chain.names), ARMS_ABREAST)
    bands = -(-len(chain.names) // abreast)
    with rc_context(STYLE):
        figure = Figure(figsize=(COLUMN * max(1.0, abreast / 2), 3.2 * bands + 0.5), layout="constrained")
        panels = figure.subplots(2 * bands, abreast, sharex=True, sharey="row", squeeze=False)
        for k, name in enumerate(chain.names):
            band, column = divmod(k, abreast)
            torque, share = panels[2 * band : 2 * band + 2, column]
            torque.set_title(name)
            _draw(chain, run, name, torque, share)
            share.set_xlabel("time [s]")
            share.tick_params(labelbottom=True)
            if column == 0:
                torque.set_ylabel(_label(chain))
                share.set_ylabel("share of limit [%]")
        for panel in panels.flat:
            if not panel.lines:
                panel.set_axis_off()
        figure.align_ylabels()
        handles = {line.get_label(): line for panel in panels.flat for line in panel.lines}
        named = [handles[label] for label in sorted(handles) if not label.startswith("_")]
        figure.legend(handles=named[:28], loc="outside upper center", ncols=4, columnspacing=1.0)
    return figure


def _draw(chain: ClosedChain, run: Trajectory, name: str, torque: Any, share: Any) -> None:
    """Draw the torques of one arm into its two panels."""
    arm, tau = chain.arms[name], run.tau[:, chain.joints[name]]
    limits = np.array([joint.effort_limit for joint in arm.joints])
    limited = np.isfinite(limits)
    use = np.where(limited, 100 * np.abs(tau) / limits, 0.0)
    first = np.argsort(-(use if limited.any() else np.abs(tau)).max(axis=0), kind="stable")[: len(JOINT_LOOKS)]
    for k, joint in enumerate(arm.joints):
        place = sorted(first).index(k) if k in first else None
        colour, line = ("#bbbbbb", "-") if place is None else JOINT_LOOKS[place]
        label = "_" if place is None else joint.name or f"joint{k + 1}"
        torque.plot(run.t, tau[:, k], linestyle=line, color=colour, label=label)
        if limited[k]:
            share.plot(run.t, use[:, k], linestyle=line, color=colour, label=label)
    if limited.any():
        share.axhline(100.0, color=DANGER, linewidth=0.8)
        share.set_ylim(0, max(105.0, 1.05 * use.max()))


def _label(chain: ClosedChain) -> str:
    kinds = {joint.kind for arm in chain.arms.values() for joint in arm.joints}
    return {1: "torque [N m]", 2: "torque, force\n[N m, N]"}[len(kinds)] if "revolute" in kinds else "force [N]"
