"""The arguments of a differentiable function: a chain, its state and its inputs, in which numbers can be replaced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.trunk import TRUNK, Trunk
from holdfast.questions.arrays import ARRAYS, value_of
from holdfast.spatial.frozen import changed
from holdfast.spatial.inertia import about_origin
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.vector import skew
from holdfast.state import Inputs, State

Body = TypeVar("Body", Link, HeldObject)
Numbers = Mapping[str, Array]
OF_INPUTS, OF_STATE = (
    {name: row.field for name, row in ARRAYS.items() if row.role == role and row.field and not row.is_pose}
    for role in ("input", "state")
)


class VariedCase(NamedTuple):
    """The arguments of a function to be differentiated.

    Attributes:
        chain: the chain.
        state: positions and velocities.
        inputs: shaped inputs, with link wrenches.
        own: further arguments of the function, by name.
    """

    chain: ClosedChain
    state: State
    inputs: Inputs
    own: Numbers

    def numbers(self, names: Sequence[str]) -> dict[str, Array]:
        """Return the named numbers; rows are arms, grasps or links, and rotations are matrices."""
        frame, floating = self.state.object_frame, self.state.base_frame or Pose.identity()
        own = {"object_R": frame.R, "object_p": frame.p, "floating_R": floating.R, "floating_p": floating.p, **self.own}
        found = {name: np.asarray(own[name] if name in own else self._number(name)) for name in names}
        return {name: x if x.dtype == object else x.astype(float) for name, x in found.items()}

    def _number(self, name: str) -> Any:
        if name in OF_STATE:
            return getattr(self.state, OF_STATE[name])
        return getattr(self.inputs, OF_INPUTS[name]) if name in OF_INPUTS else value_of(name, self.chain)

    def varied(self, numbers: Numbers) -> VariedCase:
        """Return the case with some numbers replaced by scalars of any kind; nothing is checked."""
        own = {name: numbers.get(name, x) for name, x in self.own.items()}
        return VariedCase(self._chain(numbers), self._state(numbers), self._inputs(numbers), own)

    def with_varied(self, what: str, tangents: Array) -> VariedCase:
        """Return the same with poses that turn and shift by tangents, which are zero but may vary.

        Args:
            what: whose poses: "base" for those of arms, "grasp" for those of contact frames.
            tangents: (arms, 6) or (grasps, 6), [turn; shift].
        """
        R, p = self.numbers((f"{what}_R", f"{what}_p")).values()
        turned = array([frame + skew(turn) @ frame for frame, turn in zip(R, tangents[:, :3], strict=True)])
        return self.varied({f"{what}_R": turned, f"{what}_p": p + tangents[:, 3:]})

    def _chain(self, numbers: Numbers) -> ClosedChain:
        given, arms, first = self.chain, {}, 0
        for i, (name, arm) in enumerate(given.arms.items()):
            base = _pose(arm.base, "base", numbers, i)
            arms[name] = _arm(arm, base, numbers, given.joints[name], first)
            first += arm.joint_count
        grasps = {
            name: grasp.standing_at(_pose(grasp.frame, "grasp", numbers, k))
            for k, (name, grasp) in enumerate(given.grasps.items())
        }
        held = varied_body(given.held_object, "object", numbers, ...)
        trunk = None if given.trunk is None else _trunk(given.trunk, numbers, given.joints[TRUNK])
        gravity = numbers.get("gravity", given.gravity)
        return changed(given, arms=arms, held_object=held, grasps=grasps, gravity=gravity, trunk=trunk)

    def _state(self, numbers: Numbers) -> State:
        given, base = self.state, self.state.base_frame
        frame = _pose(given.object_frame, "object", numbers, ...)
        base = None if base is None else _pose(base, "floating", numbers, ...)
        motion = {field: numbers[name] for name, field in OF_STATE.items() if name in numbers}
        return changed(given, **motion, object_frame=frame, base_frame=base)

    def _inputs(self, numbers: Numbers) -> Inputs:
        return changed(self.inputs, **{field: numbers[name] for name, field in OF_INPUTS.items() if name in numbers})


def _arm(arm: Arm, base: Pose, numbers: Numbers, rows: slice, first: int) -> Arm:
    """Return an arm with another base and other numbers for its joints (`rows`) and links (rows from `first`)."""
    made = arm.standing_at(base)
    links = enumerate(arm.links, first)
    made.__dict__.update(_of_joints(arm.joints, numbers, rows))
    made.__dict__["links"] = tuple(varied_body(link, "link", numbers, k) for k, link in links)
    return made


def _trunk(trunk: Trunk, numbers: Numbers, rows: slice) -> Trunk:
    """Return a trunk with other numbers for its joints and bodies."""
    own = _of_joints(trunk.joints, numbers, rows) if trunk.joints else {}
    floating, links = trunk.split([varied_body(body, "trunk_link", numbers, k) for k, body in enumerate(trunk.bodies)])
    made = {"joints": own.get("joints", trunk.joints), "links": links, "floating": floating}
    if trunk.serial is not None:
        made["serial"] = changed(trunk.serial, **own, links=links)
    return changed(trunk, **made)


def _of_joints(joints: Sequence[Joint], numbers: Numbers, rows: slice) -> dict[str, Any]:
    """Return what changes in a body of several joints with other numbers of these; nothing where none are given."""
    own = {name: numbers[name][rows] for name in ("armature", "damping") if name in numbers}
    if not own:
        return {}
    varied = [changed(joint, **{name: x[k] for name, x in own.items()}) for k, joint in enumerate(joints)]
    return {**own, "joints": tuple(varied)}


def varied_body(body: Body, what: str, numbers: Numbers, row: Any) -> Body:
    """Return a body with another mass, mass centre or inertia; the same body if none of them is given."""
    given = {name: numbers[f"{what}_{name}"] for name in ("mass", "com", "inertia") if f"{what}_{name}" in numbers}
    if not given:
        return body
    made = changed(body, **{name: x[row] for name, x in given.items()})
    mass = np.asarray(made.mass)[()]
    made.__dict__.update(mass=mass, spatial_inertia=about_origin(mass, made.com, made.inertia))
    return made


def _pose(pose: Pose, what: str, numbers: Numbers, row: Any) -> Pose:
    R, p = (numbers.get(f"{what}_{part}") for part in ("R", "p"))
    return Pose.unchecked(pose.R if R is None else R[row], pose.p if p is None else p[row])
