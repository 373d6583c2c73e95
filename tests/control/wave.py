"""A path with a wave across it, in which speed limits bind and cease to bind many times."""

from __future__ import annotations

import numpy as np

import holdfast as hf
from holdfast.control.paths import Target
from holdfast.spatial import rotation


class Wave:
    """A straight way with waves across it, while the object rocks about a line through its centre."""

    def __init__(self, start: hf.Pose, way, across, turn: float = 0.2, count: float = 2.0) -> None:
        self.start, self.way, self.across = start, np.array(way), np.array(across)
        self.turn, self.rate = turn * np.eye(3)[0], 2.0 * np.pi * count

    def at(self, s: float) -> Target:
        """Return the target at s from 0 to 1."""
        w, sin, cos = self.rate, np.sin(self.rate * s), np.cos(self.rate * s)
        p, v = self.way * s + self.across * (1.0 - cos), self.way + w * self.across * sin
        pose = hf.Pose(rotation.exp(self.turn * sin) @ self.start.R, self.start.p + p)
        return Target(pose, np.r_[w * cos * self.turn, v], w * w * np.r_[-sin * self.turn, cos * self.across])
