"""From every view the whole chain is in the picture."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Pose, Spring
from holdfast.view.cameras import arms_outline, cameras, objects_outline, upward
from holdfast.view.playback import spring_ends
from holdfast.view.scene_writer import FIELD_OF_VIEW
from tests.view.runs import off_axis, played


def test_everything_is_in_the_picture():
    """Arms, object and contacts lie within the field of view of a square picture, and fill it."""
    playback = played()
    up = upward(playback.chain)
    views = cameras(playback)
    assert [view.name for view in views] == ["overview", "front", "side", "top", "object"]
    moments = range(len(playback))
    box = np.concatenate([objects_outline(playback, k) for k in moments])
    whole = np.concatenate([box, *(arms_outline(playback, k) for k in moments)])
    for view in views:
        ahead = (view.target - view.position) / np.linalg.norm(view.target - view.position)
        right = np.cross(ahead, up) / np.linalg.norm(np.cross(ahead, up))
        seen = (box if view.name == "object" else whole) - view.position
        tangents = [np.abs(seen @ across / (seen @ ahead)).max() for across in (right, np.cross(right, ahead))]
        # and not lost in it
        assert 0.8 < max(tangents) / np.tan(FIELD_OF_VIEW / 2) < 1.0, view.name


def test_front_is_across_the_bases():
    """Seen from the front, the arms stand side by side."""
    _, front, *_ = cameras(played())
    bases = [arm.base.p for arm in played().chain.arms.values()]
    assert (front.position - front.target) @ (bases[1] - bases[0]) == pytest.approx(0.0, abs=1e-9)


def test_springs_are_in_the_picture():
    """An end in the world, far above the arms, is seen; its other end goes with the object."""
    hung = replace(played().chain, springs=(Spring(("world", [0.0, 0.0, 2.5]), ("object", [0.0, 0.0, 0.1]), 60.0),))
    playback = replace(played(), chain=hung)
    for k in (0, len(playback) - 1):
        ((above, at_object),) = spring_ends(playback, k)
        assert above == pytest.approx([0.0, 0.0, 2.5])
        pose = Pose.from_wxyz_xyz(playback.object_pose[k])
        assert at_object == pytest.approx(pose.p + pose.R @ [0.0, 0.0, 0.1], abs=1e-12)
    for view in cameras(playback)[:-1]:
        assert off_axis(view, np.array([[0.0, 0.0, 2.5]])) < np.sqrt(2) * np.tan(FIELD_OF_VIEW / 2), view.name
