"""The same physics described otherwise: mirrored, turned, in other frames or units, arms in another order."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast import Arm, Grasp, HeldObject, Inputs, Link, Pose, State
from tests.systems.as_chain import Problem

# every body's own axes are mirrored along their x, so that frames stay right-handed
LOCAL = np.diag([-1.0, 1.0, 1.0])


def both(moment_map: np.ndarray, force_map: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return [moment_map a; force_map b] for rows [a; b]."""
    return np.concatenate([x[..., :3] @ moment_map.T, x[..., 3:] @ force_map.T], axis=-1)


def given(p: Problem, rotational: np.ndarray, linear: np.ndarray) -> Inputs:
    """Return the inputs with angular and linear parts mapped."""
    inputs = vars(p.inputs.shaped(p.chain)).items()
    return Inputs(**{name: both(rotational, linear, x) for name, x in inputs if x is not None})


def with_arms(p: Problem, names: list[str]) -> Problem:
    """Return the same system with these arms only, in this order."""
    chain, state, old = p.chain, p.state, p.inputs.shaped(p.chain)
    joints = np.concatenate([np.arange(len(p.tau))[chain.joints[name]] for name in names])
    rows = [chain.names.index(name) for name in names]
    grasps = {name: chain.grasps[name] for name in names if name in chain.grasps}
    return Problem(
        replace(chain, arms={name: chain.arms[name] for name in names}, grasps=grasps),
        State(state.q[joints], state.qd[joints], state.object_pose, state.object_twist),
        p.tau[joints],
        Inputs(old.object_wrench, old.link_wrenches[joints], old.base_twists[rows], old.base_accelerations[rows]),
    )


def mirrored(p: Problem, normal: np.ndarray) -> tuple[Problem, np.ndarray]:
    """Return the mirror image in the plane through the origin, and the reflection S.

    Points and forces go to S x; axial vectors (angular velocities, moments) to -S x.
    """
    S = np.eye(3) - 2 * np.outer(normal, normal)
    chain, body = p.chain, p.chain.held_object

    def local(pose: Pose) -> Pose:
        return Pose(LOCAL @ pose.R @ LOCAL, LOCAL @ pose.p)

    def in_world(pose: Pose) -> Pose:
        return Pose(S @ pose.R @ LOCAL, S @ pose.p)

    def of_arm(arm: Arm) -> Arm:
        joints = [
            replace(j, axis=(-LOCAL if j.kind == "revolute" else LOCAL) @ j.axis, placement=local(j.placement))
            for j in arm.joints
        ]
        links = [Link(k.mass, LOCAL @ k.com, LOCAL @ k.inertia @ LOCAL) for k in arm.links]
        return replace(arm, joints=joints, links=links, tip=local(arm.tip), base=in_world(arm.base))

    image = replace(
        chain,
        arms={name: of_arm(arm) for name, arm in chain.arms.items()},
        held_object=HeldObject(body.mass, LOCAL @ body.inertia @ LOCAL, LOCAL @ body.com),
        grasps={name: Grasp(grasp.kind, local(grasp.frame)) for name, grasp in chain.grasps.items()},
        gravity=S @ chain.gravity,
    )
    state = State(p.state.q, p.state.qd, in_world(p.state.object_frame), both(-S, S, p.state.object_twist))
    return Problem(image, state, p.tau, given(p, -S, S)), S


def turned(p: Problem, Q: np.ndarray, t: np.ndarray) -> Problem:
    """Return the whole scene turned by Q about the origin and then shifted by t, gravity with it."""
    chain, world = p.chain, Pose(Q, t)
    arms = {name: arm.at(world @ arm.base) for name, arm in chain.arms.items()}
    state = State(p.state.q, p.state.qd, world @ p.state.object_frame, both(Q, Q, p.state.object_twist))
    return Problem(replace(chain, arms=arms, gravity=Q @ chain.gravity), state, p.tau, given(p, Q, Q))


