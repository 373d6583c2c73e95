"""The force elements of a chain: where their ends are, and what they exert, store and lose together.

The laws are those of the model: `model.spring`, or any other `ForceElement`, between points on bodies, whose wrenches
act as external wrenches; and `model.bushing` between a tip and a contact frame, whose wrench is that of a grasp.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics, link_twists, tip_twist
from holdfast.dynamics.closed.contact import Contact, contact
from holdfast.dynamics.trunk.trunk_motion import base_kinematics
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.bushing import Deflection
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.force_element import HELD_OBJECT, Deformation, EndMotion, SpringEnd
from holdfast.model.grasp import Grasp
from holdfast.model.trunk import TRUNK, bodies_of
from holdfast.spatial.frozen import changed
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, each_of
from holdfast.spatial.vector import cross
from holdfast.state import Inputs, State


def with_force_elements(chain: ClosedChain, state: State, inputs: Inputs) -> Inputs:
    """Return the inputs with the wrenches of the elements between bodies added. O(elements) + O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: shaped inputs (`Inputs.shaped`).

    Raises:
        StateError: the wrench of an element overflows.
    """
    if not chain.springs:
        return inputs
    assert inputs.object_wrench is not None
    of_object, of_links, of_trunk = inputs.object_wrench, inputs.link_wrenches, inputs.trunk_link_wrenches
    first = len(chain.joints_of.get(TRUNK, ()))
    rows = [np.zeros(6)] * (chain.joint_count - first) if of_links is None else list(of_links)
    bodies = [np.zeros(6)] * len(bodies_of(chain.trunk)) if of_trunk is None else list(of_trunk)
    motions = end_motions(chain, state, inputs)
    for k, (element, of_ends, one) in enumerate(zip(chain.springs, motions, _between(chain, motions), strict=True)):
        name = f"wrench of spring {k}, from '{element.a.body}' to '{element.b.body}'"
        for end, motion, load in zip(element.ends, of_ends, one.loads(), strict=True):
            wrench = checks.finite(motion.wrench(load), name)
            if end.on_arm:
                row = chain.joints[end.body].start - first + end.link_number()
                rows[row] = rows[row] + wrench
            elif end.on_trunk:
                body = _trunk_body(chain, end)
                bodies[body] = bodies[body] + wrench
            elif end.body == HELD_OBJECT:
                of_object = of_object + wrench
    on_trunk = {"trunk_link_wrenches": array(bodies)} if bodies else {}
    return replace(inputs, object_wrench=of_object, link_wrenches=array(rows), **on_trunk)


def without_force_elements(chain: ClosedChain) -> ClosedChain:
    """Return the same chain, of any kind of numbers, without elements between bodies; nothing is checked."""
    return changed(chain, springs=())


def stored_energies(chain: ClosedChain, state: State) -> Iterator[Scalar]:
    """Yield the energy of all elements between bodies, then that of all bushings [J]. O(elements) + O(n)."""
    still = Inputs().shaped(chain)
    for acting in (deformations, deflections):
        yield sum(one.energy() for one in acting(chain, state, still))


def losses(chain: ClosedChain, state: State, inputs: Inputs) -> Iterator[Scalar]:
    """Yield the power dissipated by all elements between bodies, then by all bushings [W]; the inputs are shaped."""
    for acting in (deformations, deflections):
        yield sum(one.loss() for one in acting(chain, state, inputs))


def deformations(chain: ClosedChain, state: State, inputs: Inputs) -> list[Deformation]:
    """Return every element between bodies at one instant; see `end_motions`."""
    return _between(chain, end_motions(chain, state, inputs))


def _between(chain: ClosedChain, motions: list[tuple[EndMotion, EndMotion]]) -> list[Deformation]:
    return [element.between(a, b) for element, (a, b) in zip(chain.springs, motions, strict=True)]


def end_motions(chain: ClosedChain, state: State, inputs: Inputs) -> list[tuple[EndMotion, EndMotion]]:
    """Return the motion of both ends of every element between bodies, in order. O(elements) + O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: shaped inputs, of which only the base motion matters.
    """
    if not chain.springs:
        return []
    at, ends = base_kinematics(chain, state, inputs), [end for element in chain.springs for end in element.ends]
    on_arm = {name: tuple([end for end in ends if end.on_arm and end.body == name]) for name in chain.arms}
    names = [name for name, attached in on_arm.items() if attached]
    found = each_of(names, ends_on_arm, at.arms, at.q, at.qd, at.base_twists, on_arm)
    placed = {name: iter(of_arm) for name, of_arm in found.items()}

    def of(end: SpringEnd) -> EndMotion:
        if end.on_arm:
            return next(placed[end.body])
        if end.on_trunk:
            body = at.trunk.bodies[_trunk_body(chain, end)]
            return _on_body(end.point, body.frame, body.twist)
        if end.body == HELD_OBJECT:
            return _on_body(end.point, state.object_frame, state.object_twist)
        return EndMotion(end.point, end.point, np.zeros(3), np.eye(3), np.zeros(3))

    every = iter([of(end) for end in ends])
    return list(zip(every, every, strict=True))


def ends_on_arm(arm: Arm, q: Array, qd: Array, base_twist: Array, attached: Sequence[SpringEnd]) -> list[EndMotion]:
    """Return the motion of ends that are on the links of one arm."""
    at = forward_kinematics(arm, q)
    twists = link_twists(arm, at, qd, base_twist)
    found = []
    for end in attached:
        R, V = at.R[end.link_number()], twists[end.link_number()]
        lever = R @ end.point
        position = at.tip.p - at.reach[end.link_number()] + lever
        found.append(EndMotion(lever, position, R @ (V[3:] + cross(V[:3], end.point)), R, R @ V[:3]))
    return found


def _trunk_body(chain: ClosedChain, end: SpringEnd) -> int:
    """Return the index in `Trunk.bodies` of the body that an end is on."""
    assert chain.trunk is not None
    return chain.trunk.body(end.link, "spring")


def _on_body(point: Array, frame: Pose, twist: Array) -> EndMotion:
    """Return the motion of an end on a body whose origin has the given twist (6,), in world axes."""
    lever = frame.R @ point
    return EndMotion(lever, frame.p + lever, twist[3:] + cross(twist[:3], lever), frame.R, twist[:3])


def deflection(c: Contact) -> Deflection:
    """Return the deflection of a contact that is a bushing."""
    bushing = c.grasp.of_kind.bushing
    assert bushing is not None
    Q, p = c.R.T @ c.frame, (c.origin - c.offset) @ c.R
    return bushing.deflection(Q, p, c.W, c.R)


def deflections(chain: ClosedChain, state: State, inputs: Inputs) -> list[Deflection]:
    """Return the deflections of all bushings at one instant, in the order of the chain's grasps. O(n).

    Args:
        chain: the chain.
        state: positions and velocities.
        inputs: shaped inputs, of which only the base motion matters.
    """
    if not chain.bushings:
        return []
    at, frame, twist = base_kinematics(chain, state, inputs), state.object_frame, state.object_twist

    def of_arm(arm: Arm, q: Array, qd: Array, base_twist: Array, grasp: Grasp) -> Deflection:
        at = forward_kinematics(arm, q)
        of_tip = tip_twist(arm, at, link_twists(arm, at, qd, base_twist), base_twist)
        return deflection(contact(grasp, frame, twist, at.tip, of_tip))

    return list(each_of(chain.bushings, of_arm, at.arms, at.q, at.qd, at.base_twists, chain.grasps).values())
