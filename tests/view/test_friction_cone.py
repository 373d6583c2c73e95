"""The cone drawn is the cone meant, and its colour warns in time."""

import numpy as np
import pytest

from holdfast import Pose
from holdfast.spatial import rotation
from holdfast.view.figure_style import DANGER, GREEN, rgb
from holdfast.view.friction_cone import cone_colour, cone_lines

FRAME = Pose(rotation.exp(np.array([0.3, -0.8, 0.5])), np.array([0.2, -0.1, 0.4]))


def test_lines_lie_on_the_cone():
    """Every point is at |tangential| = mu normal, in the contact's axes; spokes begin at the contact."""
    points = (cone_lines(0.6, 0.1, FRAME) - FRAME.p) @ FRAME.R
    tangential, normal = np.linalg.norm(points[..., :2], axis=-1), points[..., 2]
    assert tangential == pytest.approx(0.6 * normal)
    assert normal.max() == pytest.approx(0.1)
    assert (np.linalg.norm(points, axis=-1).min(axis=1) < 1e-15).sum() == 12


def test_colours():
    """Green with half of the hold left and more, vermillion at the edge, no way back in between."""
    assert cone_colour(1.0) == cone_colour(0.5) == rgb(GREEN)
    assert cone_colour(0.0) == cone_colour(0.03) == rgb(DANGER)
    reds = [cone_colour(reserve)[0] for reserve in np.linspace(0.25, 0.5, 9)]
    assert reds == sorted(reds, reverse=True)
