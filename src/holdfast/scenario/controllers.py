"""Building a scene's controller: every table becomes the object of the library that its keys describe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.control.controller import Controller
from holdfast.control.cooperative_law import cooperative_law
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.hybrid_force import HybridForce
from holdfast.control.internal_force import InternalForce
from holdfast.control.internal_impedance import InternalImpedance
from holdfast.control.law_parts import LawPart
from holdfast.control.load_share import LoadShare
from holdfast.control.momentum_observer import observed
from holdfast.control.object_impedance import ObjectImpedance
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import ObjectPath, RestToRest
from holdfast.control.pose_spline import HALF_TURN, PoseSpline
from holdfast.control.posture_control import PostureControl
from holdfast.control.ramped_forces import RampedForces
from holdfast.control.timed_path import TimedPath, time_path
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.forces.elastic_distribution import distribution_parameters
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.io.typed import Location
from holdfast.model.closed_chain import ClosedChain
from holdfast.scenario import controller_tables as tables
from holdfast.scenario.joints import pose
from holdfast.scenario.table import KeyTable
from holdfast.spatial import rotation
from holdfast.state import State

MOST_COEFFICIENTS = 20  # of a polynomial; terms of higher order are lost in rounding


@dataclass(frozen=True, eq=False)
class Controlled:
    """What a controller of a scene controls.

    Attributes:
        chain: the chain.
        state: its initial state, where paths begin.
        sample_time: that of the simulation; None without one [s].
    """

    chain: ClosedChain
    state: State
    sample_time: float | None

    def made(self, data: KeyTable, at: Location) -> Any:
        """Return what a table describes.

        Raises:
            SceneError: a value is impossible, keys exclude each other, or the chain does not support it.
        """
        return MAKERS[type(data)](self, data, at)

    def values(self, data: KeyTable, at: Location, *others: str) -> dict[str, Any]:
        """Return what a table's keys describe by name, without those that are not given and the named others."""
        given = {name: getattr(data, name) for name in data.__struct_fields__ if name not in others}
        return {
            name: self.made(x, at / name) if isinstance(x, KeyTable) else x
            for name, x in given.items()
            if x is not None
        }

    def sampled_with(self, at: Location, why: str) -> float:
        """Return the sample time of a scene that must have one.

        Raises:
            SceneError: it has none.
        """
        if self.sample_time is None:
            raise at.refuse(f"expected a sampled controller, {why}; try simulation.sample_time = 0.001")
        return self.sample_time


def controller(data: tables.ControllerTable | None, controlled: Controlled, at: Location) -> Controller:
    """Return the controller, with zero torques if the scene has none; a path begins at the initial object pose.

    Raises:
        SceneError: as for `Controlled.made`.
    """
    if data is None:
        return TorqueSchedule([0.0], [np.zeros((controlled.chain.joint_count, 1))])
    return controlled.made(data, at)


Make = Callable[[Controlled, Any, Location], Any]


def _of_chain(kind: Callable[..., Controller]) -> Make:
    """Return what makes a controller of a chain, whose gains must not be negative."""

    def make(of: Controlled, data: KeyTable, at: Location) -> Controller:
        for key, x in ((key, getattr(data, key)) for key in data.__struct_fields__):
            if isinstance(x, float | int) and x < 0:
                raise (at / key).refuse(f"expected >= 0, got {x:g}")
        if kind is ObjectTracking and not of.chain.grasps:
            raise (at / "type").refuse("object_tracking needs a grasp, but no arm has one; try gravity_compensation")
        with at.refusals():
            return kind(of.chain, **of.values(data, at))

    return make


def _part(
    kind: Callable[..., LawPart], more: Callable[[Controlled, Location], Mapping[str, Any]] | None = None
) -> Make:
    """Return what makes a part of a law, with the table's keys and more arguments."""

    def make(of: Controlled, data: KeyTable, at: Location) -> LawPart:
        given = {**of.values(data, at), **({} if more is None else more(of, at))}
        with at.refusals():
            part = kind(**given)
            part.require(of.chain)
            return part

    return make


def _measured(of: Controlled, at: Location) -> dict[str, Any]:
    """Return how an integral of forces measures: at samples, on the scene's own chain."""
    return {"sample_time": of.sampled_with(at, "since the error is summed up at samples"), "sensor": of.chain}


def _posture(of: Controlled, data: tables.PostureTable, at: Location) -> PostureControl:
    given = of.values(data, at, "rest")
    rest = of.state.q if data.rest == "start" else None if data.rest == "path" else data.rest
    with at.refusals():
        posture = PostureControl(rest, **given)
        posture.require(of.chain)
        return posture


def _limits(of: Controlled, data: tables.LimitsTable | tables.FastestTable, at: Location) -> ForceLimits:
    given = of.values(data, at, "joint_limits", "nodes")
    if isinstance(data, tables.LimitsTable) and data.joint_limits:
        given["sample_time"] = of.sampled_with(at / "joint_limits", "since joints must be within them at samples")
    with at.refusals():
        limits = ForceLimits(**given)
        distribution_parameters(of.chain, of.state, limits)
        return limits


