"""From a chain and its state to the plain case dict that the oracles read."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast import Arm, ClosedChain, Grasp, State


def as_case(chain: ClosedChain, state: State, tau: np.ndarray | None = None) -> dict:
    """Return the case of a chain whose bases stand still; without torques its drives give none."""
    arms, tau = [], np.zeros(chain.joint_count) if tau is None else tau
    for name, arm in chain.arms.items():
        part = chain.joints[name]
        moving = {"q": state.q[part].tolist(), "qd": state.qd[part].tolist(), "tau": tau[part].tolist()}
        grasp = chain.grasps.get(name)
        arms.append(_arm(arm) | moving | {"grasp": None if grasp is None else _grasp(grasp)})
    held, frame = chain.held_object, state.object_frame
    body = {"mass": held.mass, "com": held.com.tolist(), "inertia": held.inertia.tolist()}
    pose = {"R": frame.R.tolist(), "p": frame.p.tolist()}
    motion = {"omega": state.object_twist[:3].tolist(), "v": state.object_twist[3:].tolist()}
    return {"gravity": chain.gravity.tolist(), "object": body | pose | motion, "arms": arms}


def _arm(arm: Arm) -> dict[str, Any]:
    """Return what of an arm does not move."""
    joints = [
        {
            "type": joint.kind,
            "axis": joint.axis.tolist(),
            "R0": joint.placement.R.tolist(),
            "p0": joint.placement.p.tolist(),
            "armature": joint.armature,
            "damping": joint.damping,
        }
        for joint in arm.joints
    ]
    links = [{"mass": k.mass, "com": k.com.tolist(), "inertia": k.inertia.tolist()} for k in arm.links]
    still = {key: [0.0, 0.0, 0.0] for key in ("omega", "v", "omega_dot", "v_dot")}
    base = {"R": arm.base.R.tolist(), "p": arm.base.p.tolist()} | still
    return {"base": base, "joints": joints, "links": links, "tip": arm.tip.p.tolist()}


def _grasp(grasp: Grasp) -> dict[str, Any]:
    """Return a grasp in the format of a case; its free axes in object axes."""
    plain = {"type": grasp.kind, "point_object": grasp.frame.p.tolist(), "W": []}
    count = {"hinge": 1, "softfinger": 2}.get(grasp.kind, 0)
    return plain | ({"h_object": np.array(grasp.frame.R.T[:count]).tolist()} if count else {})
