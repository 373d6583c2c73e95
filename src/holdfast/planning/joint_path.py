"""A joint path along which the object follows its own, with its margins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.control.paths import Target
from holdfast.control.piecewise import polynomial, quintics_between, row_at
from holdfast.dynamics.closing import close
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, Frozen, frozen_property
from holdfast.spatial.scalar import Array, Scalar, maximum, minimum, where
from holdfast.state import State


class JointTarget(NamedTuple):
    """Joint positions with their rates and accelerations at one time, each (n,).

    Attributes:
        q: positions [rad or m].
        qd: rates.
        qdd: accelerations.
    """

    q: Array
    qd: Array
    qdd: Array


class Worst(NamedTuple):
    """The place on a path where something is closest to its limit.

    Attributes:
        value: how close.
        name: the joint or arm.
        t: the time [s].
    """

    value: float
    name: str
    t: float


@called
@dataclass(frozen=True, eq=False)
class JointPath(Frozen):
    """A joint path of a closed chain, from `follow`.

    Attributes:
        chain: the chain.
        path: the object's target as a function of t [s].
        t: (m,) times [s].
        q: (m, n) joint positions, closed at every sample [rad or m].
        qd: (m, n) joint rates, consistent with the grasps.
        qdd: (m, n) joint accelerations, consistent with the grasps.
        limit_distance: (m, n) distance of each joint from its nearer limit [rad or m]; infinite without limits.
        strength: (m, grasps) relative strength of each arm's weakest tip direction: 1 far from singular configurations,
            0 at one.
        chain_strength: (m,) the same for the constraint of the whole chain.
        residual: (m,) largest position gap of a grasp at the samples [m or rad].
        residual_between: (m - 1,) the same halfway between samples.
    """

    chain: ClosedChain
    path: Callable[[float], Target]
    t: ArrayField
    q: ArrayField
    qd: ArrayField
    qdd: ArrayField
    limit_distance: ArrayField
    strength: ArrayField
    chain_strength: ArrayField
    residual: ArrayField
    residual_between: ArrayField

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, checks.read_only(value))

    def at(self, t: Scalar) -> JointTarget:
        """Return the joints' target at time t [s]; they rest before and after the path.

        Between samples each joint follows the quintic polynomial through its positions, rates and accelerations.

        Raises:
            ModelError: no finite number.
        """
        t = checks.number(t, "joint path: t")
        row = row_at(t, self.t[:-1], self._rows)
        begin, span = row[-2], row[-1]
        x = minimum(maximum((t - begin) / span, 0.0), 1.0)
        q, rate, second = polynomial(row[:-2].reshape(-1, 6), x)
        moves = where(t < self.t[0], 0.0, where(t <= self.t[-1], 1.0, 0.0))
        return JointTarget(q, moves / span * rate, moves / span / span * second)

    def state_at(self, t: float) -> State:
        """Return the closed state at time t [s], with the object on its path.

        Raises:
            ModelError: no finite number.
        """
        joints, place = self.at(t), self.path(float(np.clip(t, self.t[0], self.t[-1])))
        guess = State(joints.q, joints.qd, place.pose.wxyz_xyz, place.twist)
        return close(self.chain, guess, hold_object=True, hold_trunk=False)

    @frozen_property
    def _rows(self) -> Array:
        """Coefficients of the joints by (t - begin) / span, then begin and span, for each interval of samples."""
        spans = np.diff(self.t)
        h = spans[:, None]
        ends = [(self.q[k], h * self.qd[k], h**2 * self.qdd[k]) for k in (slice(None, -1), slice(1, None))]
        return np.column_stack([quintics_between(*ends).reshape(len(spans), -1), self.t[:-1], spans])

    @property
    def nearest_limit(self) -> Worst:
        """The joint that comes nearest to one of its limits, relative to its range; infinite without limits."""
        low, high = self.chain.position_limits.T
        spans = np.where(np.isfinite(high - low) & (high > low), high - low, 2 * np.pi)
        return self._worst(self.limit_distance / spans, self.chain.joint_names())

    @property
    def weakest(self) -> Worst:
        """The arm that comes nearest to a singular configuration."""
        return self._worst(self.strength, list(self.chain.grasps))

    @property
    def fastest(self) -> Worst:
        """The joint that uses most of its rate limit, |qd| / limit; 0 without limits."""
        limits = np.array([joint.rate_limit for joint in self.chain.all_joints])
        found = self._worst(-np.abs(self.qd) / limits, self.chain.joint_names())
        return found._replace(value=-found.value)

    def _worst(self, values: Array, names: list[str]) -> Worst:
        k, j = np.unravel_index(int(np.argmin(values)), values.shape)
        return Worst(float(values[k, j]), names[int(j)], float(self.t[k]))

    def __repr__(self) -> str:
        """Return the number of samples and the times, on one line."""
        return f"<JointPath: {len(self.t)} samples of {self.q.shape[1]} joints, {self.t[0]:g} to {self.t[-1]:g} s>"

    def __str__(self) -> str:
        limit, weak, fast = self.nearest_limit, self.weakest, self.fastest
        lines = [
            f"{repr(self)[1:-1]}",
            f"nearest to a limit: {limit.name} at {limit.t:.3g} s, {100 * limit.value:.1f} % of its range away",
            f"nearest to a singular configuration: {weak.name} at {weak.t:.3g} s, strength {weak.value:.3f};"
            f" the chain {self.chain_strength.min():.3f}",
            f"fastest: {fast.name} at {fast.t:.3g} s, {100 * fast.value:.0f} % of its rate limit",
            f"closed to {self.residual.max():.1e}, between samples to {self.residual_between.max():.1e} (m or rad)",
        ]
        return "\n".join(lines)
