"""The fastest timing of a path of the object and of the joints: `time_path`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.control.path_by_share import PathByShare, closed_along, path_by_share
from holdfast.control.paths import Joints, ObjectPath, Target, path_function
from holdfast.control.piecewise import row_at
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.forces.acceleration_map import ObjectTask, acceleration_map, motion_without_torques
from holdfast.forces.limits import ForceLimits
from holdfast.forces.path_timing import PathPoint, fastest_timing, path_point
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, Frozen, frozen, frozen_property
from holdfast.spatial.scalar import Array, Scalar, minimum, where
from holdfast.state import State, shaped_inputs

EVEN = 1e-6  # relative difference of torques at opposite velocities from which on there are dampers
CONSISTENT = 1e-3  # largest relative difference between the rates of a joint path and those its grasps demand
MOST_TIMED_NODES = 10_000
SAMPLES_PER_NODE = 4  # of the joint path per node


@called
@dataclass(frozen=True, eq=False)
class TimedPath(Frozen):
    """A path with its fastest timing, from rest to rest, from `time_path`.

    Between two nodes u'' is constant, where u is the share of the path.

    Attributes:
        chain: the chain.
        route: the path of object and joints by u.
        u: (m,) nodes, from 0 to 1.
        t: (m,) times at the nodes, from 0 [s].
        rate: (m,) u' at the nodes [1/s].
        fastest: (m,) largest u' from which the path can be continued to rest [1/s].
        limited_by: of each of the m - 1 intervals, the limits that bound its speed, by name, with their shares.
        room: (m - 1,) force by which all limits on forces could still be tightened throughout each interval, with
            other internal forces [N]; at least -1e-3 N.
    """

    chain: ClosedChain
    route: PathByShare
    u: ArrayField
    t: ArrayField
    rate: ArrayField
    fastest: ArrayField
    limited_by: tuple[Mapping[str, float], ...]
    room: ArrayField

    def __post_init__(self) -> None:
        for name in ("u", "t", "rate", "fastest", "room"):
            object.__setattr__(self, name, checks.read_only(getattr(self, name)))

    @property
    def duration(self) -> float:
        """The time that the path takes [s]."""
        return float(self.t[-1])

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The nodes' times, at which accelerations jump [s]."""
        return tuple(self.t.tolist())

    def at(self, t: Scalar) -> Target:
        """Return the object's target at time t [s]; it rests before and after the path.

        Raises:
            ModelError: no finite number.
        """
        u, rate, second = self.share_at(t)
        place = self.route.object_at(u)
        return Target(place.pose, rate * place.twist, rate**2 * place.acceleration + second * place.twist)

    def joints_at(self, t: Scalar) -> Joints:
        """Return the joints' positions, rates and accelerations at time t [s], (n,) each.

        Raises:
            ModelError: no finite number.
        """
        u, rate, second = self.share_at(t)
        q, slope, curve = self.route.joints_at(u)
        return q, rate * slope, rate**2 * curve + second * slope

    def state_at(self, t: float) -> State:
        """Return the closed state at time t [s], with the object on its path.

        Raises:
            ModelError: no finite number.
        """
        q, qd, _ = self.joints_at(t)
        return closed_along(self.chain, q, qd, self.at(t))

    def share_at(self, t: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Return u, u' and u'' at time t [s].

        Raises:
            ModelError: no finite number.
        """
        t = checks.number(t, "timed path: t")
        begin, u, rate, second = row_at(t, self.t[:-1], self._rows)
        after, moves = t - begin, where(t < 0.0, 0.0, where(t <= self.duration, 1.0, 0.0))
        u = where(t < self.duration, minimum(u + after * (rate + 0.5 * second * after), 1.0), 1.0)
        return where(t > 0.0, u, 0.0), moves * (rate + second * after), moves * second

    @frozen_property
    def _rows(self) -> Array:
        """Time, u, u' and u'' at the beginning of each interval, (m - 1, 4)."""
        return np.column_stack([self.t[:-1], self.u[:-1], self.rate[:-1], np.diff(self.rate) / np.diff(self.t)])

    def __repr__(self) -> str:
        """Return the duration and the number of nodes, on one line."""
        return f"<TimedPath: {self.duration:.4g} s, {len(self.u)} nodes>"


@np.errstate(all="ignore")  # what overflows is refused
def time_path(
    chain: ClosedChain,
    joints: State | Callable[[float], Any] | Any,
    path: Callable[[float], Target] | ObjectPath,
    limits: ForceLimits | None = None,
    *,
    span: tuple[float, float] | None = None,
    nodes: int = 100,
) -> TimedPath:
    """Return the fastest timing of a given path, from rest to rest, within limits on torques, rates and grasps.

    All torques and wrenches are affine in the squared speed s'^2, the acceleration s'' and the internal forces, which
    are chosen freely at every place. A backward and a forward pass over the nodes find the largest speeds, by two cone
    programmes per node. The limits hold at the nodes, and between them up to 1e-3 N; the time exceeds the least
    possible by about 1 % at 40 nodes, half of it at twice as many.

    Args:
        chain: the chain.
        joints: joint positions along the path: a function of s, or an object with such a method `at`, that returns q
            and its first two derivatives by s, (n,) each; or the closed state at its beginning, from which the joints
            then follow by the smallest steps.
        path: function of s that returns the object's target at s' = 1, s'' = 0, or a path object; it must not stand.
        limits: the limits; rates are those of the joints.
        span: first and last s; None for the times between which a `RestToRest` or a `PoseSpline` moves, else 0 to 1.
        nodes: number of nodes; intervals in which limits bend much are halved.

    Raises:
        StateError: the object cannot be held somewhere on the path; the message names the limits that conflict. Or no
            limit bounds the speed.
        ModelError: no path, the path stands somewhere, or a limit depends on time.
        ClosureError: the arms cannot reach the path.
        MethodNotApplicable: the chain has no grasp, a floating base, or dampers.

    Reference:
        H. Pham, Q.-C. Pham, A new approach to time-optimal path parameterization based on reachability analysis, IEEE
        Transactions on Robotics, 2018.
    """
    checks.instance(chain, ClosedChain, "time_path: chain")
    limits = _timeless(limits)
    if not chain.grasps or chain.floats:
        what = "a floating base, whose motion depends on forces" if chain.floats else "no grasp"
        raise MethodNotApplicable(f"time_path: the chain has {what}; try a base in the world, or a grasp")
    first, length = _span(getattr(path, "span", (0.0, 1.0)) if span is None else span)
    if not isinstance(nodes, int) or isinstance(nodes, bool) or not 4 <= nodes <= MOST_TIMED_NODES:
        raise ModelError(
            f"time_path: nodes: expected a whole number from 4 to {MOST_TIMED_NODES}, got {checks.short(nodes)}"
        )
    samples = first + length * np.linspace(0.0, 1.0, SAMPLES_PER_NODE * (nodes - 1) + 1)
    route = path_by_share(chain, joints, path_function(path, "time_path: path"), samples)
    _require_even(chain, _state(chain, route, 0.5))
    timing = fastest_timing(lambda share: point_on_path(chain, route, share, limits), np.linspace(0.0, 1.0, nodes))
    rate = np.sqrt(timing.b)
    t = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(timing.u) / (rate[1:] + rate[:-1]))])
    checks.finite(t, "time_path")
    limited_by, fastest = tuple(frozen(each) for each in timing.limited_by), np.sqrt(timing.top)
    return TimedPath(chain, route, timing.u, t, rate, fastest, limited_by, timing.room)


