"""Inverse kinematics along a path of the object, with the redundancy resolved over the whole path: `follow`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from holdfast.control.path_by_share import closed_along, held_steadily
from holdfast.control.paths import ObjectPath, Target, path_function
from holdfast.dynamics.closed.chain_motion import chain_at_rest, chain_motion
from holdfast.dynamics.consistency import closure, require_closed
from holdfast.dynamics.constraint import constraint_rows, coordinate_sizes
from holdfast.dynamics.near_singular import arm_strength, chain_strength
from holdfast.dynamics.posture import Posture
from holdfast.dynamics.rank import constraint_pivots
from holdfast.errors import ClosureError, MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.planning.configuration_cost import ConfigurationCost
from holdfast.planning.joint_path import JointPath
from holdfast.planning.whole_path import WEAKEST, Smoothness, WholePath, self_motions
from holdfast.spatial import rotation
from holdfast.spatial.linalg import least_solution
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State, require_fit

AT_START = 1e-6  # m and rad: how far from the path the object may be at the start
MOST_OF_PATH = 100_000
LONGEST_STRIDE = 0.2  # rad, or fraction of the arms' reach, of a joint in one step along the path
PARTS = (1, 2, 4, 8, 16, 32)  # of the step between two samples, tried in turn
PASSED = 1e-9  # rad or m beyond a limit that count
AT_REST = 1e-9  # rad/s and m/s of the object at the end


@np.errstate(all="ignore")  # what overflows is refused
def follow(
    chain: ClosedChain,
    state: State,
    path: Callable[[float], Target] | ObjectPath,
    duration: float,
    step: float,
    *,
    begin: float = 0.0,
    posture: Posture | None = None,
    room: float = 0.1,
    strength: float = 0.1,
    smoothing: float = 0.25,
) -> JointPath:
    """Return a joint path along which the object follows its path, away from joint limits and singular postures.

    Of the motions that the grasps leave to redundant arms and a trunk, it is the one with the least integral of

        posture + sum_limits b(distance / zone) + sum_arms b(strength / zone) + 1/2 smoothing^4 |q''|^2

    over the path, with b(u) = (1 - u)^3 / u inside a zone (u < 1) and 0 outside, and q'' with respect to the share of
    the path that is done, in the units of the posture. It begins with the given state, and is the local minimum that is
    found from there; at every sample the grasps are closed as by `close`. A trunk moves with the arms. Soft fingers do
    not roll, and bushings stay as stretched as they are. Collisions and torques are not looked at. It takes about a
    second per fifty samples of two arms, and longer where joints come near their limits.

    Args:
        chain: the chain.
        state: a closed state, with the object at the beginning of its path.
        path: function of t [s] that returns the object's target, or a path object, whose method `at` is used.
        duration: how long the path is followed [s].
        step: time between samples [s], of which there is a whole number.
        begin: time at which the path begins [s].
        posture: wished joint positions with weights; by default the middle of the ranges, see `Posture`.
        room: width of the zone at each joint limit, relative to the joint's range, below 0.5.
        strength: width of the zone at singular configurations of an arm, as a strength, 0 to 1; 0 for none.
        smoothing: share of the path over which the arms move from one posture to another.

    Raises:
        ModelError: no path, or a number is out of range.
        StateError: the state is not closed, is not at the beginning of the path, or lies beyond a joint limit.
        ClosureError: the path cannot be followed; the message names the arm or the joint and the place on the path.
        MethodNotApplicable: the chain has no grasp, no joint, or a floating base, whose motion depends on forces.
    """
    require_fit(chain, state)
    place_at, times = path_function(path, "follow: path"), _times(duration, step, begin)
    checks.instance(posture, (Posture, type(None)), "follow: posture")
    zones = [checks.number(x, f"follow: {name}", at_least=0.0) for name, x in (("room", room), ("strength", strength))]
    smoothing = checks.number(smoothing, "follow: smoothing", above=0.0)
    if not zones[0] < 0.5 or not zones[1] <= 1.0:
        raise ModelError(f"follow: expected room < 0.5 and strength <= 1, got {zones[0]:g} and {zones[1]:g}")
    if not chain.grasps or not chain.joint_count or chain.floats:
        what = "a floating base, whose motion depends on forces" if chain.floats else "no grasp, or no joint"
        raise MethodNotApplicable(f"follow: the chain has {what}; try a trunk with a base in the world, or an arm")
    places = [_target(place_at, t) for t in times]
    held = held_steadily(chain, state)
    first = _first(chain, held, state, places[0])
    wish = (Posture() if posture is None else posture).cost(held, first)
    cost = ConfigurationCost(held, wish, *zones)
    states = _continued(cost, first, place_at, times, 1 / (smoothing * (len(times) - 1)))
    last = None if np.abs(places[-1].twist).max() > AT_REST else np.zeros(chain.joint_count)
    units = Posture().cost(held, first).stiffness ** -0.5
    smoothness = Smoothness.of(len(times), smoothing, units, duration * first.qd, last)
    states = WholePath(held, cost, smoothness).cheapest(states)
    _require_inside(chain, states, times)
    return _measured(chain, place_at, times, _with_rates(held, states, places, times, first.qd, last))


def _target(path: Callable[[float], Any], t: float) -> Target:
    """Return the checked target of a path at one time.

    Raises:
        ModelError: the path returns something else.
    """
    found = path(float(t))
    if not isinstance(found, Target):
        raise ModelError(f"follow: path: expected a Target from it, got {type(found).__name__}")
    return found


def _times(duration: Any, step: Any, begin: Any) -> Array:
    """Return the times of the samples."""
    duration, step = (
        checks.number(x, f"follow: {name}", above=0.0) for name, x in (("duration", duration), ("step", step))
    )
    share = duration / step
    if not 4 <= round(min(share, 2.0 * MOST_OF_PATH)) <= MOST_OF_PATH or abs(round(share) - share) > 1e-6 * share:
        raise ModelError(
            f"follow: step: expected the duration {duration:g} s divided by a whole number from 4 to {MOST_OF_PATH},"
            f" got {step:g}"
        )
    times = checks.number(begin, "follow: begin") + np.linspace(0.0, duration, round(share) + 1)
    if not (np.diff(times) > 0).all():
        raise ModelError(f"follow: begin: expected a time that does not swallow the step {step:g} s, got {begin:g}")
    return times


def _first(chain: ClosedChain, held: ClosedChain, state: State, place: Target) -> State:
    """Return the state with the object exactly at the beginning of its path, in motion with it.

    Args:
        chain: the chain.
        held: the same with grasps that are held steadily.
        state: the given state.
        place: the beginning of the path.

    Raises:
        StateError: the grasps are open, the object is elsewhere, or a joint is beyond its limits.
    """
    require_closed(chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain)), state)
    turn = np.linalg.norm(rotation.log(place.pose.R @ state.object_frame.R.T))
    shift = np.linalg.norm(place.pose.p - state.object_frame.p)
    if max(turn, shift) > AT_START:
        raise StateError(
            f"follow: the path begins {shift:.3g} m and {turn:.3g} rad from the object of the state; try a path from"
            " state.object_frame, or begin= with the time at which the path is there"
        )
    low, high = chain.position_limits.T
    beyond = np.maximum(low - state.q, state.q - high)
    if beyond.max() > PASSED:
        k = int(np.argmax(beyond))
        raise StateError(f"follow: state: {chain.joint_names()[k]} is {beyond[k]:.3g} (rad or m) beyond its limit")
    return closed_along(held, np.clip(state.q, low, high), state.qd, place)


def _continued(
    cost: ConfigurationCost, first: State, path: Callable[[float], Target], times: Array, share: float
) -> list[State]:
    """Return closed states along the path, each from the one before.

    From sample to sample the joints also go a share of the way to the cheapest configuration of the self-motion. Where
    they would move far, the step is taken in parts.

    Raises:
        ClosureError: an arm cannot follow, or joints leap from one sample to the next.
    """
    states, names = [first], cost.chain.joint_names()
    for t, before in zip(times[1:], times[:-1], strict=True):
        last = states[-1]
        way = [last]
        try:
            for parts in PARTS:
                way = [last]
                for inner in before + (t - before) * np.arange(1, parts + 1) / parts:
                    way.append(_next(cost, way[-1], _target(path, inner), share / parts))
                if max(_stride(cost.chain, a, b) for a, b in pairwise(way)) <= LONGEST_STRIDE:
                    states.append(way[-1])
                    break
            if states[-1] is last:
                raise ClosureError(
                    f"{names[int(np.argmax(np.abs(way[-1].q - last.q)))]} leaps, at a singular configuration or because"
                    " the path leaps; try a path without this pose, or another start"
                )
        except ClosureError as cause:
            share_done = (t - times[0]) / (times[-1] - times[0])
            where = f"at t = {t:.4g} s, {100 * share_done:.0f} % of the way"
            raise ClosureError(f"follow: {where}: {cause}{_at_limits(cost.chain, last)}") from cause
    return states


def _stride(chain: ClosedChain, before: State, after: State) -> float:
    """Return the largest step of a joint between two states, in rad, or relative to the arms' reach."""
    sizes = coordinate_sizes(chain_at_rest(chain, after))[: chain.joint_count]
    return float(np.abs((after.q - before.q) / sizes).max(initial=0.0))


