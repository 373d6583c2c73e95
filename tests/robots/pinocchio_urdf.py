"""Pinocchio's reading of a URDF, reduced to one arm: mass matrix, tip Jacobian, bias torques.

Pinocchio orders a spatial vector [linear; angular], ours is [angular; linear].
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin

from holdfast import Joint
from holdfast.robots.urdf import UrdfChain

PREFIX = "link "
FREE = "free flyer"


class Models:
    """Pinocchio's models of one file, on a fixed and on a free-flying root."""

    def __init__(self, xml: str) -> None:
        xml = with_own_link_names(xml)
        self.fixed = pin.buildModelFromXML(xml)
        self.free = pin.buildModelFromXML(xml, pin.JointModelFreeFlyer(), FREE)

    def rounding(self, chain: UrdfChain) -> float:
        """Return below what [kg m^2] masses drown in the rounding of this oracle.

        A base that is not the root is held still by the motion of the whole robot: sums of
        its size cancel, and a thousandth of its mass at 1 m is the least that keeps 12 digits.
        """
        return 0.0 if chain.base == chain.robot.root else 1e-3 * pin.computeTotalMass(self.free)

    def mass_jacobian_bias(self, chain: UrdfChain, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return M, J of the tip and bias torques of an arm, world axes those of its base link."""
        if chain.base == chain.robot.root:
            return from_the_root(self.fixed, chain, q, qd)
        return from_any_link(self.free, chain, q, qd)


def with_own_link_names(xml: str) -> str:
    """Return the text with every link renamed: Pinocchio's frames are confused by joints of the same name."""
    link = re.compile(r"""(<link\s[^>]*?name\s*=\s*["'])|(<(?:parent|child)\s+link\s*=\s*["'])""")
    return link.sub(lambda found: found[0] + PREFIX, xml)


def held(model: pin.Model, joints: Iterable[Joint], locked: Mapping[str, float]) -> pin.Model:
    """Return the model with every other joint held: where `locked` says, else at zero."""
    moving = {joint.name for joint in joints} | {"universe", FREE}
    q = pin.neutral(model)
    for name, position in locked.items():
        put(model, q, name, position)
    ids = [model.getJointId(name) for name in model.names if name not in moving]
    return pin.buildReducedModel(model, ids, q)


def put(model: pin.Model, q: np.ndarray, name: str, position: float) -> None:
    """Set a joint's entry of q; a continuous joint has cosine and sine."""
    joint = model.joints[model.getJointId(name)]
    q[joint.idx_q : joint.idx_q + joint.nq] = [position] if joint.nq == 1 else [np.cos(position), np.sin(position)]


def frame(model: pin.Model, link: str) -> int:
    """Return the number of a link's frame."""
    return model.getFrameId(PREFIX + link, pin.FrameType.BODY)


def mass_matrix(model: pin.Model, data: pin.Data, at: np.ndarray) -> np.ndarray:
    """Return M, of which Pinocchio fills the upper half."""
    M = np.atleast_2d(pin.crba(model, data, at))
    return np.triu(M) + np.triu(M, 1).T


def jacobian(model: pin.Model, data: pin.Data, at: np.ndarray, link: str) -> np.ndarray:
    """Return the Jacobian of a link's frame, (6, nv), world axes; one joint's comes without its second axis."""
    J = pin.computeFrameJacobian(model, data, at, frame(model, link), pin.LOCAL_WORLD_ALIGNED)
    return np.array(J).reshape(6, model.nv)


def order(model: pin.Model, chain: UrdfChain) -> list[int]:
    """Return where the arm's joints stand among the model's velocities."""
    return [model.joints[model.getJointId(joint.name)].idx_v for joint in chain.arm.joints]


def swapped(J: np.ndarray) -> np.ndarray:
    """Return rows [angular; linear] of [linear; angular]."""
    return np.concatenate([J[3:], J[:3]])


def from_the_root(full: pin.Model, chain: UrdfChain, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return M, J and bias torques of an arm whose base link is the root."""
    model = held(full, chain.arm.joints, chain.locked)
    data, at, v, index = model.createData(), pin.neutral(model), np.zeros(model.nv), order(model, chain)
    for joint, position in zip(chain.arm.joints, q, strict=True):
        put(model, at, joint.name, position)
    v[index] = qd
    M = mass_matrix(model, data, at)
    J = jacobian(model, data, at, chain.tip)
    bias = pin.rnea(model, data, at, v, np.zeros(model.nv))
    return M[np.ix_(index, index)], swapped(J[:, index]), bias[index]


def from_any_link(full: pin.Model, chain: UrdfChain, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the same for any base link: a free-flying robot that moves so that the base stands still.

    v = S qd with J_base S = 0, so M = S^T M_free S; accelerations likewise.
    """
    model = held(full, chain.arm.joints, chain.locked)
    data, at, index = model.createData(), pin.neutral(model), order(model, chain)
    for joint, position in zip(chain.arm.joints, q, strict=True):
        put(model, at, joint.name, position)
    pin.framesForwardKinematics(model, data, at)
    base = frame(model, chain.base)
    at[:7] = pin.SE3ToXYZQUAT(data.oMf[base].inverse())  # the base link at the world's origin
    joints = jacobian(model, data, at, chain.base)
    S = np.zeros((model.nv, len(index)))
    S[index] = np.eye(len(index))
    S[:6] = -np.linalg.solve(joints[:, :6], joints[:, index])
    v = S @ qd
    pin.forwardKinematics(model, data, at, v, np.zeros(model.nv))
    drift = pin.getFrameClassicalAcceleration(model, data, base, pin.LOCAL_WORLD_ALIGNED).vector
    a = np.zeros(model.nv)
    a[:6] = -np.linalg.solve(joints[:, :6], drift)
    M = mass_matrix(model, data, at)
    J = jacobian(model, data, at, chain.tip)
    return S.T @ M @ S, swapped(J @ S), S.T @ pin.rnea(model, data, at, v, a)
