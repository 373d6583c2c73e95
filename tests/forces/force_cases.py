"""Questions with answers in 50 digits: which torques and grasp wrenches, under limits."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf
from holdfast.dynamics.closed.chain_motion import chain_motion

FILE = Path(__file__).parents[1] / "data" / "cases_forces.json"


class ForceCase(NamedTuple):
    """A question about arms in the world.

    Attributes:
        chain, state: the chain and its state.
        call: what the compiled function is given by name besides the state.
        question, expected: as in the file.
    """

    chain: hf.ClosedChain
    state: hf.State
    call: dict[str, Any]
    question: dict[str, Any]
    expected: dict[str, Any]

    @property
    def arguments(self) -> tuple[np.ndarray, ...]:
        """The inputs of `distribute` in order."""
        s = self.state
        return s.q, s.qd, s.object_pose, s.object_twist, np.array(self.question["acceleration"])

    @property
    def efforts(self) -> np.ndarray:
        """Effort limits, 1 without one."""
        limits = np.array([joint.effort_limit for joint in self.chain.all_joints])
        return np.where(np.isfinite(limits), limits, 1.0)


@cache
def force_cases() -> dict[str, ForceCase]:
    """Return by name the questions of least effort about arms in the world whose whole acceleration is asked."""
    cases = json.loads(FILE.read_text())["cases"]
    return {
        case["name"]: built(case)
        for case in cases
        if case["question"]["form"] == "effort" and not case.get("trunk") and "task" not in case["question"]
    }


def built(case: dict[str, Any]) -> ForceCase:
    """Return the question of a case."""
    body, asked = case["object"], case["question"]
    frame = hf.Pose(np.array(body["R"]), np.array(body["p"]))
    grasps = {arm["name"]: _grasp(arm["grasp"]) for arm in case["arms"]}
    arms = {arm["name"]: _arm(arm) for arm in case["arms"]}
    held = hf.HeldObject(body["mass"], np.array(body["inertia"]), np.array(body["com"]))
    twist = np.array([*body["omega"], *body["v"]])
    q, qd = (np.concatenate([arm[key] for arm in case["arms"]]) for key in ("q", "qd"))
    chain = hf.ClosedChain(arms, held, grasps, np.array(case["gravity"]))
    state = hf.State(q, qd, frame.wxyz_xyz, twist)
    motion = chain_motion(chain, state, 0.0 * q, hf.Inputs().shaped(chain))
    for (name, arm), c in zip(arms.items(), motion.contacts, strict=True):  # tips agree with contact frames
        arms[name] = arm.with_tip(hf.Pose(motion.arms[name].at.end.T @ c.frame, arm.tip.p))
    chain = hf.ClosedChain(arms, held, grasps, np.array(case["gravity"]))
    call: dict[str, Any] = {"force_scale": asked["force_scale"], "wrench_weight": asked.get("eps_force", 0.01)}
    for name, none in (("least_normal", -1e9), ("most_normal", 1e9)):
        call[name] = np.array([arm["grasp"].get(name, none) for arm in case["arms"]])
    call["wish"] = np.array([asked.get("wish", {}).get(str(k), [0.0] * 6) for k in range(len(arms))])
    if "acceleration_limits" in asked:
        call["acceleration_limits"] = np.outer([-1e9, 1e9], np.ones(chain.joint_count))
        for _, joint, *ends in asked["acceleration_limits"]:
            call["acceleration_limits"][:, joint] = ends
    return ForceCase(chain, state, call, asked, case["expected"])


def _arm(data: dict[str, Any]) -> hf.Arm:
    joints = [
        hf.Joint(
            joint["type"],
            np.array(joint["axis"]),
            hf.Pose(np.array(joint["R0"]), np.array(joint["p0"])),
            armature=joint.get("armature", 0.0),
            damping=joint.get("damping", 0.0),
            effort_limit=joint.get("effort", np.inf),
        )
        for joint in data["joints"]
    ]
    links = [hf.Link(x["mass"], np.array(x["com"]), np.array(x["inertia"])) for x in data["links"]]
    base = hf.Pose(np.array(data["base"]["R"]), np.array(data["base"]["p"]))
    return hf.Arm(joints, links, hf.Pose(np.eye(3), np.array(data["tip"])), base)


def _grasp(data: dict[str, Any]) -> hf.Grasp:
    frame = hf.Pose(np.array(data["frame_object"]), np.array(data["point_object"]))
    contact = None if "friction" not in data else hf.Friction(**data["friction"])
    limits = None if "wrench_limits" not in data else hf.WrenchLimits(**data["wrench_limits"])
    return hf.Grasp(data["type"], frame, contact, limits)
