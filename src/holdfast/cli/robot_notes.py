"""What a scene's robot files say that was read in another way than it stands, or not at all."""

from __future__ import annotations

from holdfast.cli import say
from holdfast.scenario.build import Scenario


def tell_notes(scenario: Scenario) -> None:
    """Say on stderr what was read in another way than it stands in robot files, each thing once."""
    notes = [note for robot in scenario.robots.values() if robot.links is not None for note in robot.links.notes]
    for note in dict.fromkeys(notes):
        say(f"note: {note}")
