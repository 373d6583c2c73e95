"""What forward dynamics returns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array


class Status(Enum):
    """How the answer is to be read."""

    OK = "every quantity is unique"
    INDETERMINATE_FORCES = (
        "accelerations are unique; the grasp forces are not, and the smallest ones (in the metric of"
        " the force split) are returned"
    )
    SINGULAR = "the constraint's rank drops here: nothing is returned, as no number would be a trajectory's"
    INVALID = "the inputs are not finite or out of range (positions to 1e5 rad, unit quaternions): nothing is returned"


@dataclass(frozen=True, eq=False)
class ArmResult(Frozen):
    """One arm's part of a result; fields as in `ForwardResult`."""

    qdd: Array
    grasp_wrench: Array
    contact_acceleration: Array
    base_wrench: Array


@dataclass(frozen=True, eq=False)
class ForwardResult(Frozen):
    """Accelerations and forces of a closed chain. SI units, world axes.

    Attributes:
        chain: the chain it belongs to.
        qdd: (n,) joint accelerations, arms in order, base to tip [rad/s^2 or m/s^2].
        grasp_wrench: (arms, 6) [moment; force] of each arm on the object, about the
            contact point; zero for an arm without a grasp [N m, N].
        object_acceleration: (6,) [omega_dot; v_dot of C], true (gravity in).
        contact_acceleration: (sum n_g,) W_dot; hinge and soft finger along the contact
            frame's axes, ball along world axes [rad/s^2, m/s^2].
        base_wrench: (arms, 6) of the base, or of the trunk, on each arm about the arm's base origin [N m, N].
        rank: independent rows of the grasp constraint [J, -A, H^T], of 6 a grasp.
        mobility: dimension of the velocities (qd, V(C), W) that the grasps allow.
        status: whether the forces are unique. (Only compiled code returns SINGULAR and INVALID,
            with not-a-number for all else; the reference raises.)
        condition: how near the chain is to a singular configuration, without units: the inverse of the
            smallest pivot kept in solving for the grasp forces, each relative to its size before anything
            was subtracted. Up to about 100 in ordinary configurations; near a singular one it grows as the inverse
            square of the distance. Velocities, torques and `method` do not enter. (Compiled code returns
            infinity with SINGULAR.)
        method: the algorithm's name.
        held: (grasps, 1 or 2, 6) 1 for the components along each grasp's axes that are held, in velocity and, if
            others, in position; 0 for those that are free or follow from others. None unless the generic rank was
            given and is below the constraint's rows.
        base_acceleration: (6,) [omega_dot; v_dot] of a floating base's origin, true (gravity in); None without one.
        trunk_base_wrench: (6,) of the base on the trunk about the base origin, 0 below a floating base [N m, N]; None
            without a trunk.
    """

    chain: ClosedChain
    qdd: Array
    grasp_wrench: Array
    object_acceleration: Array
    contact_acceleration: Array
    base_wrench: Array
    rank: int
    mobility: int
    status: Status
    condition: float
    method: str
    held: Array | None = None
    base_acceleration: Array | None = None
    trunk_base_wrench: Array | None = None

    def __repr__(self) -> str:
        """Return what kind of answer it is, and the wrench of each arm that holds, a line each."""
        if self.qdd.ndim > 1:
            return f"<{type(self).__name__} by {self.method}: {len(self.qdd)} systems of {', '.join(self.chain.names)}>"
        head = f"{type(self).__name__} by {self.method}: rank {self.rank}, mobility {self.mobility}, condition"
        lines = [f"{head} {self.condition:.4g}; {self.status.value}"]
        for name in self.chain.grasps:
            wrench = self.grasp_wrench[self.chain.names.index(name)]
            force, moment = checks.place(wrench[3:]), checks.place(wrench[:3])
            lines.append(f"  {name}: force {force} N, moment {moment} N m on the object")
        return f"<{chr(10).join(lines)}>"

    def __getitem__(self, arm: str) -> ArmResult:
        """Return one arm's part."""
        names = self.chain.names
        if arm not in names:
            raise KeyError(f"no arm '{arm}'.{checks.did_you_mean(arm, names)}")
        i = names.index(arm)
        freedoms = self.chain.contact_freedoms.get(arm)
        return ArmResult(
            self.qdd[..., self.chain.joints[arm]],
            self.grasp_wrench[..., i, :],
            self.contact_acceleration[..., freedoms or slice(0)],
            self.base_wrench[..., i, :],
        )


def require_result_of(chain: ClosedChain, result: Any) -> None:
    """Refuse a result of another chain, or of a batch.

    Args:
        chain: the chain.
        result: a `ForwardResult`, or a `CompiledResult` of one system.

    Raises:
        StateError: naming what differs.
    """
    checks.instance(result, ForwardResult, "result", StateError)
    expected = (chain.joint_count,), (len(chain.arms), 6)
    got = np.shape(result.qdd), np.shape(result.grasp_wrench)
    if got != expected:
        raise StateError(
            f"result: expected one system of {len(chain.arms)} arms with {chain.joint_count} joints, got accelerations"
            f" of shape {got[0]} and grasp wrenches of shape {got[1]}; try the result of this chain at this state"
        )
