"""From every view the whole chain is in the picture."""

import numpy as np
import pytest

from holdfast.view.cameras import arms_outline, cameras, object_outline, upward
from holdfast.view.playback import playback_of_run
from holdfast.view.scene_writer import FIELD_OF_VIEW
from tests.view.runs import lifted


def test_everything_is_in_the_picture():
    """Arms, object and contacts lie within the field of view of a square picture, and fill it."""
    chain, run = lifted()
    playback = playback_of_run(chain, run, "lifted")
    up = upward(chain)
    views = cameras(playback)
    assert [view.name for view in views] == ["overview", "front", "side", "top", "object"]
    moments = range(len(playback))
    box = np.concatenate([object_outline(playback, k) for k in moments])
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
    chain, run = lifted()
    _, front, *_ = cameras(playback_of_run(chain, run, "lifted"))
    bases = [arm.base.p for arm in chain.arms.values()]
    assert (front.position - front.target) @ (bases[1] - bases[0]) == pytest.approx(0.0, abs=1e-9)
