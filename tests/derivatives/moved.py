"""A problem a little along its directions, rotations turned; and the tangent of the state manifold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.linalg import null_space

from holdfast import Arm, Inputs, Link, Pose
from holdfast.spatial import rotation
from tests.oracles.arithmetic import arithmetic
from tests.oracles.chain_derivatives import Seeded, numbers_of, symmetric_basis
from tests.oracles.held_equations import relative_twists
from tests.spatial.dual import tangents_of
from tests.systems.as_chain import Problem

PUSHES = {  # directions and fields of the inputs
    "object_wrench": "object_wrench",
    "link_wrench": "link_wrenches",
    "trunk_link_wrench": "trunk_link_wrenches",
    "trunk_base_twist": "trunk_base_twist",
    "trunk_base_acceleration": "trunk_base_acceleration",
}


def moved_problem(p: Problem, at: Mapping[str, slice], along: np.ndarray) -> Problem:
    """Return the problem displaced.

    Args:
        p: the problem.
        at: where the directions of every name lie; see `tests.oracles.chain_derivatives`.
        along: how far to go in each.
    """
    d = {name: along[part] for name, part in at.items()}
    chain, state, inputs = p.chain, p.state, p.inputs.shaped(p.chain)

    def moved(pose: Pose, by: np.ndarray) -> Pose:
        return Pose(rotation.exp(by[:3]) @ pose.R, pose.p + by[3:])

    first, arms = chain.arm_joints[0].start, {}
    drives = {name: d[name] for name in ("armature", "damping")}
    for i, (name, arm) in enumerate(chain.arms.items()):
        part = chain.joints[name]
        base = moved(arm.base, d["base_pose"].reshape(-1, 6)[i])
        links = [_moved_body(link, d, "link", k) for k, link in enumerate(arm.links, start=part.start - first)]
        arms[name] = replace(_driven(arm, drives, part.start), base=base, links=links)
    grasps = {
        name: replace(grasp, frame=moved(grasp.frame, d["grasp_pose"].reshape(-1, 6)[i]))
        for i, (name, grasp) in enumerate(chain.grasps.items())
    }
    body = chain.held_object
    held = replace(
        body,
        mass=body.mass + d["object_mass"][0],
        com=body.com + d["object_com"],
        inertia=body.inertia + np.tensordot(d["object_inertia"], symmetric_basis(), 1),
    )
    trunk = None if chain.trunk is None else _driven(chain.trunk, drives, 0)
    if trunk is not None:
        bodies = [_moved_body(body, d, "trunk_link", k) for k, body in enumerate(trunk.bodies)]
        floating = None if trunk.floating is None else bodies[0]
        trunk = replace(trunk, links=bodies[len(bodies) - len(trunk.links) :], floating=floating)
    chain = replace(
        chain, arms=arms, grasps=grasps, held_object=held, gravity=chain.gravity + d["gravity"], trunk=trunk
    )
    of_base = {}
    if state.base_frame is not None:
        of_base["base_pose"] = moved(state.base_frame, d["floating_pose"]).wxyz_xyz
        of_base["base_twist"] = state.base_twist + d["floating_twist"]
    state = replace(
        state,
        q=state.q + d["q"],
        qd=state.qd + d["qd"],
        object_pose=moved(state.object_frame, d["object_pose"]).wxyz_xyz,
        object_twist=state.object_twist + d["object_twist"],
        **of_base,
    )
    pushed = {
        field: getattr(inputs, field) + d[name].reshape(getattr(inputs, field).shape)
        for name, field in PUSHES.items()
        if name in d
    }
    # mounted arms move with what they stand on
    free = np.array([[float(name not in chain.mounts)] for name in chain.arms])
    twists, accelerations = (free * d[name].reshape(-1, 6) for name in ("base_twist", "base_acceleration"))
    pushed |= {"base_twists": inputs.base_twists + twists}
    pushed |= {"base_accelerations": inputs.base_accelerations + accelerations}
    return Problem(chain, state, p.tau + d["tau"], Inputs(**pushed))


def _moved_body(body: Link, d: Mapping[str, np.ndarray], what: str, k: int) -> Link:
    """Return row k of links with another inertia."""
    return replace(
        body,
        mass=body.mass + d[f"{what}_mass"][k],
        com=body.com + d[f"{what}_com"][3 * k : 3 * k + 3],
        inertia=body.inertia + np.tensordot(d[f"{what}_inertia"][6 * k : 6 * k + 6], symmetric_basis(), 1),
    )


def _driven(part: Arm, drives: Mapping[str, np.ndarray], start: int):
    """Return an arm or a trunk with other drives."""
    joints = [
        replace(joint, **{name: getattr(joint, name) + x[start + k] for name, x in drives.items()})
        for k, joint in enumerate(part.joints)
    ]
    return replace(part, joints=joints)


def closed_rows(p: Problem) -> np.ndarray:
    """Return the rows of rigid grasps that a change (dq, turn, shift, dqd, d omega, dv) makes zero, (12 g, 2n + 12).

    Relative displacements are the relative twists with displacements for rates; relative twists stay zero.
    """
    numbers = arithmetic(None)
    seeded = Seeded(numbers_of(p, numbers), ("q", "object_pose", "qd", "object_twist"))
    changed = tangents_of(relative_twists(p.chain, seeded.given, numbers), seeded.count)
    of_positions, of_rates = np.split(changed, 2, axis=1)
    return np.block([[of_rates, 0 * of_rates], [of_positions, of_rates]])


def tangent(p: Problem) -> np.ndarray:
    """Return a basis of the tangent, (2n + 12, m); rigid grasps, closed."""
    return null_space(closed_rows(p))
