"""The result of forward dynamics and its status."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array


class Status(Enum):
    """The validity of the result of forward dynamics."""

    OK = "every quantity is unique"
    INDETERMINATE_FORCES = (
        "accelerations are unique; the grasp forces are not, and the smallest ones (in the metric of"
        " the force split) are returned"
    )
    SINGULAR = "the constraint's rank drops here: nothing is returned, as no number would be a trajectory's"
    INVALID = "the inputs are not finite or out of range (positions to 1e5 rad, unit quaternions): nothing is returned"


@called
@dataclass(frozen=True, eq=False)
class ArmResult(Frozen):
    """One arm's part of a result, with the fields of `ForwardResult`."""

    qdd: Array
    grasp_wrench: Array
    contact_acceleration: Array
    base_wrench: Array

    def __repr__(self) -> str:
        """Return the number of joints and the wrench, or the number of systems."""
        if self.qdd.ndim > 1:
            return f"<{type(self).__name__}: {len(self.qdd)} systems of {self.qdd.shape[1]} joints>"
        force, moment = checks.place(self.grasp_wrench[3:]), checks.place(self.grasp_wrench[:3])
        return f"<{type(self).__name__}: {len(self.qdd)} joints, force {force} N, moment {moment} N m on the object>"


@dataclass(frozen=True, eq=False)
class ForwardResult(Frozen):
    """Accelerations and forces of a closed chain. SI units, world axes.

    Attributes:
        chain: the chain it belongs to.
        qdd: (n,) joint accelerations, arms in order, base to tip [rad/s^2 or m/s^2].
        grasp_wrench: (arms, 6) [moment; force] of each arm on the object, about the
            contact point; zero for an arm without a grasp [N m, N].
        object_acceleration: (6,) [omega_dot; v_dot of C], the true acceleration (including gravity).
        contact_acceleration: (sum n_g,) W_dot; along the contact frame's axes for a hinge and a soft finger, along
            world axes for a ball [rad/s^2, m/s^2].
        base_wrench: (arms, 6) wrench of the base, or of the trunk, on each arm about the arm's base origin [N m, N].
        rank: number of independent rows of the grasp constraint [J, -A, H^T], which has six rows per grasp.
        mobility: dimension of the space of velocities (qd, V(C), W) that the grasps allow.
        status: whether the forces are unique. (Only compiled code returns SINGULAR and INVALID, with NaN for all
            numbers; the reference raises an error.)
        condition: dimensionless condition number of the constraint: the inverse of the smallest nonzero pivot in
            solving for the grasp forces, where each pivot is relative to its size before subtractions. It is up to
            about 100 in ordinary configurations, and near a singular configuration it grows as the inverse square of
            the distance. It does not depend on velocities, torques or `method`. (Compiled code returns infinity with
            SINGULAR.)
        method: name of the algorithm.
        held: (grasps, 1 or 2, 6) mask with 1 for the imposed components along each grasp's axes, for velocities and, if
            they differ, for positions; 0 for components that are free or depend on others. None unless the generic rank
            was given and is lower than the number of constraint rows.
        base_acceleration: (6,) [omega_dot; v_dot] of a floating base's origin, the true acceleration (including
            gravity); None without one.
        trunk_base_wrench: (6,) wrench of the base on the trunk about the base origin, 0 for a floating base [N m, N];
            None without a trunk.
        touch_force: (k, 3) force of the world on the object at every candidate of `touching`, world axes [N]; this and
            what follows is None without `touching`.
        touch_gap: (k,) distances [m].
        touch_mode: (k,) numbers of `ContactMode`: open, sticks, slips, closed (without friction).
        touch_status: whether contact forces and motion are unique.
        touch_residual: violation of the laws of contact, relative to the accelerations.
        touch_range: (2, 6) with AMBIGUOUS, object accelerations between which others satisfy the laws, too; else None.
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
    touch_force: Array | None = None
    touch_gap: Array | None = None
    touch_mode: Array | None = None
    touch_status: ContactStatus | None = None
    touch_residual: float | None = None
    touch_range: Array | None = None

    def __repr__(self) -> str:
        """Return the method, rank, condition and status, and the wrench of each arm with a grasp on a line."""
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
    """Check that a result belongs to one system of the given chain.

    Args:
        chain: the chain.
        result: a `ForwardResult`, or a `CompiledResult` of one system.

    Raises:
        StateError: the shapes differ; the message gives them.
    """
    checks.instance(result, ForwardResult, "result", StateError)
    expected = (chain.joint_count,), (len(chain.arms), 6)
    got = np.shape(result.qdd), np.shape(result.grasp_wrench)
    if got != expected:
        raise StateError(
            f"result: expected one system of {len(chain.arms)} arms with {chain.joint_count} joints, got accelerations"
            f" of shape {got[0]} and grasp wrenches of shape {got[1]}; try the result of this chain at this state"
        )
