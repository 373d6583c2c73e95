"""How long arrows are drawn."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.split import length_scale
from holdfast.robots.looks import arm_length
from holdfast.view.film import Film

LONGEST = 0.25  # arrow, over the longest arm


class ArrowScale(NamedTuple):
    """How long arrows are.

    Attributes:
        force: [m per N].
        moment: [m per N m].
    """

    force: float
    moment: float


def arrow_scale(film: Film) -> ArrowScale:
    """Return the scale that makes the film's largest wrench a handy arrow, rounded to 1, 2 or 5.

    A moment is as long as the force that makes it at the contacts' distance from their middle.
    """
    size = max(arm_length(arm) for arm in film.chain.arms.values())
    lever = length_scale([grasp.frame.p for grasp in film.chain.grasps.values()])
    largest = max(
        float(np.linalg.norm(film.wrench[..., 3:], axis=-1).max(initial=0.0)),
        float(np.linalg.norm(film.wrench[..., :3], axis=-1).max(initial=0.0)) / lever,
    )
    force = one_two_five(LONGEST * size / largest) if largest > 0 else 1.0
    return ArrowScale(force, force / lever)


def one_two_five(x: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above x > 0."""
    power = 10.0 ** np.floor(np.log10(x) + 1e-9)
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step <= x / power + 1e-9))
