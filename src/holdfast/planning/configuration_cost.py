"""The cost of a closed configuration: a posture, and nearness to joint limits and to singular configurations of arms.

    c(q) = 1/2 sum k_j (q_j - q*_j)^2 + sum b(distance from a limit / its zone) + sum b(s_i / zone)

where s_i are the strengths of the arms' tip directions (`near_singular.tip_directions`), and b(u) = (1 - u)^3 / u is
zero outside of a zone and grows without bound towards u = 0, with two continuous derivatives. Below `INNERMOST` it is
continued by its parabola, so that a start on a limit has a cost, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.near_singular import generic_tip_rank, tip_strengths
from holdfast.dynamics.posture import PostureCost
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK
from holdfast.spatial.scalar import Array

INNERMOST = 0.05  # fraction of a zone
STRENGTH_DIFFERENCE = 1e-6  # rad or m, of the differences of strengths


class CostTerms(NamedTuple):
    """A cost with its derivatives.

    Attributes:
        value: the cost.
        slope: (n,) its gradient.
        curvature: (n, n) its Hessian without that of the strengths themselves, positive semidefinite.
    """

    value: float
    slope: Array
    curvature: Array


@dataclass(frozen=True)
class ConfigurationCost:
    """The cost of the configurations of a chain.

    Attributes:
        chain: the chain.
        posture: the cost of joint positions.
        room: width of the zone at each joint limit, relative to the joint's range.
        strength: width of the zone at singular configurations.
    """

    chain: ClosedChain
    posture: PostureCost
    room: float
    strength: float

    def value(self, q: Array, motion: ChainMotion) -> float:
        """Return the cost of joint positions, (n,), with the chain's motion there."""
        found = self.posture.of(q) + sum(float(zone_cost(u)[0].sum()) for u, _ in self._from_limits(q))
        return found + sum(float(zone_cost(u)[0].sum()) for _, u in self._strengths(motion))

    def terms(self, q: Array, motion: ChainMotion) -> CostTerms:
        """Return the cost of joint positions, (n,), with its derivatives."""
        value, n = self.posture.of(q), self.chain.joint_count
        slope, along = self.posture.stiffness * (q - self.posture.wish), self.posture.stiffness.copy()
        for u, rate in self._from_limits(q):
            cost, first, second = zone_cost(u)
            value, slope, along = value + float(cost.sum()), slope + first * rate, along + second * rate**2
        curvature = np.diag(along)
        for name, u in self._strengths(motion):
            cost, first, second = zone_cost(u)
            if not cost.any():
                continue
            rates = np.zeros((len(u), n))
            rates[:, self._columns(name)] = self._strength_rates(motion, name)
            value, slope = value + float(cost.sum()), slope + first @ rates
            curvature += (rates.T * second) @ rates
        return CostTerms(value, slope, curvature)

    def _from_limits(self, q: Array) -> list[tuple[Array, Array]]:
        """Return the distances of joints from both limits in units of their zones, (n,), and their rates by q, (n,)."""
        low, high = self.chain.position_limits.T
        spans = np.where(np.isfinite(high - low), high - low, 2 * np.pi)
        width = self.room * np.where(spans > 0, spans, np.inf)  # a joint that cannot move has no zone
        found = []
        for limit, sign in ((low, 1.0), (high, -1.0)):
            near = np.isfinite(limit) & np.isfinite(width)
            distance = sign * (q - np.where(near, limit, 0.0))
            found.append((np.where(near, distance / width, 1.0), np.where(near, sign / width, 0.0)))
        return found

    def _strengths(self, motion: ChainMotion) -> list[tuple[str, Array]]:
        """Return the strengths of every arm that holds, in units of the zone."""
        found = []
        for (name, grasp), c in zip(self.chain.grasps.items(), motion.contacts, strict=True):
            if rank := generic_tip_rank(self.chain.arms[name], grasp):
                arm = motion.arms[name]
                found.append((name, tip_strengths(c.K, jacobian(arm.arm, arm.at))[:rank] / self.strength))
        return found

    def _columns(self, name: str) -> Array:
        """Return the indices of the joints that move an arm, those of its trunk first."""
        below = TRUNK if name in self.chain.mounted_on else name
        joints = np.arange(self.chain.joint_count)
        own = joints[self.chain.joints[name]]
        return own if below == name else np.r_[joints[self.chain.joints[TRUNK]], own]

    def _strength_rates(self, motion: ChainMotion, name: str) -> Array:
        """Return the derivatives of an arm's strengths, in units of the zone, by the joints that move it.

        The Jacobian's columns [w_i; v_i] about the tip turn with the joints c before joint i, [w_c x w_i; w_c x v_i],
        and change as the tip is moved by joints c behind it, [0; w_i x v_c].
        """
        arm, c = motion.arms[name], motion.contacts[[*self.chain.grasps].index(name)]
        J = jacobian(arm.arm, arm.at)
        columns = J
        if name in self.chain.mounted_on:
            columns = np.hstack([motion.trunk.jacobian(name, arm.base_to_tip)[0], J])
        below = columns.shape[1] - J.shape[1]
        w, v, turning, moving = J[:3].T, J[3:].T, columns[:3].T[:, None], columns[3:].T[:, None]
        before = (np.arange(len(turning))[:, None] - below <= np.arange(len(w)))[:, :, None]
        dw = np.where(before, np.cross(turning, w), 0.0)
        dv = np.where(before, np.cross(turning, v), np.cross(w, moving))
        dJ = np.concatenate([dw, dv], axis=-1).transpose(0, 2, 1)  # (joints, 6, N)
        rank = generic_tip_rank(self.chain.arms[name], self.chain.grasps[name])
        ends = [tip_strengths(c.K, J + step * dJ)[:, :rank] for step in (STRENGTH_DIFFERENCE, -STRENGTH_DIFFERENCE)]
        return (ends[0] - ends[1]).T / (2 * STRENGTH_DIFFERENCE * self.strength)


def zone_cost(u: Array) -> tuple[Array, Array, Array]:
    """Return b(u) = (1 - u)^3 / u for u < 1 and 0 beyond, with two derivatives; a parabola below `INNERMOST`."""
    inner, outside = np.clip(u, INNERMOST, 1.0), u >= 1.0
    value, first, second = 1 / inner - 3 + 3 * inner - inner**2, -1 / inner**2 + 3 - 2 * inner, 2 / inner**3 - 2
    step = np.minimum(u - INNERMOST, 0.0)
    value, first = value + first * step + 0.5 * second * step**2, first + second * step
    return np.where(outside, 0.0, value), np.where(outside, 0.0, first), np.where(outside, 0.0, second)
