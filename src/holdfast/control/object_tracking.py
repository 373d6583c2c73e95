"""Computed torque: the object follows a path while the arms squeeze it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, Self, cast

import numpy as np

from holdfast.control.computed_torque import computed_torque
from holdfast.control.controller import by_machine_code
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.control.paths import Target
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, concatenate
from holdfast.state import State, require_fit


class ObjectPath(Protocol):
    """Where the object should be over time, such as `RestToRest` or `PoseSpline`."""

    def at(self, t: Any) -> Target:
        """Return the target at time t [s]."""
        ...


@dataclass(frozen=True, eq=False)
class ObjectTracking(Frozen):
    """tau = M qdd + C + J^T f + what dampers and springs take, with qdd and f that give the object its acceleration.

    The commanded acceleration is the path's and a correction,
    alpha = alpha_d + damping (V_d - V) + stiffness [log(R_d R^T); p_d - p]; the error then
    obeys e'' + damping e' + stiffness e = 0. Bases are taken to stand still. The joints of a trunk are slowed down
    only, and its floating base goes where the arms push it.

    Attributes:
        chain: the chain as the controller knows it.
        path: t [s] -> where the object should be; or a path object, whose `at` is taken.
        squeeze: internal force of every arm along its contact normal, into the object [N].
        stiffness: of the pose error [1/s^2].
        damping: of the twist error [1/s]; 2 sqrt(stiffness) is critical.
        joint_damping: of joint motions that do not move the object, and of a trunk's [1/s].
    """

    chain: ClosedChain
    path: Callable[[float], Target] | ObjectPath
    squeeze: float = 0.0
    stiffness: float = 100.0
    damping: float = 20.0
    joint_damping: float = 10.0
    traceable: ClassVar[bool] = True  # becomes machine code, where the path is traceable too

    def __post_init__(self) -> None:
        checks.instance(self.chain, ClosedChain, "object tracking: chain")
        path = self.path if callable(self.path) else getattr(self.path, "at", None)
        if not callable(path):
            got = type(self.path).__name__
            raise ModelError(
                f"object tracking: path: expected a path such as RestToRest(...), or a function of time, got {got}"
            )
        object.__setattr__(self, "path", path)
        for name in ("squeeze", "stiffness", "damping", "joint_damping"):
            object.__setattr__(self, name, checks.number(getattr(self, name), f"object tracking: {name}"))

    def for_chain(self, chain: ClosedChain) -> Self:
        """Return the controller of a chain whose grasps have changed."""
        return replace(self, chain=chain)

    @np.errstate(all="ignore")  # what overflows is refused
    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques (n,) [N m or N]; the memory is not used.

        Raises:
            StateError: they overflow, or the state is none of the chain.
        """
        require_fit(self.chain, state)
        found = by_machine_code(self, t, state, memory)
        if found is not None:
            return found
        chain = self.chain
        acceleration = self.commanded_acceleration(t, state)
        wrenches = commanded_wrenches(chain, state, acceleration, self.squeeze)
        tau = computed_torque(chain, state, acceleration, wrenches, self.joint_damping)
        return checks.finite(tau, "object tracking"), memory

    def commanded_acceleration(self, t: float, state: State) -> Array:
        """Return [omega_dot; v_dot] of C that the object is to have, (6,) world axes."""
        target = cast(Callable[[float], Target], self.path)(t)
        frame = state.object_frame
        error = concatenate([rotation.log_below_pi(target.pose.R @ frame.R.T), target.pose.p - frame.p])
        return target.acceleration + self.damping * (target.twist - state.object_twist) + self.stiffness * error
