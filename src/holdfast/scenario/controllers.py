"""The controller of a scene, from its data."""

from __future__ import annotations

import numpy as np

from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.io.place import Place
from holdfast.model.closed_chain import ClosedChain
from holdfast.scenario.scene import GravityCompensationData, ObjectTrackingData
from holdfast.simulation.instant import Controller
from holdfast.state import State

GAINS = ("squeeze", "joint_damping", "stiffness", "damping")


def build_controller(
    data: GravityCompensationData | ObjectTrackingData, chain: ClosedChain, state: State, at: Place
) -> Controller:
    """Return the controller; a path begins at the initial state's object pose.

    Raises:
        SceneError: a negative gain, an impossible path, or no grasp to move the object by.
    """
    for key in GAINS:
        if getattr(data, key, 0.0) < 0:
            raise (at / key).refuse(f"expected >= 0, got {getattr(data, key):g}")
    if isinstance(data, GravityCompensationData):
        return GravityCompensation(chain, data.squeeze, data.joint_damping)
    if not chain.grasps:
        raise (at / "type").refuse("object_tracking needs a grasp, but no arm has one; try gravity_compensation")
    way = data.path
    with (at / "path").refusals():
        path = RestToRest(state.object_frame, np.array(way.displacement), np.array(way.turn), way.begin, way.duration)
    return ObjectTracking(chain, path.at, data.squeeze, data.stiffness, data.damping, data.joint_damping)
