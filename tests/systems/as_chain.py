"""From a plain case dict, extras included, to what `forward_dynamics` takes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast import ClosedChain, Inputs, Pose, State, forward_dynamics
from holdfast.dynamics import ForwardResult, tip_pose
from holdfast.io import typed
from holdfast.io.case_data import CaseData
from holdfast.io.case_file import build_case
from holdfast.questions.arrays import ARRAYS


@dataclass(frozen=True)
class Problem:
    """Arguments of `forward_dynamics`."""

    chain: ClosedChain
    state: State
    tau: np.ndarray
    inputs: Inputs

    def solved(self, **options) -> ForwardResult:
        """Return forward dynamics."""
        return forward_dynamics(self.chain, self.state, self.tau, inputs=self.inputs, **options)

    @property
    def arguments(self) -> dict[str, np.ndarray]:
        """What machine code takes, by name; inputs that are zero anyhow are left out."""
        rows = [row for row in ARRAYS.values() if row.field and row.exists(self.chain)]
        state = {row.name: getattr(self.state, row.field) for row in rows if row.role == "state"}
        inputs = {row.name: getattr(self.inputs, row.field) for row in rows if row.role == "input"}
        return state | {"tau": self.tau} | {name: x for name, x in inputs.items() if np.any(x)}


def as_chain(case: dict) -> Problem:
    """Return the problem of a case dict; extras (armature, wrenches, free arms) go in by hand."""
    plain = {**case, "arms": [_plain_arm(arm) for arm in case["arms"]]}
    plain["object"] = {k: v for k, v in case["object"].items() if k != "wrench"}
    plain.pop("expected", None)
    built = build_case(typed.convert(plain, CaseData, "case"))
    arms, grasps = {}, {}
    for (name, arm), given in zip(built.chain.arms.items(), case["arms"], strict=True):
        joints = [
            replace(joint, armature=extra.get("armature", 0.0), damping=extra.get("damping", 0.0))
            for joint, extra in zip(arm.joints, given["joints"], strict=True)
        ]
        arms[name] = replace(arm, joints=joints)
        if given["grasp"] is not None:
            grasps[name] = built.chain.grasps[name]
    chain = replace(built.chain, arms=arms, grasps=grasps)
    return Problem(chain, built.state, built.tau, replace(built.inputs, **_wrenches(case)))


def mounted(chain: ClosedChain, q: np.ndarray, at: Pose) -> ClosedChain:
    """Return the chain with the bases of holding arms where, at joint positions q, all hold an object that is there."""
    bases = {}
    for name, grasp in chain.grasps.items():
        tip = tip_pose(chain.arms[name].at(Pose.identity()), q[chain.joints[name]])
        bases[name] = at @ grasp.frame @ tip.inverse()
    return chain.with_bases(bases)


def _plain_arm(arm: dict) -> dict:
    """Return the arm with nothing beyond the file format; a free arm gets a grasp to be dropped."""
    joints = [{k: j[k] for k in ("type", "axis", "R0", "p0")} for j in arm["joints"]]
    grasp = arm["grasp"] or {"type": "ball", "point_object": [0.0, 0.0, 0.0]}
    plain = {k: v for k, v in arm.items() if k != "link_wrench"}
    return {**plain, "joints": joints, "grasp": grasp}


def _wrenches(case: dict) -> dict:
    """Return external wrenches as `Inputs` fields."""
    links = [arm.get("link_wrench", np.zeros((len(arm["joints"]), 6))) for arm in case["arms"]]
    return {
        "object_wrench": np.array(case["object"].get("wrench", np.zeros(6))),
        "link_wrenches": np.concatenate([np.asarray(w, dtype=float) for w in links]),
    }
