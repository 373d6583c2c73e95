"""The fastest timing of a path of the object and of the joints: `time_path`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.control.paths import ObjectPath, Target, path_function
from holdfast.dynamics.closing import close
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.forces.acceleration_map import ObjectTask, acceleration_map, motion_without_torques
from holdfast.forces.limits import ForceLimits
from holdfast.forces.path_timing import INSIDE, PathPoint, fastest_timing, path_point
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_fit, shaped_inputs

STANDING = 1e-6  # of the path's mean speed, below which it stands
EVEN = 1e-6  # relative difference of torques at opposite velocities from which on there are dampers
MOST_NODES = 10_000

Joints = tuple[Array, Array, Array]


@called
@dataclass(frozen=True, eq=False)
class TimedPath(Frozen):
    """A path with its fastest timing, from rest to rest, from `time_path`.

    Between two nodes s'' is constant.

    Attributes:
        chain: the chain.
        path: the object's target as a function of s.
        joints: joint positions and their first two derivatives as a function of s, (n,) each.
        s: (m,) nodes.
        t: (m,) times at the nodes, from 0 [s].
        rate: (m,) s' at the nodes [1/s].
        fastest: (m,) largest s' from which the path can be continued to rest [1/s].
        limited_by: of each of the m - 1 intervals, the limits that bound its speed, by name, with their shares.
        room: (m - 1, 3) force by which all limits on forces could still be tightened at places between the nodes [N].
    """

    chain: ClosedChain
    path: Callable[[float], Target]
    joints: Callable[[float], Joints]
    s: ArrayField
    t: ArrayField
    rate: ArrayField
    fastest: ArrayField
    limited_by: tuple[Mapping[str, float], ...]
    room: ArrayField

    @property
    def duration(self) -> float:
        """The time that the path takes [s]."""
        return float(self.t[-1])

    @property
    def violation(self) -> float:
        """Largest force by which limits are passed between nodes [N], at most 1e-3 N."""
        return max(0.0, -float(self.room.min()))

    def at(self, t: float) -> Target:
        """Return the object's target at time t [s]; it rests before and after the path.

        Raises:
            ModelError: no finite number.
        """
        s, rate, second = self.parameter(t)
        place = self.path(s)
        return Target(place.pose, rate * place.twist, rate**2 * place.acceleration + second * place.twist)

    def joints_at(self, t: float) -> Joints:
        """Return the joints' positions, rates and accelerations at time t [s], (n,) each.

        Raises:
            ModelError: no finite number.
        """
        s, rate, second = self.parameter(t)
        q, slope, curve = self.joints(s)
        return q, rate * slope, rate**2 * curve + second * slope

    def state_at(self, t: float) -> State:
        """Return the closed state at time t [s], with the object on its path.

        Raises:
            ModelError: no finite number.
        """
        (q, qd, _), place = self.joints_at(t), self.at(t)
        return _closed(self.chain, q, qd, place)

    def parameter(self, t: float) -> tuple[float, float, float]:
        """Return s, s' and s'' at time t [s].

        Raises:
            ModelError: no finite number.
        """
        t = checks.number(t, "timed path: t")
        inside = float(np.clip(t, 0.0, self.t[-1]))
        i = min(max(int(np.searchsorted(self.t, inside, side="right")) - 1, 0), len(self.t) - 2)
        after, span = inside - self.t[i], self.t[i + 1] - self.t[i]
        second = float(self.rate[i + 1] - self.rate[i]) / span
        s = float(self.s[i] + after * (self.rate[i] + 0.5 * second * after))
        if inside != t:
            return s, 0.0, 0.0
        return s, float(self.rate[i] + second * after), second

    def __repr__(self) -> str:
        """Return the duration and the number of nodes, on one line."""
        return f"<TimedPath: {self.duration:.4g} s, {len(self.s)} nodes>"


@np.errstate(all="ignore")  # what overflows is refused
def time_path(
    chain: ClosedChain,
    joints: State | Callable[[float], Any] | Any,
    path: Callable[[float], Target] | ObjectPath,
    limits: ForceLimits | None = None,
    *,
    span: tuple[float, float] = (0.0, 1.0),
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
        span: first and last s.
        nodes: number of nodes.

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
    places = _places(span, nodes)
    at = path_function(path, "time_path: path")
    targets = [at(float(s)) for s in places]
    for target in targets:
        checks.instance(target, Target, "time_path: path: what it returns")
    along = _continued(chain, joints, places, targets) if isinstance(joints, State) else _function(chain, joints)
    found = [along(float(s)) for s in places]
    _require_moving(places, targets, found)
    states = [_closed(chain, q, slope, target) for (q, slope, _), target in zip(found, targets, strict=True)]
    _require_even(chain, states[len(states) // 2])
    points = [
        _point(chain, float(s), state, curve, target.acceleration, limits)
        for s, state, (_, _, curve), target in zip(places, states, found, targets, strict=True)
    ]
    width = float(places[-1] - places[0]) / (nodes - 1)
    timing = fastest_timing(points, width)
    rate, knots = np.sqrt(timing.b), places[:: INSIDE + 1]
    t = np.concatenate([[0.0], np.cumsum(2.0 * width / (rate[1:] + rate[:-1]))])
    checks.finite(t, "time_path")
    return TimedPath(
        chain, at, along, knots, t, rate, np.sqrt(timing.top), tuple(timing.limited_by), timing.room
    )


def _timeless(limits: ForceLimits | None) -> ForceLimits:
    """Return the limits, checked not to depend on samples in time."""
    checks.instance(limits, (ForceLimits, type(None)), "time_path: limits")
    limits = ForceLimits() if limits is None else limits
    for name in ("sample_time", "last_wrench"):
        if getattr(limits, name) is not None:
            raise ModelError(f"time_path: limits: {name}: expected none, since the path has no samples in time yet")
    return limits


def _places(span: Any, nodes: Any) -> Array:
    """Return the places of the nodes and those between them."""
    begin, end = checks.numbers(span, (2,), "time_path: span").tolist()
    if not begin < end:
        raise ModelError(f"time_path: span: expected first < last, got {begin:g} and {end:g}")
    if not isinstance(nodes, int) or isinstance(nodes, bool) or not 4 <= nodes <= MOST_NODES:
        raise ModelError(f"time_path: nodes: expected a whole number from 4 to {MOST_NODES}, got {checks.short(nodes)}")
    return np.linspace(begin, end, (INSIDE + 1) * (nodes - 1) + 1)


def _function(chain: ClosedChain, joints: Any) -> Callable[[float], Joints]:
    """Return a joint path as a function that returns checked arrays."""
    given = path_function(joints, "time_path: joints")

    def at(s: float) -> Joints:
        found = given(s)
        if not isinstance(found, tuple) or len(found) != 3:
            raise ModelError(
                f"time_path: joints: expected a tuple of q and its first two derivatives, got {checks.short(found)}"
            )
        q, slope, curve = (checks.numbers(x, (chain.joint_count,), "time_path: joints", StateError) for x in found)
        return q, slope, curve

    return at


def _continued(
    chain: ClosedChain, start: State, places: Array, targets: list[Target]
) -> Callable[[float], Joints]:
    """Return the joint path through the closed states nearest to each other."""
    from scipy.interpolate import make_interp_spline  # imported here because it takes half a second

    require_fit(chain, start)
    q, found = start.q, []
    for target in targets:
        q = _closed(chain, q, np.zeros_like(q), target).q
        found.append(q)
    whole = make_interp_spline(places, np.array(found), k=5)
    slope, curve = whole.derivative(), whole.derivative(2)
    return lambda s: (whole(s), slope(s), curve(s))


def _closed(chain: ClosedChain, q: Array, qd: Array, target: Target) -> State:
    """Return the closed state nearest to joint positions and rates, with the object on its path."""
    guess = State(q, qd, target.pose.wxyz_xyz, target.twist)
    return close(chain, guess, hold_object=True, hold_trunk=False)


def _require_moving(places: Array, targets: list[Target], found: list[Joints]) -> None:
    """Refuse a path that stands somewhere, where all speeds would be equal."""
    speeds = np.array(
        [np.linalg.norm([*target.twist, *slope]) for target, (_, slope, _) in zip(targets, found, strict=True)]
    )
    k = int(np.argmin(speeds))
    if not speeds[k] > STANDING * speeds.mean():
        raise ModelError(
            f"time_path: path: expected one that moves everywhere, got one that stands at s = {places[k]:g}; give the"
            " same line with a constant speed: the timing begins and ends at rest by itself"
        )


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


def _point(
    chain: ClosedChain, s: float, state: State, curve: Array, acceleration: Array, limits: ForceLimits
) -> PathPoint:
    """Return the limits at a place; an error names the place."""
    try:
        return path_point(chain, s, state, curve, acceleration, limits)
    except StateError as error:
        raise StateError(f"time_path: at s = {s:g}: {error}") from error