def _timeless(limits: ForceLimits | None) -> ForceLimits:
    """Return the limits, checked not to depend on samples in time."""
    checks.instance(limits, (ForceLimits, type(None)), "time_path: limits")
    limits = ForceLimits() if limits is None else limits
    for name in ("sample_time", "last_wrench"):
        if getattr(limits, name) is not None:
            raise ModelError(f"time_path: limits: {name}: expected none, since the path has no samples in time yet")
    return limits


def _span(span: Any) -> tuple[float, float]:
    """Return the first s and the length of a span."""
    first, last = checks.numbers(span, (2,), "time_path: span").tolist()
    if not first < last:
        raise ModelError(f"time_path: span: expected first < last, got {first:g} and {last:g}")
    return first, last - first


def _require_even(chain: ClosedChain, state: State) -> None:
    """Refuse torques that are not even in the velocities."""
    opposite = State(state.q, -state.qd, state.object_pose, -state.object_twist)
    there, back = (
        acceleration_map(
            motion_without_torques(chain, one, shaped_inputs(chain, None)), ObjectTask(np.eye(6), np.zeros(6))
        )
        for one in (state, opposite)
    )
    odd = max(np.abs(there.t - back.t).max(initial=0.0), np.abs(there.v0 - back.v0).max(initial=0.0))
    if odd > EVEN * max(1.0, np.abs(there.t).max(initial=0.0), np.abs(there.v0).max(initial=0.0)):
        named = [n for n, j in zip(chain.joint_names(), chain.all_joints, strict=True) if j.damping]
        of = f" (joints {', '.join(named)})" if named else ""
        raise MethodNotApplicable(
            f"time_path: the chain has dampers{of}, whose torques grow with the speed; try damping 0"
        )


def _state(chain: ClosedChain, route: PathByShare, u: float) -> State:
    """Return the closed state at a share of the path with u' = 1.

    Raises:
        StateError: the rates of the joint path are not those of its grasps.
    """
    q, slope, _ = route.joints_at(u)
    state = closed_along(chain, q, slope, route.object_at(u))
    if not np.abs(state.qd - slope).max() <= CONSISTENT * np.abs(state.qd).max():
        j = int(np.argmax(np.abs(state.qd - slope)))
        raise StateError(
            f"time_path: joints: at s = {route.place(u)[0]:g} the grasps demand other rates than the joint path has:"
            f" {state.qd[j]:.4g} of {chain.joint_names()[j]}, got {slope[j]:.4g}; try the state at the beginning"
            " instead of joints"
        )
    return state


def point_on_path(chain: ClosedChain, route: PathByShare, u: float, limits: ForceLimits) -> PathPoint:
    """Return the limits at a share of the path; an error names the place."""
    curve, acceleration = route.joints_at(u)[2], route.object_at(u).acceleration
    s = route.place(u)[0]
    try:
        return path_point(chain, u, s, _state(chain, route, u), curve, acceleration, limits)
    except StateError as error:
        raise StateError(f"time_path: at s = {s:g}: {error}") from error
