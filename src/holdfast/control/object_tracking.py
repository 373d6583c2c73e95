"""Computed-torque control of the object along a path, with an internal force."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, cast

import numpy as np

from holdfast.control.balanced_torques import pushes
from holdfast.control.commanded_torques import Command, WithinLimits, chosen_torques, within_limits
from holdfast.control.controller import by_machine_code, known_breakpoints
from holdfast.control.law_parts import LawInput, NullMotion
from holdfast.control.paths import ObjectPath, Target, path_function, pose_error
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.tree.mechanism_inverse import mechanism_holding
from holdfast.errors import ModelError
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest, require_unused
from holdfast.names import called
from holdfast.spatial.frozen import Frozen, FrozenDict, frozen_property
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array
from holdfast.state import Inputs, State, require_fit, require_state


@called
@dataclass(frozen=True, eq=False)
class ObjectTracking(Frozen):
    """Computed torque, tau = M qdd + C + J^T f + torques of dampers and springs, for the object's acceleration.

    The commanded acceleration is that of the path plus a correction,
    alpha = alpha_d + damping (V_d - V) + stiffness [log(R_d R^T); p_d - p]. The error then satisfies
    e'' + damping e' + stiffness e = 0. Bases are assumed to stand still. Redundant joints, and those of a trunk, are
    damped or follow a `posture`; a floating base moves as the wrenches on it require. Within `limits` the torques are
    those of `cooperative_law`, and the internal force is a wish.

    A chain with branches, loops, couplings or several objects has a path for every object, neither posture nor limits,
    and a floating base that is to stay where it is; passive joints have no torques.

    Attributes:
        chain: the controller's model of the chain.
        path: function of t [s] that returns the target, or a path object, whose method `at` is used; of several objects
            a mapping from their names.
        internal_force: push of every arm along its contact normal into the object [N].
        stiffness: gain of the pose error [1/s^2].
        damping: gain of the twist error [1/s]; 2 sqrt(stiffness) is critical.
        joint_damping: damping of joint motions that do not move the object, and of the joints of a trunk [1/s].
        posture: motion that moves no grasp, such as `PostureControl`, in place of this damping.
        limits: limits that the torques keep; None for none.
        cost: the cost within limits, as of `cooperative_law`.
    """

    chain: ClosedChain
    path: Callable[[float], Target] | ObjectPath | Mapping[str, Callable[[float], Target] | ObjectPath]
    internal_force: float = 0.0
    stiffness: float = 100.0
    damping: float = 20.0
    joint_damping: float = 10.0
    posture: NullMotion | None = None
    limits: ForceLimits | None = None
    cost: ForceCost | None = None
    traceable: ClassVar[bool] = True  # can be compiled to machine code if the path is traceable

    def __post_init__(self) -> None:
        checks.instance(self.chain, ClosedChain, "object tracking: chain")
        object.__setattr__(self, "path", self._paths())
        for name in ("internal_force", "stiffness", "damping", "joint_damping"):
            object.__setattr__(self, name, checks.number(getattr(self, name), f"object tracking: {name}"))
        checks.instance(self.posture, (NullMotion, type(None)), "object tracking: posture")
        if answered_as_forest(self.chain):
            require_unused(posture=self.posture is not None, limits=self.limits is not None, cost=self.cost is not None)
        if self.posture is not None:
            self.posture.require(self.chain)
        _ = self.within  # which refuses what does not fit

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which its torques jump [s], as far as they are known in advance."""
        paths = self.path.values() if isinstance(self.path, Mapping) else [self.path]
        return known_breakpoints(*paths, self.posture)

    def for_chain(self, chain: ClosedChain) -> Self:
        """Return the controller for a chain whose grasps have changed."""
        within = self.within
        return replace(self, chain=chain, limits=None if within is None else within.for_chain(chain).limits)

    @np.errstate(all="ignore")  # what overflows is refused
    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques (n,) [N m or N]; the memory is not used.

        Raises:
            StateError: they overflow, or the state is none of the chain.
        """
        if answered_as_forest(self.chain):
            require_state(self.chain, state)
            wished = -self.joint_damping * state.qd
            wanted = self.commanded_acceleration(t, state)
            return mechanism_holding(self.chain, state, wanted, self.internal_force, wished, check=False), memory
        require_fit(self.chain, state)
        found = by_machine_code(self, t, state, memory)
        if found is not None:
            return found
        motion = chain_motion(self.chain, state, np.zeros(self.chain.joint_count), Inputs().shaped(self.chain))
        joints = -self.joint_damping * state.qd
        if self.posture is not None:
            joints = self.posture.joint_acceleration(LawInput(t, state, motion, np.zeros(0), {}))
        command = Command(self.commanded_acceleration(t, state), pushes(motion, self.internal_force), joints)
        tau, _, _ = chosen_torques(motion, state, command, self.within)
        return checks.finite(tau, "object tracking"), memory

    @frozen_property
    def within(self) -> WithinLimits | None:
        """The limits with their cost."""
        return within_limits(self.chain, self.limits, self.cost, "object tracking")

    @np.errstate(all="ignore")  # what overflows is refused
    def commanded_acceleration(self, t: float, state: State) -> Array:
        """Return the commanded [omega_dot; v_dot] of C, (6,) world axes, or (k, 6) of k objects.

        Raises:
            StateError: it overflows.
        """
        paths = self.path.values() if isinstance(self.path, Mapping) else [self.path]
        one, found = state.object_twist.ndim == 1, []
        frames = [state.object_frame] if one else map(Pose.unchecked_seven, state.object_pose)
        for path, frame, twist in zip(paths, frames, state.object_twist.reshape(-1, 6), strict=True):
            target = cast(Callable[[float], Target], path)(t)
            error = pose_error(target.pose, frame)
            found.append(target.acceleration + self.damping * (target.twist - twist) + self.stiffness * error)
        return checks.finite(array(found).reshape(state.object_twist.shape), "object tracking: acceleration")

    def _paths(self) -> Any:
        """Return the path as a function of time, or those of several objects by name, in order."""
        what, names = "object tracking: path", [*self.chain.free_objects]
        if not isinstance(self.path, Mapping) and len(names) == 1:
            return path_function(self.path, what)
        if not isinstance(self.path, Mapping) or {*self.path} != {*names} or not names:
            listed = f"a path for each of the objects {', '.join(names)}, by name"
            wanted = listed if names else "a chain with an object"
            got = f"{', '.join(map(str, self.path))}" if isinstance(self.path, Mapping) else "one path"
            raise ModelError(f"{what}: expected {wanted}, got {got}")
        found = {name: path_function(self.path[name], f"{what} of '{name}'") for name in names}
        return FrozenDict(found) if len(names) > 1 else found[names[0]]
