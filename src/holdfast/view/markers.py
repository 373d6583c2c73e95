"""Markers beside the arms: the object as a box, friction cones, and arrows of a suitable length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.constraint import length_scale
from holdfast.model.closed_chain import ClosedChain
from holdfast.robots.visuals import chain_length
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.view.figure_style import DANGER, GREEN, ORANGE, rgb
from holdfast.view.playback import Playback


def box_lines(edges: Array) -> Array:
    """Return the twelve edges of a box about the origin as lines, (12, 2, 3) [m]."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * edges
    pairs = [(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit]
    return corners[np.array(pairs)]


def contacts_on(chain: ClosedChain, name: str) -> list[Array]:
    """Return the contact points on an object, (3,) each, object axes [m]."""
    return [one.frame.p for key, one in chain.grasps.items() if chain.held_by(one, key) == name]


def struts(contacts: Sequence[Array], edges: Array, box: Pose) -> Array:
    """Return lines from the middle of an object's box to its contacts off the surface, (N, 2, 3) object axes [m]."""
    lines = []
    for p in contacts:
        outside = np.abs(box.R.T @ (p - box.p)) - edges / 2
        if outside.max() > 0.02 * edges.max():
            lines.append([box.p, p])
    return np.array(lines).reshape(-1, 2, 3)


TURNS, PER_TURN = 8, 12


def coil(a: Array, b: Array, radius: float) -> Array:
    """Return a coil from one point to another as a fixed number of lines, (N, 2, 3) [m]."""
    turn = rotation.exp(rotation.align(np.array([0.0, 0.0, 1.0]), _direction(b - a)))
    angles = np.linspace(0.0, 2 * np.pi * TURNS, TURNS * PER_TURN + 1)
    around = np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles]) @ turn.T
    wound = a + np.linspace(0.1, 0.9, len(angles))[:, None] * (b - a) + radius * around
    points = np.concatenate([[a], wound, [b]])
    return np.stack([points[:-1], points[1:]], axis=1)


def _direction(vector: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0 else np.array([0.0, 0.0, 1.0])


SPOKES, RIM = 12, 48
# margins relative to mu f_n, and their colours
RESERVES = (0.05, 0.25, 0.5)
RESERVE_COLOURS = (rgb(DANGER), rgb(ORANGE), rgb(GREEN))
SHADES = 32  # so that colours do not change in every frame of a recording


def cone_lines(mu: float, height: float, frame: Pose) -> Array:
    """Return the lines of a cone with its apex at the origin of a contact frame and its axis along z, (N, 2, 3) [m].

    Args:
        mu: friction coefficient, the ratio of the cone's radius to its height.
        height: height of the cone [m].
        frame: the contact frame; the lines are in the axes in which it is given.
    """
    angles = np.linspace(0.0, 2 * np.pi, RIM, endpoint=False)
    rim = height * np.column_stack([mu * np.cos(angles), mu * np.sin(angles), np.ones(RIM)])
    spokes = rim[:: RIM // SPOKES]
    lines = [np.stack([rim, np.roll(rim, -1, axis=0)], axis=1), np.stack([np.zeros_like(spokes), spokes], axis=1)]
    return np.concatenate(lines) @ frame.R.T + frame.p


def cone_colour(reserve: float) -> tuple[int, int, int]:
    """Return a cone's colour, 0 to 255, from vermillion at the onset of slip to green far from it.

    Args:
        reserve: margin relative to mu f_n, 0 to 1.
    """
    step = round(SHADES * reserve) / SHADES
    channels = zip(*RESERVE_COLOURS, strict=True)
    red, green, blue = (round(float(np.interp(step, RESERVES, channel))) for channel in channels)
    return red, green, blue


LONGEST_ARROW = 0.25  # length of the arrow relative to the longest arm


class ArrowScale(NamedTuple):
    """The scale of arrows.

    Attributes:
        force: length per force [m/N].
        moment: length per moment [m/(N m)].
    """

    force: float
    moment: float


def common_scale(playbacks: Sequence[Playback]) -> ArrowScale:
    """Return the smallest of the scales of several playbacks."""
    scales = [arrow_scale(playback) for playback in playbacks]
    return ArrowScale(min(scale.force for scale in scales), min(scale.moment for scale in scales))


def arrow_scale(playback: Playback) -> ArrowScale:
    """Return the scales at which the largest wrench of a playback is an arrow of suitable length, rounded to 1, 2 or 5.

    A moment is about as long as a force that causes it at the distance of the contacts from their centre.
    """
    size = chain_length(playback.chain)
    held = [contacts_on(playback.chain, name) for name in playback.chain.free_objects]
    lever = max(map(length_scale, held), default=length_scale([]))
    commanded = np.zeros((0, 3)) if playback.commanded is None else playback.commanded[..., 3:]
    largest = max(
        float(np.linalg.norm(playback.wrench[..., 3:], axis=-1).max(initial=0.0)),
        float(np.linalg.norm(commanded, axis=-1).max(initial=0.0)),
        0.0 if playback.touch_force is None else float(np.linalg.norm(playback.touch_force, axis=-1).max(initial=0.0)),
        float(np.linalg.norm(playback.wrench[..., :3], axis=-1).max(initial=0.0)) / lever,
    )
    force = one_two_five(LONGEST_ARROW * size / largest) if largest > 0 else 1.0
    return ArrowScale(force, one_two_five(force / lever))


def one_two_five(x: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above x > 0."""
    power = 10.0 ** np.floor(np.log10(x) + 1e-9)
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step <= x / power + 1e-9))
