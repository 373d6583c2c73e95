"""The state of a closed chain, and what acts on it besides the joint torques."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.converted import NOT_GIVEN, ArrayField, Converted, OptionalArrayField, making
from holdfast.spatial.frozen import Frozen, frozen_property
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class State(Frozen):
    """Positions and velocities of the whole chain.

    Attributes:
        q: (n,) joint positions, arms in the chain's order, base to tip [rad or m].
        qd: (n,) joint rates [rad/s or m/s].
        object_pose: (7,) wxyz_xyz of the object frame (origin C) in the world.
        object_twist: (6,) [omega; v of C], world axes [rad/s, m/s].
    """

    q: ArrayField
    qd: ArrayField
    object_pose: Converted[Array, Pose | ArrayLike]
    object_twist: ArrayField = field(default_factory=making(np.zeros, 6))

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "q", checks.vector(self.q, "state: q", StateError))
        put(self, "qd", checks.numbers(self.qd, self.q.shape, "state: qd", StateError))
        pose = self.object_pose.wxyz_xyz if isinstance(self.object_pose, Pose) else self.object_pose
        pose = checks.numbers(pose, (7,), "state: object_pose", StateError)
        if pose.dtype != object:
            length = math.hypot(*pose[:4])
            if abs(length - 1) > checks.ROTATION_TOLERANCE:
                raise StateError(
                    f"state: object_pose: expected a unit quaternion (w, x, y, z) first, got length {length:.9g}"
                )
            if abs(length - 1) > checks.ROUNDED:  # the pose of another state keeps its bits
                pose = checks.read_only(np.concatenate([pose[:4] / length, pose[4:]]))
        put(self, "object_pose", pose)
        put(self, "object_twist", checks.numbers(self.object_twist, (6,), "state: object_twist", StateError))

    @frozen_property
    def object_frame(self) -> Pose:
        """The object's pose as rotation and origin."""
        return Pose.unchecked_seven(self.object_pose)

    def fits(self, chain: ClosedChain) -> None:
        """Refuse the state if its length is not the chain's.

        Raises:
            StateError: naming both lengths.
        """
        if len(self.q) != chain.joint_count:
            raise StateError(
                f"state: q: expected {chain.joint_count} joint positions"
                f" ({', '.join(f'{n}: {a.joint_count}' for n, a in chain.arms.items())}), got {len(self.q)}"
            )


@dataclass(frozen=True, eq=False)
class Inputs(Frozen):
    """What acts on the chain besides the joint torques; everything is zero by default.

    Attributes:
        object_wrench: (6,) external wrench on the object about C, world axes [N m, N].
        link_wrenches: (n, 6) external wrench on each link about its frame's origin, world axes.
        base_twists: (arms, 6) prescribed velocity of each base's origin, world axes.
        base_accelerations: (arms, 6) its plain derivative [omega_dot; v_dot].
    """

    object_wrench: OptionalArrayField = NOT_GIVEN
    link_wrenches: OptionalArrayField = NOT_GIVEN
    base_twists: OptionalArrayField = NOT_GIVEN
    base_accelerations: OptionalArrayField = NOT_GIVEN

    def __post_init__(self) -> None:
        for name, given in vars(self).items():
            if given is not None:  # `shaped` asks for its shape
                object.__setattr__(self, name, checks.numbers(given, None, f"inputs: {name}", StateError))

    def shaped(self, chain: ClosedChain) -> Inputs:
        """Return the inputs as checked arrays of the chain's shapes; only link wrenches stay None."""
        l, n = len(chain.arms), chain.joint_count

        def arr(value: Array | None, shape: tuple[int, ...], what: str) -> Array:
            return np.zeros(shape) if value is None else checks.numbers(value, shape, what, StateError)

        return Inputs(
            arr(self.object_wrench, (6,), "inputs: object_wrench"),
            None if self.link_wrenches is None else arr(self.link_wrenches, (n, 6), "inputs: link_wrenches"),
            arr(self.base_twists, (l, 6), "inputs: base_twists"),
            arr(self.base_accelerations, (l, 6), "inputs: base_accelerations"),
        )
