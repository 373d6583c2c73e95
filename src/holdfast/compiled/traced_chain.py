"""A chain whose run-time parameters are traced nodes; functions of `dynamics` are run on it to record them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from holdfast.compiled.structure import Structure
from holdfast.compiler.composition import Composition
from holdfast.compiler.constant import Constant, constants
from holdfast.compiler.derivation import derived
from holdfast.compiler.node import Node
from holdfast.compiler.schedule import External, ExternalRole, Schedule
from holdfast.compiler.targets import cpu
from holdfast.compiler.trace import inputs, tracing
from holdfast.dynamics.arm.regrouping import regrouped
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.force_element import ForceElement, SpringEnd
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.trunk import Trunk
from holdfast.questions.arrays import BASE_MOTION, FLOATING, LINKS, TRUNK_BASE_MOTION, TRUNK_LINKS, Shape, link_rows
from holdfast.spatial import rotation
from holdfast.spatial.frozen import changed
from holdfast.spatial.pose import Pose
from holdfast.spatial.real_numbers import ROTATION_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, loops, sqrt, where
from holdfast.state import Inputs, State

Given = Mapping[str, Array]  # the caller's arrays, traced


def externals(
    inputs: Iterable[str], parameters: Iterable[str], outputs: Iterable[str], shape: Mapping[str, Shape]
) -> dict[str, External]:
    """Return a computation's arrays: inputs, then parameters, then outputs."""
    roles: tuple[tuple[ExternalRole, Iterable[str]], ...] = (
        ("input", inputs), ("parameter", parameters), ("output", outputs)
    )  # fmt: skip
    return {name: External(shape[name], role) for role, names in roles for name in names}


def traced(
    externals: Mapping[str, External],
    function: Callable[[Given], Mapping[str, Any]],
    status: str | None = None,
    guarded: tuple[str, ...] = (),
) -> Schedule:
    """Return the schedule of a function that takes the traced arrays and returns the outputs by name."""
    composition = Composition()
    given: dict[str, Array] = {}
    numbers: dict[str, tuple[Node, ...]] = {}
    for name, external in externals.items():
        if external.role != "output":
            given[name] = inputs(composition.graph, external.shape)
            numbers[name] = tuple(given[name].flat)
            if external.role == "parameter":
                composition.parameters.update(numbers[name])
    token = loops.set(composition)
    try:
        with tracing():
            found = function(given)
    finally:
        loops.reset(token)
    outputs = {name: list(np.asarray(found[name], dtype=object).flat) for name, e in externals.items() if name in found}
    assert all(len(x) == math.prod(externals[name].shape) for name, x in outputs.items())
    # On a processor without fma every fma would be a library call, so products and sums are not fused.
    whole = tuple(name for name in guarded if externals[name].size)  # machine code would write one number of no array
    schedule = derived(composition, externals, numbers, outputs, status, whole, fused=cpu.has_fma())
    composition.clear()
    return schedule


def traced_chain(structure: Structure, given: Given) -> ClosedChain:
    """Return the chain with traced run-time parameters; values that are not given are placeholders.

    Grasps and link inertias are omitted if the computation does not depend on them, so that arms that differ only in
    these have the same type.
    """
    chain = structure.chain
    arms: dict[str, Arm] = {}
    of_type: dict[str, Arm] = {}  # arms of one type share one object, which the tracer visits only once
    links_of = link_rows(chain)
    for i, (name, arm) in enumerate(chain.arms.items()):
        key = structure.type_of[name]
        constant = of_type.get(key) or of_type.setdefault(key, _with_constants(arm, structure))
        made = constant
        if structure.by_links and structure.options.link_inertia:
            made = constant.of(links=_traced_links(*(given[parameter][links_of[name]] for parameter in LINKS)))
        arms[name] = changed(made, base=_pose(given, "base", i), name="")
    held = enumerate(chain.grasps.items() if structure.by_grasp else ())
    grasps = {name: grasp.standing_at(_pose(given, "grasp", i)) for i, (name, grasp) in held}
    body = chain.held_object
    if "object_mass" in given:
        mass: Scalar = given["object_mass"][()]
        body = HeldObject(mass, given["object_inertia"], given["object_com"], physical=False)
    other = object.__new__(ClosedChain)  # without the cached properties of the real chain
    gravity = given.get("gravity", np.zeros(3))
    own = {"arms": arms, "held_object": body, "grasps": grasps, "gravity": gravity, "mounts": chain.mounts}
    own["trunk"] = None if chain.trunk is None else _traced_trunk(chain.trunk, given)
    own["springs"] = tuple(_constant_element(element) for element in chain.springs)
    other.__dict__.update(own, objects={}, loops={}, couplings=())
    return other


def traced_state(chain: ClosedChain, given: Given) -> State:
    """Return the traced state, with the frames that `framed` adds."""
    n, twist = chain.joint_count, given.get("object_twist", np.zeros(6))
    pose = given.get("object_pose", np.eye(7)[0])
    floating = (given.get(name) for name in FLOATING)
    return framed(State(given.get("q", np.zeros(n)), given.get("qd", np.zeros(n)), pose, twist, *floating))


