"""The state of a closed chain, and its inputs other than the joint torques."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.forest import Forest
from holdfast.model.serial_chain import serial_chain
from holdfast.names import called
from holdfast.spatial.frozen import (
    NOT_GIVEN,
    REQUIRED,
    ArrayField,
    Converted,
    Frozen,
    OptionalArrayField,
    frozen_property,
    making,
)
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


@called
@dataclass(frozen=True, eq=False)
class State(Frozen):
    """Positions and velocities of the whole chain.

    Attributes:
        q: (n,) joint positions, first those of a trunk, then those of the arms in order, base to tip [rad or m]. A
            spherical joint has a unit quaternion wxyz.
        qd: (n,) joint rates [rad/s or m/s]; three of a spherical joint.
        object_pose: (7,) pose wxyz_xyz of the object frame (origin C) in the world; (k, 7) for a chain with k objects,
            in order.
        object_twist: (6,) [omega; v of C], world axes [rad/s, m/s]; (k, 6) with (k, 7) poses.
        base_pose: (7,) pose wxyz_xyz of a floating base's frame in the world; None without one.
        base_twist: (6,) [omega; v of that frame's origin], world axes; None without one.
    """

    q: ArrayField = REQUIRED
    qd: ArrayField = REQUIRED
    object_pose: Converted[Array, Pose | ArrayLike] = NOT_GIVEN
    object_twist: ArrayField = field(default_factory=making(np.zeros, 6))
    base_pose: Converted[Array | None, Pose | ArrayLike | None] = NOT_GIVEN
    base_twist: OptionalArrayField = NOT_GIVEN

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "q", checks.vector(self.q, "state: q", StateError))
        qd, n = checks.numbers(self.qd, None, "state: qd", StateError), len(self.q)
        spherical = qd.ndim == 1 and n - n // 4 <= len(qd) < n  # joints have one rate less than positions
        put(self, "qd", qd if qd.shape == (n,) or spherical else checks.numbers(qd, (n,), "state: qd", StateError))
        if self.object_pose is None or _are_several(self.object_pose):
            self._set_objects()
        else:
            put(self, "object_pose", _pose(self.object_pose, "state: object_pose"))
            put(self, "object_twist", checks.numbers(self.object_twist, (6,), "state: object_twist", StateError))
        if self.base_pose is not None:
            put(self, "base_pose", _pose(self.base_pose, "state: base_pose"))
            twist = np.zeros(6) if self.base_twist is None else self.base_twist
            put(self, "base_twist", checks.numbers(twist, (6,), "state: base_twist", StateError))
        elif self.base_twist is not None:
            raise StateError("state: base_twist: expected the pose of the floating base with it, got no base_pose")

    def _set_objects(self) -> None:
        """Check the poses and twists of several objects, or of none."""
        put, given = object.__setattr__, () if self.object_pose is None else self.object_pose
        poses = [_pose(one, f"state: object_pose[{k}]") for k, one in enumerate(given)]  # pyright: ignore
        twists = checks.numbers(self.object_twist, None, "state: object_twist", StateError)
        if twists.dtype != object and not twists.any():  # the default is that of one object
            twists = np.zeros((len(poses), 6))
        put(self, "object_pose", checks.read_only(np.array(poses).reshape(-1, 7)))
        put(self, "object_twist", checks.numbers(twists, (len(poses), 6), "state: object_twist", StateError))

    def __repr__(self) -> str:
        """Return the number of joints, the object's position, and whether anything moves, on one line."""
        rates = [x for x in (self.qd, self.object_twist, self.base_twist) if x is not None]
        known = all(x.dtype != object for x in rates)
        moves = "" if not known else ", in motion" if any(x.any() for x in rates) else ", at rest"
        floats = "" if self.base_pose is None else f", floating base at {checks.place(self.base_pose[4:])} m"
        objects = [f", object at {checks.place(pose[4:])} m" for pose in np.reshape(self.object_pose, (-1, 7))]
        return f"<State: {len(self.qd)} joints{''.join(objects)}{floats}{moves}>"

    @frozen_property
    def object_frame(self) -> Pose:
        """The object's pose as rotation and origin."""
        if self.object_pose.ndim > 1:
            raise StateError(
                f"state: object_frame: expected one object, got {len(self.object_pose)}; try object_pose[k]"
            )
        return Pose.unchecked_seven(self.object_pose)

    @property
    def object_frames(self) -> list[Pose]:
        """The poses of all objects, in order."""
        return [Pose.unchecked_seven(pose) for pose in np.reshape(self.object_pose, (-1, 7))]

    @frozen_property
    def base_frame(self) -> Pose | None:
        """The floating base's pose as rotation and origin; None without one."""
        return None if self.base_pose is None else Pose.unchecked_seven(self.base_pose)

    def at_rest(self) -> State:
        """Return the same positions without velocities."""
        return State(self.q, 0.0 * self.qd, self.object_pose, base_pose=self.base_pose)

    def fits(self, chain: ClosedChain) -> None:
        """Check that the state fits a chain.

        Raises:
            StateError: the number of joints or objects differs, or the pose of a floating base is missing or
                superfluous.
        """
        if len(self.q) != chain.position_count or len(self.qd) != chain.joint_count:
            what, given, parts = "rates", self.qd, chain.joints
            if len(self.q) != chain.position_count:
                what, given, parts = "positions", self.q, chain.positions
            counts = {name: part.stop - part.start for name, part in parts.items()}
            listed = ", ".join(f"{name}: {count}" for name, count in counts.items())
            name = "q" if what == "positions" else "qd"
            raise StateError(
                f"state: {name}: expected {sum(counts.values())} joint {what} ({listed}), got {len(given)}"
            )
        if self.object_pose.shape != (7,) or len(chain.free_objects) != 1:
            count, several = len(chain.free_objects), self.object_pose.ndim > 1
            if self.object_pose.size != 7 * count or (several and not chain.beyond_serial):
                shape = "(7,)" if count == 1 else f"({count}, 7)"
                got = str(self.object_pose.shape) if self.object_pose.size else "none; hf.assemble finds it from q"
                raise StateError(f"state: object_pose: expected shape {shape}, got {got}")
        if chain.floats and self.base_pose is None:
            raise StateError("state: base_pose: expected the pose of the trunk's floating base, got none")
        if self.base_pose is not None and not chain.floats:
            raise StateError("state: base_pose: expected none, as the chain has no floating base")


def require_fit(chain: Any, state: Any) -> None:
    """Refuse what is no chain, what is no state, and a state of another chain.

    Raises:
        ModelError, StateError: naming what came instead.
    """
    if isinstance(chain, Forest):
        raise ModelError(
            "chain: expected ClosedChain, got Forest, which answers holdfast.dynamics.forest_dynamics only"
        )
    serial_chain(chain, "chain")
    require_state(chain, state)


def require_state(chain: ClosedChain, state: Any) -> None:
    """Refuse what is no state, and a state of another chain.

    Raises:
        StateError: naming what came instead.
    """
    checks.instance(state, State, "state", StateError)
    state.fits(chain)


def shaped_inputs(chain: ClosedChain, inputs: Inputs | None) -> Inputs:
    """Return what acts on a chain as checked arrays of its shapes; nothing by default.

    Raises:
        StateError: no inputs, or those of another chain.
    """
    if inputs is None:
        return Inputs().shaped(chain)
    checks.instance(inputs, Inputs, "inputs", StateError)
    return inputs.shaped(chain)


def parts_of(state: State) -> dict[str, Array]:
    """Return the arrays of a state by field, including those of a floating base if there is one."""
    every = {field.name: getattr(state, field.name) for field in fields(state)}
    return {name: x for name, x in every.items() if x is not None}


def exact_state(parts: Mapping[str, Array]) -> State:
    """Return a state with exactly the given arrays of another state.

    The quaternions are not normalised again, which could change their last bit.

    Args:
        parts: arrays by field, including those of a floating base if there is one.
    """
    state = State(**parts)
    for pose in ("object_pose", "base_pose"):
        if pose in parts:
            object.__setattr__(state, pose, checks.read_only(parts[pose]))
    return state


def found_state(parts: Mapping[str, Array]) -> State:
    """Return a state of arrays that machine code has checked, and that are not shared; see `exact_state`."""
    state = object.__new__(State)
    vars(state).update({"base_pose": None, "base_twist": None})
    vars(state).update({name: checks.read_only(x) for name, x in parts.items()})
    return state


def _are_several(poses: Any) -> bool:
    """Return whether what is given is a list of poses, or an array of them."""
    if isinstance(poses, np.ndarray):
        return poses.ndim == 2
    listed = isinstance(poses, list | tuple)
    return listed and all(isinstance(one, Pose | list | tuple) or getattr(one, "ndim", 0) == 1 for one in poses)


def _pose(given: Any, what: str) -> Array:
    """Return a pose as a checked unit quaternion and a position, (7,)."""
    pose = given.wxyz_xyz if isinstance(given, Pose) else given
    pose = checks.numbers(pose, (7,), what, StateError)
    if pose.dtype == object:
        return pose
    length = math.hypot(*pose[:4])
    if abs(length - 1) > checks.ROTATION_TOLERANCE:
        raise StateError(f"{what}: expected a unit quaternion (w, x, y, z) first, got length {length:.9g}")
    if abs(length - 1) <= checks.ROUNDED:  # the pose of another state is not changed
        return pose
    return checks.read_only(np.concatenate([pose[:4] / length, pose[4:]]))


@called
@dataclass(frozen=True, eq=False)
class Inputs(Frozen):
    """The inputs of the chain other than the joint torques; everything is zero by default.

    Attributes:
        object_wrench: (6,) external wrench on the object about C, world axes [N m, N]; (k, 6) for k objects.
        link_wrenches: (n, 6) external wrench on each link of the arms about its frame's origin, world axes.
        base_twists: (arms, 6) prescribed velocity of each base's origin, world axes; 0 for arms on a trunk.
        base_accelerations: (arms, 6) their derivatives [omega_dot; v_dot]; 0 for arms on a trunk.
        trunk_base_twist: (6,) prescribed velocity of the origin of a trunk's base in the world, world axes.
        trunk_base_acceleration: (6,) its derivative [omega_dot; v_dot].
        trunk_link_wrenches: (bodies, 6) external wrench on each body of the trunk about its frame's origin, world
            axes, beginning with a floating base.
    """

    object_wrench: OptionalArrayField = NOT_GIVEN
    link_wrenches: OptionalArrayField = NOT_GIVEN
    base_twists: OptionalArrayField = NOT_GIVEN
    base_accelerations: OptionalArrayField = NOT_GIVEN
    trunk_base_twist: OptionalArrayField = NOT_GIVEN
    trunk_base_acceleration: OptionalArrayField = NOT_GIVEN
    trunk_link_wrenches: OptionalArrayField = NOT_GIVEN

    def __post_init__(self) -> None:
        for name, given in vars(self).items():
            if given is not None:  # `shaped` checks the shape
                object.__setattr__(self, name, checks.numbers(given, None, f"inputs: {name}", StateError))

    def shaped(self, chain: ClosedChain) -> Inputs:
        """Return the inputs as checked arrays of the chain's shapes; link wrenches and trunk inputs may stay None."""
        l, n, k = len(chain.arms), sum(arm.joint_count for arm in chain.arms.values()), len(chain.free_objects)
        shaped = Inputs(
            self._array("object_wrench", (6,) if k == 1 else (k, 6)),
            None if self.link_wrenches is None else self._array("link_wrenches", (n, 6)),
            self._array("base_twists", (l, 6)),
            self._array("base_accelerations", (l, 6)),
        )
        return shaped if chain.trunk is None and not self._of_trunk else self._with_trunk(shaped, chain)

    def _array(self, name: str, shape: tuple[int, ...]) -> Array:
        """Return a given field, checked, or zeros."""
        given = getattr(self, name)
        return np.zeros(shape) if given is None else checks.numbers(given, shape, f"inputs: {name}", StateError)

    @property
    def _of_trunk(self) -> list[str]:
        """The given fields that concern a trunk."""
        names = ("trunk_base_twist", "trunk_base_acceleration", "trunk_link_wrenches")
        return [name for name in names if getattr(self, name) is not None]

    def _with_trunk(self, shaped: Inputs, chain: ClosedChain) -> Inputs:
        """Return the inputs completed by those of the trunk.

        Raises:
            StateError: a shape is wrong, or an input does not apply to the chain's trunk.
        """
        trunk = chain.trunk
        if trunk is None:
            raise StateError(f"inputs: {self._of_trunk[0]}: expected none, as the chain has no trunk")
        assert shaped.base_twists is not None and shaped.base_accelerations is not None
        for what in ("base_twists", "base_accelerations"):
            rows = getattr(shaped, what)
            moved = [name for i, name in enumerate(chain.arms) if name in chain.mounts and any(rows[i] != 0.0)]
            if moved:
                raise StateError(
                    f"inputs: {what}: arm '{moved[0]}' moves with the trunk on which it is mounted; expected zeros"
                )
        for what in self._of_trunk:
            if trunk.floating is not None and what != "trunk_link_wrenches":
                raise StateError(
                    f"inputs: {what}: expected none, as the trunk's base floats: its motion is in the state"
                )
        shapes: dict[str, tuple[int, ...]] = {"trunk_link_wrenches": (len(trunk.bodies), 6)}
        if trunk.floating is None:
            shapes |= {"trunk_base_twist": (6,), "trunk_base_acceleration": (6,)}
        return replace(shaped, **{name: self._array(name, shape) for name, shape in shapes.items()})
