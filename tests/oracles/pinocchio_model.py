"""Our arms, objects and grasps as Pinocchio models, joint by joint.

Pinocchio orders a spatial vector [linear; angular], ours is [angular; linear].
"""

import numpy as np
import pytest

from holdfast import Arm, ClosedChain, State

pin = pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")

JOINTS = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}


def swapped(spatial: np.ndarray) -> np.ndarray:
    """Return [angular; linear] of [linear; angular], or the reverse; rows of a matrix alike."""
    return np.concatenate([spatial[3:], spatial[:3]])


def se3(pose) -> "pin.SE3":
    """Return a pose as Pinocchio's."""
    return pin.SE3(np.array(pose.R), np.array(pose.p))


def inertia(body) -> "pin.Inertia":
    """Return the inertia of a link or an object, about its mass centre."""
    return pin.Inertia(float(body.mass), np.array(body.com), np.array(body.inertia))


def add_arm(model, arm: Arm, prefix: str = "") -> int:
    """Append an arm to a model at the world; return the number of its last joint."""
    parent = 0
    for k, (joint, link) in enumerate(zip(arm.joints, arm.links, strict=True)):
        placement = se3(joint.placement) if k else se3(arm.base) * se3(joint.placement)
        parent = model.addJoint(parent, JOINTS[joint.kind](np.array(joint.axis)), placement, f"{prefix}{k}")
        model.appendBodyToJoint(parent, inertia(link), pin.SE3.Identity())
    return parent


def arm_model(arm: Arm, gravity) -> tuple:
    """Return a model of one arm and the number of its tip frame."""
    model = pin.Model()
    last = add_arm(model, arm)
    tip = model.addFrame(pin.Frame("tip", last, 0, se3(arm.tip), pin.FrameType.OP_FRAME))
    model.armature = np.array(arm.armature)
    model.gravity.linear = np.array(gravity)
    return model, tip


class RigidChain:
    """Arms, a free object and rigid grasps as two-joint 6-D contacts."""

    def __init__(self, chain: ClosedChain) -> None:
        self.chain = chain
        self.model = pin.Model()
        tips = {name: add_arm(self.model, arm, f"{name}/") for name, arm in chain.arms.items()}
        body = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
        self.model.appendBodyToJoint(body, inertia(chain.held_object), pin.SE3.Identity())
        self.model.armature = np.concatenate([*(arm.armature for arm in chain.arms.values()), np.zeros(6)])
        self.model.gravity.linear = np.array(chain.gravity)
        self.contacts = pin.StdVec_RigidConstraintModel()
        for name, grasp in chain.grasps.items():
            tip = se3(chain.arms[name].tip)
            self.contacts.append(
                pin.RigidConstraintModel(
                    pin.ContactType.CONTACT_6D, self.model, body, se3(grasp.frame), tips[name], tip, pin.LOCAL
                )
            )

    def forward_dynamics(self, state: State, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return qdd (n,), object acceleration (6,) and grasp wrenches (arms, 6) in our conventions."""
        _, contact_data, qdd = self._solved(state, tau)
        frame, (w, v) = state.object_frame, np.split(state.object_twist, 2)
        n = self.chain.joint_count
        # the free joint's acceleration is the derivative of the twist's body components
        linear = frame.R @ qdd[n : n + 3] + np.cross(w, v)
        acceleration = np.concatenate([frame.R @ qdd[n + 3 :], linear])
        wrenches = []
        for grasp, contact in zip(self.chain.grasps.values(), contact_data, strict=True):
            R = frame.R @ grasp.frame.R
            force = contact.contact_force  # on the first joint, the object; contact axes
            wrenches.append(np.concatenate([R @ force.angular, R @ force.linear]))
        return qdd[:n], acceleration, np.array(wrenches)

    def derivatives(self, state: State, tau: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return how qdd, object acceleration and grasp wrenches (flat) change along directions, in our conventions.

        Args:
            state: closed.
            tau: (n,) joint torques.
            along: (3n + 12, m) columns (dq, turn, shift, dqd, d omega, dv, dtau) that keep positions and rates closed:
                off the constraint Pinocchio's map is another.
        """
        data, contact_data, qdd = self._solved(state, tau)
        found = pin.computeConstraintDynamicsDerivatives(self.model, data, self.contacts, contact_data)
        n, R, (w, v) = self.chain.joint_count, state.object_frame.R, np.split(state.object_twist, 2)
        dq, turn, shift, dqd, dw, dv, dtau = np.split(along, np.cumsum([n, 3, 3, n, 3, 3]))

        def turned(x: np.ndarray) -> np.ndarray:
            return np.cross(turn.T, x).T

        # the free joint is moved along its own axes, and so is its twist
        of_q = np.concatenate([dq, R.T @ shift, R.T @ turn])
        of_v = np.concatenate([dqd, R.T @ (dv - turned(v)), R.T @ (dw - turned(w))])
        of_tau = np.concatenate([dtau, 0 * shift, 0 * turn])
        of_qdd, of_force = (
            sum(np.array(m) @ x for m, x in zip(parts, (of_q, of_v, of_tau), strict=True))
            for parts in (found[:3], found[3:])
        )
        _, _, wrenches = self.forward_dynamics(state, tau)
        angular = turned(R @ qdd[n + 3 :]) + R @ of_qdd[n + 3 :]
        coriolis = np.cross(dw.T, v).T + np.cross(w, dv.T).T
        linear = turned(R @ qdd[n : n + 3]) + R @ of_qdd[n : n + 3] + coriolis
        changed = []
        for i, (grasp, f) in enumerate(zip(self.chain.grasps.values(), wrenches, strict=True)):
            own, at = R @ grasp.frame.R, of_force[6 * i : 6 * i + 6]
            changed += [turned(f[:3]) + own @ at[3:], turned(f[3:]) + own @ at[:3]]
        return of_qdd[:n], np.concatenate([angular, linear]), np.concatenate(changed)

    def _solved(self, state: State, tau: np.ndarray) -> tuple:
        """Return data, contact data and accelerations of Pinocchio's answer."""
        frame, (w, v) = state.object_frame, np.split(state.object_twist, 2)
        wxyz = state.object_pose[:4]
        q = np.concatenate([state.q, frame.p, wxyz[1:], wxyz[:1]])
        qd = np.concatenate([state.qd, frame.R.T @ v, frame.R.T @ w])
        data = self.model.createData()
        contact_data = pin.StdVec_RigidConstraintData()
        for contact in self.contacts:
            contact_data.append(contact.createData())
        pin.initConstraintDynamics(self.model, data, self.contacts, contact_data)
        efforts = np.concatenate([tau, np.zeros(6)])
        qdd = np.array(pin.constraintDynamics(self.model, data, q, qd, efforts, self.contacts, contact_data))
        return data, contact_data, qdd