def framed(state: State) -> State:
    """Return the state with the frames of object and floating base, NaN if a quaternion is not of unit length."""
    vars(state)["object_frame"] = unit_pose(state.object_pose, state.object_twist[3:])
    if state.base_pose is not None and state.base_twist is not None:
        vars(state)["base_frame"] = unit_pose(state.base_pose, state.base_twist[3:])
    return state


def unit_pose(wxyz_xyz: Array, unused: Iterable[Scalar]) -> Pose:
    """Return a pose; its rotation is NaN if its quaternion is not of unit length within 1e-6.

    It is also NaN if the origin or any of the `unused` numbers is not finite, because results that do not depend on
    them would not show the error.
    """
    length = quaternion_length(wxyz_xyz[:4])
    for x in (*wxyz_xyz[4:], *unused):
        length = where(abs(x) < float("inf"), length, float("nan"))
    return Pose.unchecked(rotation.from_quaternion(wxyz_xyz[:4] / length), wxyz_xyz[4:])


def quaternion_length(wxyz: Array) -> Scalar:
    """Return the length of a quaternion; NaN if it is not 1 within 1e-6."""
    length = sqrt(sum(x * x for x in wxyz))
    return where(abs(length - 1.0) <= ROTATION_TOLERANCE, length, float("nan"))


def traced_inputs(chain: ClosedChain, given: Given) -> Inputs:
    """Return the traced inputs besides joint torques: external wrenches and base motion."""
    still = np.zeros((len(chain.arms), 6))
    twists, accelerations = (given.get(name, still) for name in BASE_MOTION)
    of_trunk: dict[str, Array | None] = {"trunk_link_wrenches": given.get("trunk_link_wrench")}
    if chain.trunk is not None and not chain.floats:
        of_trunk |= {name: given.get(name, np.zeros(6)) for name in TRUNK_BASE_MOTION}
    return Inputs(given.get("object_wrench", np.zeros(6)), given.get("link_wrench"), twists, accelerations, **of_trunk)


def _pose(given: Given, what: str, i: int) -> Pose:
    R, p = given.get(f"{what}_R"), given.get(f"{what}_p")
    return Pose.unchecked(np.eye(3) if R is None else R[i], np.zeros(3) if p is None else p[i])


def _traced_links(masses: Array, coms: Array, inertias: Array) -> tuple[Link, ...]:
    """Return links whose inertias are traced parameters."""
    rows = zip(masses, coms, inertias, strict=True)
    return tuple(replace(Link(0.0, com, I, physical=False), mass=m) for m, com, I in rows)


def _with_constants(arm: Arm, structure: Structure) -> Arm:
    """Return the arm with its fixed numbers as `Constant`, so that no BLAS computes their products.

    Names and limits, which no algorithm uses, are omitted, so that arms that differ only in these have the same type.
    """
    if not structure.by_links:
        joints = [_constant_joint(joint) for joint in arm.joints]
        return replace(arm.of(joints, (Link(0.0),) * arm.joint_count), tip=constant_pose(arm.tip), visuals=None)
    return constant_arm(arm, regroup=not structure.options.link_inertia)


def constant_arm(arm: Arm, *, regroup: bool = True) -> Arm:
    """Return an arm with its numbers as `Constant`, and with inertias regrouped among its links; see `regrouped`."""
    joints, links = [_constant_joint(joint) for joint in arm.joints], [constant_link(link) for link in arm.links]
    made = replace(arm.of(joints, links), tip=constant_pose(arm.tip), visuals=None)
    return regrouped(made) if regroup else made


def _traced_trunk(trunk: Trunk, given: Given) -> Trunk:
    """Return the trunk with its numbers as `Constant`, except inertias of its bodies that are traced parameters."""
    made = object.__new__(Trunk)
    joints = tuple(_constant_joint(joint) for joint in trunk.joints)
    if TRUNK_LINKS[0] in given:
        bodies = _traced_links(*(given[name] for name in TRUNK_LINKS))
    else:
        bodies = tuple(constant_link(body) for body in trunk.bodies)
    floating, links = trunk.split(bodies)
    named = zip(links, trunk.links, strict=True)  # arms are mounted by name
    links = tuple(replace(link, name=earlier.name) for link, earlier in named)
    made.__dict__.update(joints=joints, links=links, base=constant_pose(trunk.base), floating=floating)
    return made


def _constant_joint(joint: Joint) -> Joint:
    plain = Joint(joint.kind, constants(joint.axis), constant_pose(joint.placement), pitch=joint.pitch)
    numbers = {name: Constant(getattr(joint, name)) for name in ("armature", "damping", "stiffness", "rest")}
    return replace(plain, **numbers)


def constant_link(link: Link) -> Link:
    """Return a link with its numbers as `Constant`."""
    plain = Link(link.mass, constants(link.com), constants(link.inertia), physical=False)
    return replace(plain, mass=Constant(link.mass))


def _constant_element(element: ForceElement) -> ForceElement:
    def constant(value: Any) -> Any:
        if isinstance(value, SpringEnd):
            return replace(value, point=constants(value.point))
        if isinstance(value, np.ndarray):
            return constants(value)
        return Constant(value) if isinstance(value, float) else value

    return replace(element, **{field.name: constant(getattr(element, field.name)) for field in fields(element)})


def constant_pose(pose: Pose) -> Pose:
    """Return a pose with its numbers as `Constant`."""
    return Pose(constants(pose.R), constants(pose.p))
