"""Friction cones: lines that an arm's force has to stay between, and a colour that says how nearly it does not."""

from __future__ import annotations

import numpy as np

from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.view.figure_style import DANGER, GREEN, ORANGE, rgb

SPOKES, RIM = 12, 48
# shares of mu f_n that are left, and the colours there
RESERVES = (0.05, 0.25, 0.5)
COLOURS = (rgb(DANGER), rgb(ORANGE), rgb(GREEN))
SHADES = 32  # so that a recording need not change colours at every moment


def cone_lines(mu: float, height: float, frame: Pose) -> Array:
    """Return a cone's lines with its apex in a contact frame's origin, open along its z axis, (N, 2, 3) [m].

    Args:
        mu: friction coefficient: mouth radius over height.
        height: [m].
        frame: the contact frame; lines are in the axes that it is given in.
    """
    angles = np.linspace(0.0, 2 * np.pi, RIM, endpoint=False)
    rim = height * np.column_stack([mu * np.cos(angles), mu * np.sin(angles), np.ones(RIM)])
    spokes = rim[:: RIM // SPOKES]
    lines = [np.stack([rim, np.roll(rim, -1, axis=0)], axis=1), np.stack([np.zeros_like(spokes), spokes], axis=1)]
    return np.concatenate(lines) @ frame.R.T + frame.p


def cone_colour(reserve: float) -> tuple[int, int, int]:
    """Return a cone's colour, vermillion at the edge of slipping, green far from it, 0 to 255.

    Args:
        reserve: share of mu f_n that is left, 0 to 1.
    """
    step = round(SHADES * reserve) / SHADES
    red, green, blue = (round(float(np.interp(step, RESERVES, channel))) for channel in zip(*COLOURS, strict=True))
    return red, green, blue
