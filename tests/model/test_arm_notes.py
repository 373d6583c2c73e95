"""The notes of arms and trunks: a list of strings, without influence on results."""

from dataclasses import replace

import pytest

import holdfast as hf
from holdfast.model.fingerprint import fingerprint


@pytest.mark.parametrize("notes", [3, "text", ["a", 3], None])
def test_no_notes(notes):
    """Anything but a list of strings is refused."""
    arm = hf.robots.panda()
    with pytest.raises(hf.ModelError, match="arm 'panda': notes: expected a list of strings"):
        replace(arm, notes=notes)
    with pytest.raises(hf.ModelError, match="trunk: notes: expected a list of strings"):
        hf.Trunk(arm.joints, arm.links, notes=notes)


def test_same_model():
    """An arm with notes gives the same runs as one without, and keeps them with another tip or base."""
    arm = hf.robots.panda()
    noted = replace(arm, notes=["a note"])
    assert fingerprint(noted) == fingerprint(arm)
    assert noted.with_tip(hf.Pose.identity()).at(hf.Pose.identity()).notes == ("a note",)
