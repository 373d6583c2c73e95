"""A closed chain as Pinocchio models it. Spatial vectors there are [linear; angular], ours [angular; linear].

Two ways to pose the problem to a tree library:
    free: the object is a free body, one weld per arm (6 l rows);
    tree: the object is part of the first arm's hand, one weld for each other arm (6 (l - 1) rows).
Pinocchio is imported where it is used: it is optional.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from holdfast.bench import library
from holdfast.bench.entry import Answers
from holdfast.bench.systems import System
from holdfast.model.arm import Arm
from holdfast.spatial.scalar import Array

Form = Literal["free", "tree"]


class PinocchioModel:
    """A system as a Pinocchio model with its welds, and its states in Pinocchio's coordinates.

    Attributes:
        form: "free" or "tree".
        model: the tree.
        welds: a StdVec of rigid constraints; a list would be converted in every call.
        inputs: (q, v, tau) of every state.
    """

    def __init__(self, system: System, form: Form) -> None:
        pin = library.pinocchio()

        self.system, self.form = system, form
        chain = system.chain
        self.model = pin.Model()
        last = {name: add_arm(self.model, arm, name) for name, arm in chain.arms.items()}
        tips = {name: se3(arm.tip) for name, arm in chain.arms.items()}
        frames = {name: se3(grasp.frame) for name, grasp in chain.grasps.items()}
        holder = next(iter(chain.arms))
        if form == "free":
            body, origin = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object"), pin.SE3()
            origin.setIdentity()
        else:
            body, origin = last[holder], tips[holder] * frames[holder].inverse()
        held = chain.held_object
        self.model.appendBodyToJoint(body, pin.Inertia(held.mass, np.array(held.com), np.array(held.inertia)), origin)
        drives = [arm.armature for arm in chain.arms.values()]
        self.model.armature = np.concatenate(drives if form == "tree" else [*drives, np.zeros(6)])
        self.model.gravity.linear = np.array(chain.gravity)
        self.welds = pin.StdVec_RigidConstraintModel()
        self.welded = [name for name in chain.grasps if form == "free" or name != holder]
        for name in self.welded:
            ends = (body, origin * frames[name], last[name], tips[name])
            self.welds.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, self.model, *ends, pin.LOCAL))
        self.inputs = [self._inputs(k) for k in range(system.states)]

    def _inputs(self, k: int) -> tuple[Array, Array, Array]:
        s = self.system
        if self.form == "tree":
            return s.q[k].copy(), s.qd[k].copy(), s.tau[k].copy()
        (w, x, y, z), p = s.object_pose[k, :4], s.object_pose[k, 4:]
        R = _rotation(s, k)
        own = np.concatenate([R.T @ s.object_twist[k, 3:], R.T @ s.object_twist[k, :3]])
        return (
            np.concatenate([s.q[k], p, [x, y, z, w]]),
            np.concatenate([s.qd[k], own]),
            np.concatenate([s.tau[k], np.zeros(6)]),
        )

    def weld_data(self) -> Any:
        """Return fresh data of the welds."""
        pin = library.pinocchio()

        data = pin.StdVec_RigidConstraintData()
        for weld in self.welds:
            data.append(weld.createData())
        return data

    def wrenches(self, weld_data: Any, k: int) -> Array:
        """Return (arms, 6) grasp wrenches at state k; NaN for the arm whose hand the object is part of."""
        chain, R = self.system.chain, _rotation(self.system, k)
        found = np.full((len(chain.arms), 6), np.nan)
        for name, data in zip(self.welded, weld_data, strict=True):
            world = R @ chain.grasps[name].frame.R
            force = data.contact_force  # on the first body, the object; contact axes
            found[chain.names.index(name)] = np.concatenate([world @ force.angular, world @ force.linear])
        return found

    def answers(self, evaluate: Any, weld_data: Any = None, passes: int = 1) -> Answers:
        """Return the answers of the last of several passes of `evaluate(q, v, tau)` over the states."""
        n, qdd, wrenches = self.system.chain.joint_count, [], []
        for left in range(passes, 0, -1):
            for k, given in enumerate(self.inputs):
                a = evaluate(*given)
                if left == 1:
                    qdd.append(np.array(a[:n]))
                    if weld_data is not None:
                        wrenches.append(self.wrenches(weld_data, k))
        return Answers(np.array(qdd), np.array(wrenches) if wrenches else None)


def se3(pose: Any) -> Any:
    """Return a pose as Pinocchio's."""
    pin = library.pinocchio()

    return pin.SE3(np.array(pose.R), np.array(pose.p))


def add_arm(model: Any, arm: Arm, name: str) -> int:
    """Append an arm at the world and return the number of its last joint."""
    pin = library.pinocchio()

    # joints about a coordinate axis have cheaper models of their own
    aligned = dict(zip("xyz", (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ), strict=True))
    parent = 0
    for k, (joint, link) in enumerate(zip(arm.joints, arm.links, strict=True)):
        placement = se3(joint.placement) if k else se3(arm.base) * se3(joint.placement)
        along = [axis for axis, unit in zip("xyz", np.eye(3), strict=True) if np.array_equal(joint.axis, unit)]
        kind = aligned[along[0]]() if along else pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, kind, placement, f"{name}/{k}")
        inertia = pin.Inertia(link.mass, np.array(link.com), np.array(link.inertia))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return parent


def _rotation(system: System, k: int) -> Array:
    from holdfast.spatial import rotation

    return rotation.from_quaternion(system.object_pose[k, :4])
