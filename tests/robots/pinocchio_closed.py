"""A robot with a tray in both hands against Pinocchio's `constraintDynamics`: its tree, the free tray, two welds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

import holdfast as hf
from holdfast.robots.arms_on_trunk import ArmsOnTrunk
from tests.robots.pinocchio_trunk import TRAY, Tree, holding
from tests.robots.pinocchio_urdf import frame
from tests.systems.problems import relative_gap


class ClosedGaps(NamedTuple):
    """Relative gaps.

    Attributes:
        joints: of the joints' accelerations, those of the trunk among them.
        base: of a floating base's acceleration; 0 without one.
        tray: of the tray's acceleration.
        wrenches: of the hands' wrenches on the tray.
    """

    joints: float
    base: float
    tray: float
    wrenches: float


def closed_gaps(xml: str, found: ArmsOnTrunk, tips: dict[str, str], seed: int) -> ClosedGaps:
    """Return the gaps of a robot at a random state that keeps its grasps.

    Args:
        xml: the robot's URDF.
        found: what was read from it.
        tips: link by arm.
        seed: of configuration, grasps, velocities and torques.
    """
    random, tree = np.random.default_rng([seed, 0]), Tree(xml, found, seed)
    chain, state = holding(tree, found, tips, TRAY, "rigid", random)
    tau = random.normal(size=len(tree.q))
    ours = hf.forward_dynamics(chain, state, tau)
    a, wrenches = constraint_dynamics(tree, chain, state, tau, tips)
    robot, tray = a[:-6], a[-6:]
    wanted = tree.rates_of_rates(tree.rates(state.qd, state.base_twist), ours.qdd, ours.base_acceleration)
    return ClosedGaps(
        relative_gap(wanted[tree.order], robot[tree.order]),
        relative_gap(wanted[:6], robot[:6]) if tree.floats else 0.0,
        relative_gap(_as_free_flyer(state, ours.object_acceleration), tray),
        relative_gap(ours.grasp_wrench, wrenches),
    )


def constraint_dynamics(
    tree: Tree, chain: hf.ClosedChain, state: hf.State, tau: np.ndarray, tips: dict[str, str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the accelerations of tree and tray, and (hands, 6) wrenches on the tray about the hands, world axes.

    Its default settings are exact: no proximal term.
    """
    model = pin.Model(tree.model)
    tray = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "tray")
    held = chain.held_object
    model.appendBodyToJoint(
        tray, pin.Inertia(held.mass, np.array(held.com), np.array(held.inertia)), pin.SE3.Identity()
    )
    welds = pin.StdVec_RigidConstraintModel()
    for name, link in tips.items():
        at, grasp = model.frames[frame(model, link)], chain.grasps[name].frame
        ends = (tray, pin.SE3(np.array(grasp.R), np.array(grasp.p)), at.parentJoint, at.placement)
        welds.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, model, *ends, pin.LOCAL))
    weld_data = pin.StdVec_RigidConstraintData()
    for weld in welds:
        weld_data.append(weld.createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, welds, weld_data)
    (w, x, y, z), p = state.object_pose[:4], state.object_pose[4:]
    q = np.concatenate([tree.at, p, [x, y, z, w]])
    v = np.concatenate([tree.rates(state.qd, state.base_twist), _in_own_axes(state, state.object_twist)])
    drive = np.concatenate([tree.drive(tau, state.qd), np.zeros(6)])
    a = np.array(pin.constraintDynamics(model, data, q, v, drive, welds, weld_data))
    wrenches = []
    for name, found in zip(tips, weld_data, strict=True):
        axes, force = state.object_frame.R @ chain.grasps[name].frame.R, found.contact_force
        wrenches.append(np.concatenate([axes @ force.angular, axes @ force.linear]))
    return a, np.array(wrenches)


def _in_own_axes(state: hf.State, twist: np.ndarray) -> np.ndarray:
    """Return [linear; angular] of the tray in its own axes."""
    R = state.object_frame.R
    return np.concatenate([R.T @ twist[3:], R.T @ twist[:3]])


def _as_free_flyer(state: hf.State, acceleration: np.ndarray) -> np.ndarray:
    """Return the rate of the tray's twist in its own axes, which turn with it."""
    v, a = _in_own_axes(state, state.object_twist), _in_own_axes(state, acceleration)
    a[:3] -= np.cross(v[3:], v[:3])
    return a
