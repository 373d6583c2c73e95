"""Building poses from a scene's data."""

from __future__ import annotations

import numpy as np

from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.scenario.scene import PoseTable
from holdfast.spatial.pose import Pose


def pose(data: PoseTable, at: Location) -> Pose:
    """Return a pose; without an attitude its axes are parallel to the reference frame's."""
    if data.quaternion is not None and data.rpy is not None:
        raise at.refuse("expected quaternion or rpy, got both")
    if data.quaternion is None:
        with at.refusals():
            return Pose.from_rpy(*(data.rpy or (0.0, 0.0, 0.0)), xyz=data.position)
    with (at / "quaternion").refusals():
        return checks.pose(np.array([*data.quaternion, *data.position]), "pose")
