"""The same physics described otherwise: mirrored, turned, shifted, with other frames on the same bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast import ClosedChain, ForwardResult, Grasp, HeldObject, Inputs, Link, Pose, State
from tests.laws.systems import with_arms
from tests.systems.as_chain import Problem

# every body's own axes are mirrored along their x, so that frames stay right-handed
LOCAL = np.diag([-1.0, 1.0, 1.0])


def both(moment_map: np.ndarray, force_map: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return [moment_map a; force_map b] for rows [a; b]."""
    return np.concatenate([x[..., :3] @ moment_map.T, x[..., 3:] @ force_map.T], axis=-1)


def given(p: Problem, rotational: np.ndarray, linear: np.ndarray) -> Inputs:
    """Return the inputs with angular and linear parts mapped."""
    old = p.inputs.shaped(p.chain)
    return Inputs(*(both(rotational, linear, x) for x in vars(old).values()))


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

    arms = {}
    for name, arm in chain.arms.items():
        joints = [
            replace(j, axis=(-LOCAL if j.kind == "revolute" else LOCAL) @ j.axis, placement=local(j.placement))
            for j in arm.joints
        ]
        links = [Link(k.mass, LOCAL @ k.com, LOCAL @ k.inertia @ LOCAL) for k in arm.links]
        arms[name] = replace(arm, joints=joints, links=links, tip=local(arm.tip), base=in_world(arm.base))
    image = ClosedChain(
        arms,
        HeldObject(body.mass, LOCAL @ body.inertia @ LOCAL, LOCAL @ body.com),
        {name: Grasp(grasp.kind, local(grasp.frame)) for name, grasp in chain.grasps.items()},
        S @ chain.gravity,
    )
    state = State(p.state.q, p.state.qd, in_world(p.state.object_frame), both(-S, S, p.state.object_twist))
    return Problem(image, state, p.tau, given(p, -S, S)), S


def turned(p: Problem, Q: np.ndarray, t: np.ndarray) -> Problem:
    """Return the whole scene turned by Q about the origin and then shifted by t, gravity with it."""
    chain, world = p.chain, Pose(Q, t)
    arms = {name: arm.at(world @ arm.base) for name, arm in chain.arms.items()}
    there = ClosedChain(arms, chain.held_object, chain.grasps, Q @ chain.gravity)
    state = State(p.state.q, p.state.qd, world @ p.state.object_frame, both(Q, Q, p.state.object_twist))
    return Problem(there, state, p.tau, given(p, Q, Q))


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
        tip = Pose(before.T @ arm.tip.R, before.T @ arm.tip.p)
        arms[name] = replace(arm, joints=joints, links=links, tip=tip)
    return replace(p, chain=with_arms(p.chain, arms))


def answers(result: ForwardResult) -> dict[str, np.ndarray]:
    """Return the quantities of a result by name."""
    names = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")
    return {name: getattr(result, name) for name in names}