def _next(cost: ConfigurationCost, before: State, place: Target, share: float) -> State:
    """Return the closed state at the next place, a share of the way nearer to the cheapest one of the self-motion.

    Limits are left to the cost here, because a joint that is stopped at one may leave no way on.

    Raises:
        ClosureError: an arm does not reach.
    """
    motion = chain_at_rest(cost.chain, before)
    terms, N = cost.terms(before.q, motion), self_motions(motion)
    curvature = N.T @ terms.curvature @ N + WEAKEST * np.eye(N.shape[1])
    q = before.q - min(1.0, share) * N @ np.linalg.solve(curvature, N.T @ terms.slope)
    return closed_along(cost.chain, q, before.qd, place, limits=False)


def _at_limits(chain: ClosedChain, state: State) -> str:
    """Name the joints that are at a limit, for a message."""
    distance = _limit_distances(chain, state.q)
    names = [name for name, x in zip(chain.joint_names(), distance, strict=True) if x <= 1e-3]
    return f". At a limit just before: {', '.join(names)}" if names else ""


def _limit_distances(chain: ClosedChain, q: Array) -> Array:
    """Return the distance of each joint from its nearer limit."""
    low, high = chain.position_limits.T
    return np.minimum(q - low, high - q)


def _require_inside(chain: ClosedChain, states: list[State], times: Array) -> None:
    """Refuse a path that passes a joint limit.

    Raises:
        ClosureError: naming the joint, the time, and how far.
    """
    distances = np.array([_limit_distances(chain, state.q) for state in states])
    k, j = np.unravel_index(int(np.argmin(distances)), distances.shape)
    if distances[k, j] < -PASSED:
        raise ClosureError(
            f"follow: at t = {times[k]:.4g} s, {chain.joint_names()[j]} would be {-distances[k, j]:.3g} (rad or m)"
            " beyond its limit; try another start, more room, another path, or a posture that weighs this joint more"
        )