def object_reframed(p: Problem, frame: Pose) -> Problem:
    """Return the same system with the object's frame (and C) elsewhere in it."""
    chain, body, back = p.chain, p.chain.held_object, frame.inverse()
    held = HeldObject(body.mass, back.R @ body.inertia @ back.R.T, back.R @ body.com + back.p)
    grasps = {name: Grasp(grasp.kind, back @ grasp.frame) for name, grasp in chain.grasps.items()}
    old = p.state.object_frame
    lever, V, w = old.R @ frame.p, p.state.object_twist, p.inputs.object_wrench
    twist = np.r_[V[:3], V[3:] + np.cross(V[:3], lever)]
    load = np.r_[w[:3] - np.cross(lever, w[3:]), w[3:]]
    state = State(p.state.q, p.state.qd, old @ frame, twist)
    return Problem(replace(chain, held_object=held, grasps=grasps), state, p.tau, replace(p.inputs, object_wrench=load))


def links_reframed(p: Problem, turns: list[np.ndarray]) -> Problem:
    """Return the same arms with every link's axes turned, link k by turns[k mod ..]."""
    arms = {}
    for name, arm in p.chain.arms.items():
        joints, links, before = [], [], np.eye(3)
        for k, (joint, link) in enumerate(zip(arm.joints, arm.links, strict=True)):
            R = turns[k % len(turns)]
            placement = Pose(before.T @ joint.placement.R @ R, before.T @ joint.placement.p)
            joints.append(replace(joint, axis=R.T @ joint.axis, placement=placement))
            links.append(Link(link.mass, R.T @ link.com, R.T @ link.inertia @ R))
            before = R
        arms[name] = replace(arm, joints=joints, links=links, tip=Pose(before.T @ arm.tip.R, before.T @ arm.tip.p))
    return replace(p, chain=replace(p.chain, arms=arms))


class Units(NamedTuple):
    """Factors from the old numbers to the new ones.

    Attributes:
        length, mass: e.g. 1000 for millimetres and for grams.
        joints: (n,) of joint positions, rates and accelerations.
    """

    length: float
    mass: float
    joints: np.ndarray

    @property
    def twist(self) -> np.ndarray:
        """(6,) of twists and accelerations [omega; v]."""
        return np.r_[np.ones(3), np.full(3, self.length)]

    @property
    def wrench(self) -> np.ndarray:
        """(6,) of wrenches [moment; force]."""
        return self.mass * self.length * np.r_[np.full(3, self.length), np.ones(3)]


def rescaled(p: Problem, length: float = 1.0, mass: float = 1.0) -> tuple[Problem, Units]:
    """Return the problem in units `length` times smaller and `mass` times lighter, and the factors."""
    chain, state, body = p.chain, p.state, p.chain.held_object
    sliding = [joint.kind == "prismatic" for arm in chain.arms.values() for joint in arm.joints]
    units, moment = Units(length, mass, np.where(sliding, length, 1.0)), mass * length**2

    def pose(old: Pose) -> Pose:
        return Pose(old.R, length * old.p)

    def of_arm(arm: Arm) -> Arm:
        links = [Link(mass * link.mass, length * link.com, moment * link.inertia) for link in arm.links]
        joints = []
        for joint in arm.joints:
            drive = moment if joint.kind == "revolute" else mass
            drives = {"armature": drive * joint.armature, "damping": drive * joint.damping}
            joints.append(replace(joint, placement=pose(joint.placement), **drives))
        return Arm(joints, links, pose(arm.tip), pose(arm.base))

    scaled = replace(
        chain,
        arms={name: of_arm(arm) for name, arm in chain.arms.items()},
        held_object=HeldObject(mass * body.mass, moment * body.inertia, length * body.com),
        grasps={name: Grasp(grasp.kind, pose(grasp.frame)) for name, grasp in chain.grasps.items()},
        gravity=length * chain.gravity,
    )
    old, there = p.inputs.shaped(chain), np.r_[state.object_pose[:4], length * state.object_pose[4:]]
    inputs = Inputs(
        old.object_wrench * units.wrench,
        None if old.link_wrenches is None else old.link_wrenches * units.wrench,
        old.base_twists * units.twist,
        old.base_accelerations * units.twist,
    )
    moved = State(state.q * units.joints, state.qd * units.joints, there, state.object_twist * units.twist)
    return Problem(scaled, moved, p.tau * moment / units.joints, inputs), units
