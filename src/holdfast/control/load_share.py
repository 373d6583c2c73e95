"""Load sharing: which arm carries how much of the object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from holdfast.control.balanced_torques import pushes
from holdfast.control.law_parts import GraspForces, LawInput
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import needed_wrench
from holdfast.dynamics.inverse import torques
from holdfast.errors import ModelError
from holdfast.forces.margins import joint_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array, array, maximum, reciprocal
from holdfast.spatial.spatial_vector import shift_wrench

LEAST_RESERVE = 0.1  # of an effort limit, below which a reserve is not counted as smaller, so that shares are bounded
IDLE = 1e-6  # cost of a load that no joint feels, in squares of used reserve; without a load, shares are equal


@called
@dataclass(frozen=True, eq=False)
class LoadShare(GraspForces):
    """Each arm carries its share of the wrench that moves the object, f_i = s_i A_i^-T (M alpha + b), and pushes.

    Without given shares, they follow the reserve of the drives: they minimise sum_i s_i^2 c_i with sum_i s_i = 1, where
    c_i = sum_j (J_i^T f)_j^2 / (effort_j - |t_j|)^2 for the whole load f on arm i, and t are the torques without load;
    hence s_i = (1 / c_i) / sum_k (1 / c_k). Grasps that transmit only some directions share as far as they can.

    Attributes:
        shares: s_i by arm, >= 0 with sum 1; arms that are not named carry none; None for the reserve of the drives.
        force: push of every arm along its contact normal into the object [N].

    Raises:
        ModelError: shares below 0, or whose sum is not 1.

    Reference:
        Erhart and Hirche, Internal force analysis and load distribution for cooperative multi-robot manipulation, T-RO
        2015.
    """

    shares: Mapping[str, float] | None = None
    force: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "force", checks.number(self.force, "load share: force"))
        if self.shares is None:
            return
        checks.instance(self.shares, Mapping, "load share: shares")
        found = {name: checks.number(x, f"load share: shares: {name}", at_least=0.0) for name, x in self.shares.items()}
        if abs(sum(found.values()) - 1.0) > 1e-9:
            raise ModelError(f"load share: shares: expected the sum 1, got {sum(found.values()):g}")
        put(self, "shares", FrozenDict(found))

    def require(self, chain: ClosedChain) -> None:
        """Refuse shares of arms that hold nothing."""
        for name in self.shares or ():
            if name not in chain.grasps:
                said = checks.did_you_mean(str(name), chain.grasps)
                raise ModelError(f"load share: no arm {checks.short(name)} holds the object.{said}")

    def wished(self, x: LawInput, acceleration: Array) -> Array:
        """Return the wrenches of the arms, (arms, 6)."""
        grasps, net = x.motion.chain.grasps, needed_wrench(x.motion, acceleration)
        whole = {name: shift_wrench(-c.offset, net) for name, c in zip(grasps, x.motion.contacts, strict=True)}
        shares = self._by_reserve(x, whole) if self.shares is None else self.shares
        carried = {name: shares.get(name, 0.0) * f for name, f in whole.items()}
        carried = array([carried.get(name, np.zeros(6)) for name in x.motion.chain.names])
        return carried + pushes(x.motion, self.force)

    def _by_reserve(self, x: LawInput, whole: Mapping[str, Array]) -> dict[str, Array]:
        """Return the shares by which the drives use the least of their reserve."""
        motion, chain = x.motion, x.motion.chain
        effort, none = joint_limits(chain).effort, np.zeros(chain.joint_count)
        alone = torques(motion, none, np.zeros((len(chain.arms), 6)))
        reserve = [maximum(most - abs(t), LEAST_RESERVE * most) for most, t in zip(effort, alone, strict=True)]
        inverse = {}
        for (name, f), c in zip(whole.items(), motion.contacts, strict=True):
            arm, part = motion.arms[name], chain.joints[name]
            load = jacobian(arm.arm, arm.at).T @ c.transmissible(f)
            limits = zip(load, reserve[part], effort[part], strict=True)
            used = [t / most if limit < np.inf else 0.0 for t, most, limit in limits]
            inverse[name] = reciprocal(sum((u * u for u in used), start=IDLE))
        total = sum(inverse.values())
        return {name: w / total for name, w in inverse.items()}
