"""The fastest timing of a path of the object and of the joints: `time_path`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from holdfast import outer
from holdfast.control.path_by_share import PathByShare, closed_along, path_by_share
from holdfast.control.paths import Joints, ObjectPath, Target, path_function
from holdfast.control.piecewise import row_at
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.forces.acceleration_map import acceleration_map
from holdfast.forces.affine_map import AccelerationTask
from holdfast.forces.limits import ForceLimits
from holdfast.forces.path_interval import durations
from holdfast.forces.path_point import PathPoint, is_damped, motion_at, path_point
from holdfast.forces.path_timing import fastest_timing
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, Frozen, frozen, frozen_property
from holdfast.spatial.scalar import Array, Scalar, clip, minimum, where
from holdfast.state import State

QUADRATIC = 1e-6  # relative difference of torques from a quadratic function of the speed
CONSISTENT = 1e-3  # largest relative difference between the rates of a joint path and those its grasps demand
SERIES_TERMS = 14  # of series
MOST_TIMED_NODES = 10_000
SAMPLES_PER_NODE = 4  # of the joint path per node


@called
@dataclass(frozen=True, eq=False)
class TimedPath(Frozen):
    """A path with its fastest timing, from rest to rest, from `time_path`.

    Between two nodes u'' is linear in u, the share of the path.

    Attributes:
        chain: the chain.
        route: the path of object and joints by u.
        u: (m,) nodes, from 0 to 1.
        t: (m,) times at the nodes, from 0 [s].
        rate: (m,) u' at the nodes [1/s].
        second: (m - 1, 2) u'' at the beginning and at the end of each interval [1/s^2].
        fastest: (m,) largest u' from which the path can be continued to rest [1/s].
        maximum: (m,) largest u' within the limits at each node by itself, without dampers, whatever follows: the
            maximum velocity curve [1/s].
        limited_by: of each of the m - 1 intervals, the limits that bound its speed, by name, with their shares.
        room: (m - 1,) force by which all limits on forces could still be tightened throughout each interval, at least,
            with the same motion [N]; not below -1e-3 N.
    """

    chain: ClosedChain
    route: PathByShare
    u: ArrayField
    t: ArrayField
    rate: ArrayField
    second: ArrayField
    fastest: ArrayField
    maximum: ArrayField
    limited_by: tuple[Mapping[str, float], ...]
    room: ArrayField

    def __post_init__(self) -> None:
        for name in ("u", "t", "rate", "second", "fastest", "maximum", "room"):
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
        begin, first, rate, second, growth = row_at(t, self.t[:-1], self._rows)
        after, moves = t - begin, where(t < 0.0, 0.0, where(t < self.duration, 1.0, 0.0))
        after = clip(after, 0.0, self.duration)
        sine, versine = _integrals(growth, after)
        way = rate * sine + second * versine
        u = where(t < self.duration, minimum(first + way, 1.0), 1.0)
        speed = rate + second * sine + growth * rate * versine
        return where(t > 0.0, u, 0.0), moves * speed, moves * (second + growth * way)

    @frozen_property
    def _rows(self) -> Array:
        """Time, u, u' and u'' at the beginning of each interval, and the change of u'' per u, (m - 1, 5)."""
        growth = np.diff(self.second)[:, 0] / np.diff(self.u)
        return np.column_stack([self.t[:-1], self.u[:-1], self.rate[:-1], self.second[:, 0], growth])

    def plot(self, path: str | PathLike[str] | None = None) -> Any:
        """Return a matplotlib Figure of the speed along the path, what limits it where, and the room that is left.

        Args:
            path: PNG file to write the figure to; None for no file.

        Raises:
            MissingExtra: matplotlib is not installed.
            ResultError: the file cannot be written.
        """
        speeds = {"timing": self.rate, "largest that can still stop": self.fastest, "largest here": self.maximum}
        return outer.plot_timing(self.u, speeds, self.limited_by, self.room, self.duration, path)

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
    nodes: int = 41,
) -> TimedPath:
    """Return the fastest timing of a given path, from rest to rest, within limits on torques, rates and grasps.

    All torques and wrenches are affine in the squared speed s'^2, the acceleration s'' and the internal forces, which
    are chosen freely at every place. A backward and a forward pass over the nodes find the largest speeds, with s''
    linear in between. Where limits bend much, or time is lost, intervals are halved. Limits hold at the nodes, and
    between them up to 1e-3 N; the time exceeds the least possible by less than 1 % (`benchmarks/timed_paths.py`).

    Forces of dampers grow with s', the root of s'^2. They are taken as linear in it next to the speeds of the pass
    before, until these no longer change.

    O(nodes n^3): seconds, since each of three to ten passes solves two cone programmes per node, with the internal
    forces at two nodes as unknowns.

    Args:
        chain: the chain.
        joints: joint positions along the path: a function of s, or an object with such a method `at`, that returns q
            and its first two derivatives by s, (n,) each; or the closed state at its beginning, from which the joints
            then follow by the smallest steps.
        path: function of s that returns the object's target at s' = 1, s'' = 0, or a path object; it must not stand.
        limits: the limits; rates are those of the joints.
        span: first and last s; None for the times between which a `RestToRest` or a `PoseSpline` moves, else 0 to 1.
        nodes: number of nodes to begin with.

    Raises:
        StateError: the object cannot be held somewhere on the path; the message names the limits that conflict. Or no
            limit bounds the speed.
        ModelError: no path, the path stands somewhere, or a limit depends on time.
        ClosureError: the arms cannot reach the path.
        MethodNotApplicable: the chain has no grasp, a floating base, or force elements that are not quadratic in the
            speed.

    Reference:
        H. Pham, Q.-C. Pham, A new approach to time-optimal path parameterization based on reachability analysis, IEEE
        Transactions on Robotics, 2018.
    """
    serial_chain(chain, "time_path: chain")
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
    damped = is_damped(chain)
    if damped:
        _require_quadratic(chain, _state(chain, route, 0.5))
    even = np.linspace(0.0, 1.0, nodes)
    timing = fastest_timing(lambda share: point_on_path(chain, route, share, limits), even, damped)
    rate, widths = np.sqrt(timing.b), np.diff(timing.u)
    t = np.concatenate([[0.0], np.cumsum(durations(widths, rate[:-1] + rate[1:], np.diff(timing.a)[:, 0]))])
    checks.finite(t, "time_path")
    limited_by = tuple(frozen(each) for each in timing.limited_by)
    fastest, maximum = np.sqrt(timing.top), np.sqrt(timing.most)
    return TimedPath(chain, route, timing.u, t, rate, timing.a, fastest, maximum, limited_by, timing.room)


