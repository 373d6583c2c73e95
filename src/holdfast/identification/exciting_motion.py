"""Motions of a closed chain along finite Fourier series of its independent coordinates, within limits.

A closed chain has d independent coordinates u = B^T (q - q_0), with a basis B of the directions in which its joints can
move at the start; the grasps give the rest. Rates and accelerations follow from the series by

    [B^T  0; K J  -K A] (qd, V) = (u', 0),    [B^T  0; K J  -K A] (qdd, alpha) = (u'', what the grasps need)

so that planned motions are closed, and smooth, without differences.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import null_space

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed_positions import position_gap_at, position_rows
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE, constraint_rows, coordinate_sizes
from holdfast.dynamics.projection import moved
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.identification.machine.identify_machine import measurement_errors
from holdfast.identification.recording import Recording
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

ASSUMED_RATE = 2.0  # rad/s, or reaches of the arms a second, of joints without a limit
FARTHEST_COORDINATE = 1.0  # rad, or reaches, of a coordinate from the start
GAP_LEFT, MOST_STEPS_TO_CLOSE = 1e-12, 30  # gap at which Newton's steps end, and how many there may be
NEAR_LIMIT, MOST_SHRINKS = 0.97, 8  # of the nearest limit that a scaled series may use, and attempts to scale it
UNKNOWN = 2.0  # how far a series is beyond its limits, if its motion cannot be closed


@dataclass(frozen=True, eq=False)
class Series:
    """Finite Fourier series of all coordinates, at rest at both ends.

    Attributes:
        coefficients: (d, 2 harmonics + 1) of 1, cosines and sines.
        length: the period [s].
    """

    coefficients: Array
    length: float

    @staticmethod
    def random(count: int, length: float, highest: int, random: np.random.Generator) -> Series:
        """Return a series with some of the harmonics and some directions of the coordinates."""
        harmonics = int(random.integers(2, highest + 1))
        start = np.array([one[0] for one in Series(np.eye(2 * harmonics + 1), length).at(np.zeros(1))])
        free = null_space(start)
        size = random.exponential(size=(count, 1)) * random.normal(size=(count, free.shape[1]))
        return Series(size @ free.T, length)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return u, u' and u'', (samples, d) each."""
        k = np.arange(1, (self.coefficients.shape[1] + 1) // 2)
        w = 2.0 * np.pi * k / self.length
        c, s = np.cos(w * t[:, None]), np.sin(w * t[:, None])
        one, none = np.ones((len(t), 1)), np.zeros((len(t), 1))
        values = np.hstack([one, c, s]), np.hstack([none, -w * s, w * c]), np.hstack([none, -w * w * c, -w * w * s])
        return tuple(x @ self.coefficients.T for x in values)  # pyright: ignore[reportReturnType]

    def times(self, factor: float) -> Series:
        """Return a series of another size."""
        return Series(factor * self.coefficients, self.length)


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Independent coordinates of a closed chain around a state.

    Attributes:
        state: the state.
        B: (n, d) by which u = B^T (q - q_0).
    """

    state: State
    B: Array

    @property
    def count(self) -> int:
        """The number of coordinates."""
        return self.B.shape[1]

    @staticmethod
    def of(chain: ClosedChain, state: State) -> Coordinates:
        """Return the coordinates around a closed state; refuse chains that have none."""
        kinds = [grasp.of_kind for grasp in chain.grasps.values()]
        if chain.floats or any(kind.rate_rows or kind.compliant for kind in kinds):
            what = "a floating base" if chain.floats else "grasps that roll or yield"
            raise MethodNotApplicable(f"next_motion: the chain has {what}; try rigid grasps, and a base in the world")
        motion, gap = position_gap_at(chain, state)
        if np.abs(gap).max(initial=0.0) > 1e-6:
            raise StateError("next_motion: state: expected closed grasps; try hf.close first")
        n, sizes = chain.joint_count, coordinate_sizes(motion)
        if not chain.grasps:
            return Coordinates(state, np.diag(1.0 / sizes[:n]))
        N = constraint_rows(motion).motions / sizes[:, None]
        U, s, _ = np.linalg.svd(N[:n], full_matrices=False)
        if not len(s) or s[-1] < 1e-6 * s[0]:
            raise MethodNotApplicable("next_motion: the object can move while no joint does; try rigid grasps")
        return Coordinates(state, U / sizes[:n, None])

    def moved_to(self, chain: ClosedChain, state: State, u: Array) -> tuple[State, ChainMotion] | None:
        """Return the closed state near another one at coordinates u, and the chain at rest; None if it is not found."""
        n = chain.joint_count
        for _ in range(MOST_STEPS_TO_CLOSE):
            motion, gap = position_gap_at(chain, state)
            left = np.r_[u - self.B.T @ (state.q - self.state.q), -gap]
            size = float(np.abs(left).max())
            if size < GAP_LEFT:
                return state, motion
            if not size < 10.0 * FARTHEST_COORDINATE:
                return None
            state = moved(state, _solved(self._with(position_rows(motion), n), left))
        return None

    def along(
        self, chain: ClosedChain, at: tuple[State, ChainMotion], rates: Array, accelerations: Array
    ) -> tuple[State, Array, Array]:
        """Return a closed state with its velocities, qdd and alpha, for u' and u''."""
        n, (state, rest) = chain.joint_count, at
        rows = self._with(constraint_rows(rest).matrix, n)
        v = _solved(rows, np.r_[rates, np.zeros(len(rows) - self.count)])
        state = State(state.q, v[:n], state.object_pose, v[n:])
        still = replace(chain, gravity=np.zeros(3))
        motion = chain_motion(still, state, np.zeros(n), Inputs().shaped(chain))
        needs = [
            c.K @ (c.a - c.g - arm.bias.tip_acceleration)
            for arm, c in zip(motion.holding, motion.contacts, strict=True)
        ]
        a = _solved(rows, np.concatenate([accelerations, *needs]))
        return state, a[:n], a[n:]

    def _with(self, rows: Array, n: int) -> Array:
        """Return the rows of the coordinates, and others below them."""
        return np.vstack([np.hstack([self.B.T, np.zeros((self.count, 6))]), rows])


def _solved(rows: Array, right: Array) -> Array:
    """Return the solution of least norm of rows of which some may depend on others."""
    return np.linalg.lstsq(rows, right, rcond=NULL_SINGULAR_VALUE)[0]


class Limits(NamedTuple):
    """What a motion may use.

    Attributes:
        low: (n,) of positions.
        high: (n,) of positions.
        rates: (n,) of joint rates.
        efforts: (n,) of joint torques.
        turn: of the object [rad].
        shift: of the object [m].
    """

    low: Array
    high: Array
    rates: Array
    efforts: Array
    turn: float
    shift: float

    @staticmethod
    def of(chain: ClosedChain, state: State, share: Any, turn: Any, shift: Any) -> Limits:
        """Return the limits of a chain; refuse a state that is beyond them."""
        used = checks.number(share, "next_motion: share", above=0.0)
        if used > 1.0:
            raise ModelError(f"next_motion: share: expected 0 .. 1, got {used:g}")
        low, high = chain.position_limits.T
        margin = np.where(np.isfinite(high - low), 0.5 * (1.0 - used) * (high - low), 0.0)
        low, high = low + margin, high - margin
        names = [name for name, x, a, b in zip(chain.joint_names(), state.q, low, high, strict=True) if not a <= x <= b]
        if names:
            raise StateError(f"next_motion: state: expected joints within the share of their ranges, got {names[0]}")
        rates = np.array([joint.rate_limit for joint in chain.freedoms])
        efforts = np.array([joint.effort_limit for joint in chain.freedoms])
        rates = np.where(np.isfinite(rates), rates, ASSUMED_RATE)
        turned, shifted = (
            checks.number(x, f"next_motion: {name}", above=0.0) for name, x in (("turn", turn), ("shift", shift))
        )
        return Limits(low, high, used * rates, used * efforts, turned, shifted)

    def used_by(self, chain: ClosedChain, start: State, u: Array, given: Recording) -> float:
        """Return the largest fraction of a limit, but for torques, that a motion uses; above 1 it is beyond it."""
        assert given.qd is not None and given.object_pose is not None
        q, room = given.q, np.where(given.q > start.q, self.high - start.q, start.q - self.low)
        fractions = [np.abs(u) / FARTHEST_COORDINATE, np.abs(q - start.q) / np.maximum(room, 1e-9)]
        fractions.append(np.abs(given.qd) / self.rates)
        if chain.grasps:
            R, p = start.object_frame.R, start.object_frame.p
            poses = [Pose.from_wxyz_xyz(one) for one in given.object_pose]
            fractions += [
                np.array([np.linalg.norm(rotation.log(one.R @ R.T)) for one in poses]) / self.turn,
                np.array([np.linalg.norm(one.p - p) for one in poses]) / self.shift,
            ]
        return max(float(np.abs(one).max(initial=0.0)) for one in fractions)


def planned(chain: ClosedChain, coordinates: Coordinates, series: Series, t: Array) -> Recording | None:
    """Return the motion along a series, without torques; None where it cannot be closed."""
    state, rows = coordinates.state, list[tuple[Array, ...]]()
    steps = [*np.diff(t), 0.0]
    for h, u, rate, acceleration in zip(steps, *series.at(t), strict=True):
        reached = coordinates.moved_to(chain, state, u)
        if reached is None:
            return None
        state, qdd, alpha = coordinates.along(chain, reached, rate, acceleration)
        rows.append((state.q, state.qd, qdd, state.object_pose, state.object_twist, alpha))
        ahead = h * np.r_[state.qd, state.object_twist] + 0.5 * h * h * np.r_[qdd, alpha]
        state = moved(state, ahead)  # the next state but for terms of third order
    names = ("q", "qd", "qdd", "object_pose", "object_twist", "object_acceleration")
    arrays: dict[str, Any] = {name: np.array(x) for name, x in zip(names, zip(*rows, strict=True), strict=True)}
    return Recording(t=t, **arrays)


def within(
    chain: ClosedChain, coordinates: Coordinates, limits: Limits, series: Series, t: Array
) -> tuple[Series, Recording] | None:
    """Return a series, smaller if limits demand it, and its motion with torques; None if none is found."""
    for _ in range(MOST_SHRINKS):
        made = planned(chain, coordinates, series, t)
        used = UNKNOWN if made is None else limits.used_by(chain, coordinates.state, series.at(t)[0], made)
        if made is not None and used <= 1.0:
            made = replace(made, tau=-measurement_errors(chain, replace(made, tau=0.0 * made.q), "tau"))
            used = float((np.abs(np.asarray(made.tau)) / limits.efforts).max())
            if used <= 1.0:
                return series, made
        series = series.times(NEAR_LIMIT / min(used, UNKNOWN))
    return None


def largest(coordinates: Coordinates, limits: Limits, series: Series, t: Array) -> Series:
    """Return a series of the size at which coordinates, or rates to first order, come to their limits."""
    u, rates, _ = series.at(t)
    used = np.abs(u).max() / FARTHEST_COORDINATE, np.abs(rates @ np.linalg.pinv(coordinates.B) / limits.rates).max()
    return series.times(1.0 / float(max(used)))