def _cost(of: Controlled, data: tables.CostTable, at: Location) -> ForceCost:
    with at.refusals():
        cost = ForceCost(**of.values(data, at))
        distribution_parameters(of.chain, of.state, cost=cost)
        return cost


def _cooperative_law(of: Controlled, data: tables.CooperativeLawTable, at: Location) -> Controller:
    if data.motion.inertia is not None and data.observer is None:
        raise (at / "motion" / "inertia").refuse(
            "expected controller.observer beside it, since the push on the object must be known; try observer = { gain"
            " = 50.0 }, or no inertia, for that of the closed chain"
        )
    given = of.values(data, at, "observer")
    if data.posture is not None and data.posture.rest == "path":
        given["posture"] = replace(given["posture"], rest=_joint_path(given["motion"], at / "posture" / "rest"))
    with at.refusals():
        law = cooperative_law(of.chain, **given)
    if data.observer is None:
        return law
    place = at / "observer"
    period = of.sampled_with(place, "since the observer compares samples")
    with place.refusals():
        return observed(law, of.chain, sample_time=period, **of.values(data.observer, place))


def _joint_path(motion: ObjectImpedance, at: Location) -> Callable[[Any], Any]:
    """Return the path of the joints along the object's path."""
    timed = getattr(motion.path, "__self__", None)
    if not isinstance(timed, TimedPath):
        raise at.refuse("expected a path that is timed by `fastest`, whose joints are known, got another; try 'start'")
    return timed.joints_at


def _path(of: Controlled, data: tables.PathTable, at: Location) -> ObjectPath:
    """Return the path of the object, which begins at its initial pose."""
    path = _through(of.state, data, at) if data.through is not None else _rest_to_rest(of.state, data, at)
    if data.fastest is None:
        return path
    if data.begin:
        raise (at / "begin").refuse(f"expected 0, as the fastest timing begins at once, got {data.begin:g}")
    limits = of.made(data.fastest, at / "fastest")
    with (at / "fastest").refusals():
        return time_path(of.chain, of.state, path, limits, nodes=data.fastest.nodes)


def _rest_to_rest(state: State, data: tables.PathTable, at: Location) -> RestToRest:
    if data.duration is None and data.fastest is None:
        raise (at / "duration").refuse("expected a duration, or poses to go through, got neither")
    way, duration = (np.array(data.displacement), np.array(data.turn)), data.duration
    with at.refusals():
        return RestToRest(state.object_frame, *way, data.begin, 1.0 if duration is None else duration)


def _through(state: State, data: tables.PathTable, at: Location) -> PoseSpline:
    through = data.through or []
    for key, given in (
        ("duration", data.duration is not None),
        ("displacement", any(data.displacement)),
        ("turn", any(data.turn)),
    ):
        if given:
            raise (at / key).refuse("expected none, as the path goes through poses, which say where and when")
    if not through:
        raise (at / "through").refuse("expected one pose or more, got none")
    poses = [state.object_frame, *(pose(via, at / "through" / k) for k, via in enumerate(through))]
    for k, via in enumerate(through):
        before = through[k - 1].t if k else data.begin
        if via.t <= before:
            what = "the pose before it" if k else "the begin"
            raise (at / "through" / k / "t").refuse(f"expected a time after {what} at {before:g} s, got {via.t:g}")
        if np.linalg.norm(rotation.log(poses[k].R.T @ poses[k + 1].R)) > HALF_TURN:
            raise (at / "through" / k).refuse(
                "expected less than half a turn from where it was before; try a pose between"
            )
    with (at / "through").refusals():
        return PoseSpline(poses, [data.begin, *(via.t for via in through)])


def _schedule(of: Controlled, data: tables.TorqueScheduleTable, at: Location) -> TorqueSchedule:
    names, pieces = of.chain.joint_names(), []
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
        pieces.append(np.array([row + [0.0] * (width - len(row)) for row in piece.torques]))
    beside = None if data.beside is None else of.made(data.beside, at / "beside")
    with (at / "pieces").refusals():
        return TorqueSchedule(np.array([piece.begin for piece in data.pieces]), pieces, beside)


MAKERS: Mapping[type[KeyTable], Make] = {
    tables.GravityCompensationTable: _of_chain(GravityCompensation),
    tables.ObjectTrackingTable: _of_chain(ObjectTracking),
    tables.CooperativeLawTable: _cooperative_law,
    tables.ObjectImpedanceTable: _part(ObjectImpedance),
    tables.InternalForceTable: _part(InternalForce),
    tables.LoadShareTable: _part(LoadShare),
    tables.RampedForcesTable: _part(RampedForces),
    tables.InternalImpedanceTable: _part(InternalImpedance),
    tables.HybridForceTable: _part(HybridForce, _measured),
    tables.PostureTable: _posture,
    tables.LimitsTable: _limits,
    tables.FastestTable: _limits,
    tables.CostTable: _cost,
    tables.PathTable: _path,
    tables.TorqueScheduleTable: _schedule,
}