def _integrals(growth: Scalar, t: Scalar) -> tuple[Scalar, Scalar]:
    """Return sinh(w t) / w and (cosh(w t) - 1) / w^2 with w^2 = growth, which may be negative, by their series.

    |w t| is at most pi where w^2 < 0, and 3.7 else (`path_interval.LEAST_CONTROL`).
    """
    square, sine, versine = growth * t * t, 0.0, 0.0
    for k in range(SERIES_TERMS, -1, -1):
        sine = sine * square + 1.0 / math.factorial(2 * k + 1)
        versine = versine * square + 1.0 / math.factorial(2 * k + 2)
    return t * sine, t * t * versine


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


def _require_quadratic(chain: ClosedChain, state: State) -> None:
    """Refuse forces that are no quadratic function of the speed."""
    still, there, back, fast = (
        acceleration_map(motion_at(chain, state, rate), AccelerationTask(np.eye(6), np.zeros(6)))
        for rate in (0.0, 1.0, -1.0, 2.0)
    )
    for x0, x1, x_1, x2 in ((m.t for m in (still, there, back, fast)), (m.v0 for m in (still, there, back, fast))):
        odd, even = 0.5 * (x1 - x_1), 0.5 * (x1 + x_1) - x0
        off = np.abs(x0 + 2.0 * odd + 4.0 * even - x2).max(initial=0.0)
        if off > QUADRATIC * max(1.0, np.abs(x2).max(initial=0.0)):
            raise MethodNotApplicable(
                "time_path: the chain has force elements whose forces depend on the speed in another way than in"
                " proportion to it or to its square; try without them"
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
