"""The controller of a scene, from its data."""

from __future__ import annotations

import numpy as np

from holdfast.control.controller import Controller
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.io.place import Place
from holdfast.model.closed_chain import ClosedChain
from holdfast.scenario.scene import GravityCompensationData, ObjectTrackingData, TorqueScheduleData
from holdfast.state import State

GAINS = ("squeeze", "joint_damping", "stiffness", "damping")
MOST_COEFFICIENTS = 20  # of a polynomial; powers of higher order are noise


def build_controller(
    data: GravityCompensationData | ObjectTrackingData | TorqueScheduleData,
    chain: ClosedChain,
    state: State,
    at: Place,
) -> Controller:
    """Return the controller; a path begins at the initial state's object pose.

    Raises:
        SceneError: a negative gain, an impossible path or schedule, or no grasp to move the object by.
    """
    if isinstance(data, TorqueScheduleData):
        return _schedule(data, chain, state, at)
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


def _schedule(data: TorqueScheduleData, chain: ClosedChain, state: State, at: Place) -> TorqueSchedule:
    names, tables = chain.joint_names(), []
    for i, piece in enumerate(data.pieces):
        here = at / "pieces" / i / "torques"
        if len(piece.torques) != len(names):
            listed = f"{names[0]} .. {names[-1]}"
            raise here.refuse(f"expected one list for each of {len(names)} joints ({listed}), got {len(piece.torques)}")
        for k, row in enumerate(piece.torques):
            if not row:
                raise (here / k).refuse("expected at least one coefficient, got none")
            if len(row) > MOST_COEFFICIENTS:
                raise (here / k).refuse(f"expected at most {MOST_COEFFICIENTS} coefficients, got {len(row)}")
        width = max(map(len, piece.torques))
        tables.append(np.array([row + [0.0] * (width - len(row)) for row in piece.torques]))
    beside = None if data.beside is None else build_controller(data.beside, chain, state, at / "beside")
    with (at / "pieces").refusals():
        return TorqueSchedule(np.array([piece.begin for piece in data.pieces]), tables, beside)