def _with_rates(
    chain: ClosedChain, states: list[State], places: list[Target], times: Array, first: Array, last: Array | None
) -> list[tuple[State, Array]]:
    """Return the states with rates, and the accelerations: those of a cubic spline, corrected to fit the grasps."""
    from scipy.interpolate import CubicSpline  # imported here because it takes half a second

    ends: Any = ((1, first), "not-a-knot" if last is None else (1, last))
    spline = CubicSpline(times, np.array([state.q for state in states]), bc_type=ends)
    found = []
    for t, state, place in zip(times, states, places, strict=True):
        moving = closed_along(chain, state.q, spline(t, 1), place, limits=False)
        found.append((moving, _accelerations(chain, moving, place.acceleration, spline(t, 2))))
    return found


def _accelerations(chain: ClosedChain, state: State, acceleration: Array, wish: Array) -> Array:
    """Return the joint accelerations nearest to wished ones that agree with the object's acceleration, (n,).

    K (J qdd + Jdot qd) = K (A alpha(C) + a(C) - g), with the columns of a trunk in J.
    """
    motion = chain_motion(
        replace(chain, gravity=np.zeros(3)), state, np.zeros(chain.joint_count), Inputs().shaped(chain)
    )
    tips = [
        c.K @ (shift_twist(c.offset, acceleration) + c.a - c.g - arm.bias.tip_acceleration)
        for arm, c in zip(motion.holding, motion.contacts, strict=True)
    ]
    rows, sizes = constraint_rows(motion).joints, coordinate_sizes(motion)[: chain.joint_count]
    return wish + sizes * least_solution(rows * sizes, np.concatenate(tips) - rows @ wish)


def _measured(
    chain: ClosedChain,
    path: Callable[[float], Target],
    times: Array,
    found: list[tuple[State, Array]],
) -> JointPath:
    """Return the path with its margins."""
    states, qdd = [state for state, _ in found], np.array([x for _, x in found])
    strengths, of_chain = [], []
    for state in states:
        arms, R = chain_at_rest(chain, state).arms, state.object_frame.R
        strengths.append([arm_strength(chain.arms[name], arms[name].at, g, R) for name, g in chain.grasps.items()])
        of_chain.append(float(chain_strength(np.array(constraint_pivots(chain, state).condition))))
    q = np.array([state.q for state in states])
    made = JointPath(
        chain,
        path,
        times,
        q,
        np.array([state.qd for state in states]),
        checks.finite(qdd, "follow"),
        np.array([_limit_distances(chain, x) for x in q]),
        np.array(strengths),
        np.array(of_chain),
        np.array([_gap(chain, state) for state in states]),
        np.zeros(len(times) - 1),
    )
    halfway = 0.5 * (times[1:] + times[:-1])
    between = [_gap(chain, State(made.at(t).q, 0 * q[0], _target(path, t).pose)) for t in halfway]
    return replace(made, residual_between=np.array(between))


def _gap(chain: ClosedChain, state: State) -> float:
    """Return the largest position gap of a grasp [m or rad]."""
    return max(float(np.abs(gap.position).max(initial=0.0)) for gap in closure(chain, state).values())
