"""The same chain in other units of length and mass."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast import Arm, ClosedChain, Grasp, HeldObject, Inputs, Joint, Link, Pose, State
from tests.systems.as_chain import Problem


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

    @property
    def torques(self) -> np.ndarray:
        """(n,) of joint torques."""
        return self.mass * self.length**2 / self.joints


def rescaled(p: Problem, length: float = 1.0, mass: float = 1.0) -> tuple[Problem, Units]:
    """Return the problem in units `length` times smaller and `mass` times lighter, and the factors."""
    chain, state = p.chain, p.state
    sliding = [joint.kind == "prismatic" for arm in chain.arms.values() for joint in arm.joints]
    units = Units(length, mass, np.where(sliding, length, 1.0))
    body = chain.held_object
    moment = mass * length**2
    scaled = ClosedChain(
        {name: _arm(arm, length, mass) for name, arm in chain.arms.items()},
        HeldObject(mass * body.mass, moment * body.inertia, length * body.com),
        {name: Grasp(grasp.kind, _pose(grasp.frame, length)) for name, grasp in chain.grasps.items()},
        length * chain.gravity,
    )
    there = np.r_[state.object_pose[:4], length * state.object_pose[4:]]
    given = p.inputs.shaped(chain)
    inputs = Inputs(
        given.object_wrench * units.wrench,
        None if given.link_wrenches is None else given.link_wrenches * units.wrench,
        given.base_twists * units.twist,
        given.base_accelerations * units.twist,
    )
    moved = State(state.q * units.joints, state.qd * units.joints, there, state.object_twist * units.twist)
    return Problem(scaled, moved, p.tau * units.torques, inputs), units


def _arm(arm: Arm, length: float, mass: float) -> Arm:
    moment = mass * length**2
    links = [Link(mass * link.mass, length * link.com, moment * link.inertia) for link in arm.links]
    joints = [_joint(joint, length, mass) for joint in arm.joints]
    return Arm(joints, links, _pose(arm.tip, length), _pose(arm.base, length))


def _joint(joint: Joint, length: float, mass: float) -> Joint:
    drive = mass * (length**2 if joint.kind == "revolute" else 1.0)
    return replace(
        joint,
        placement=_pose(joint.placement, length),
        armature=drive * joint.armature,
        damping=drive * joint.damping,
    )


def _pose(pose: Pose, length: float) -> Pose:
    return Pose(pose.R, length * pose.p)
