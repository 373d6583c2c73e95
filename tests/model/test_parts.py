"""Joints, links, arms, objects and grasps: what they hold and what follows from it."""

import dataclasses

import numpy as np
import pytest

from holdfast import Arm, Friction, Grasp, HeldObject, Joint, Link, Pose
from holdfast.model.grasp import WrenchLimits
from holdfast.spatial import rotation
from tests.model.parts import arm, bar

KINDS = {"rigid": 0, "hinge": 1, "softfinger": 2, "ball": 3}
CONTACTS = {
    "ball": Friction(0.5),
    "softfinger": Friction(0.5, torsion_radius=0.01),
    "hinge": Friction(0.5, half_length=0.05),
}


def test_joints():
    """By default a frictionless revolute joint about z without limits; NumPy's numbers are numbers."""
    joint = Joint()
    assert (joint.kind, joint.position_limits, joint.rate_limit) == ("revolute", (-np.inf, np.inf), np.inf)
    assert (joint.armature, joint.damping, joint.friction) == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(joint.axis, [0, 0, 1])
    limited = Joint(rate_limit=np.float32(2.0), effort_limit=np.array([87])[0], position_limits=np.array([-1, 1]))
    assert (limited.rate_limit, limited.effort_limit, limited.position_limits) == (2.0, 87.0, (-1.0, 1.0))


@pytest.mark.parametrize("q", [0.0, 0.3, -2.0, 100.0])
def test_rotation_parts(q):
    """R0 Rot(axis, q) = F + cos(q) C + sin(q) S."""
    axis = np.array([0.36, 0.48, 0.8])
    R0 = rotation.exp(np.array([0.4, -1.0, 0.2]))
    joint = Joint("revolute", axis, Pose(R0, np.zeros(3)))
    F, C, S = joint.rotation_parts
    np.testing.assert_allclose(F + np.cos(q) * C + np.sin(q) * S, R0 @ rotation.exp(q * axis), atol=5e-14)
    np.testing.assert_allclose(dataclasses.replace(joint, kind="prismatic").parent_shift, R0 @ axis, atol=1e-15)


def test_bodies():
    """Massless links, rods, and unphysical moments where asked for; a box is m/12 (y^2 + z^2) about x."""
    assert Link(0.0).mass == 0.0
    assert Link(1.0, inertia=np.diag([0.0, 1.0, 1.0])).inertia[1, 1] == 1.0
    assert Link(1.0, inertia=np.diag([1.0, 1.0, 2.1]), physical=False).inertia[2, 2] == 2.1
    assert HeldObject(1.0, np.diag([1.0, 1.0, 3.0]), physical=False).inertia[2, 2] == 3.0
    box = HeldObject.box(12.0, 1.0, 2.0, 3.0)
    np.testing.assert_array_equal(box.inertia, np.diag([13.0, 10.0, 5.0]))
    np.testing.assert_array_equal(box.com, np.zeros(3))


def test_round_bodies():
    """A sphere has 2/5 m r^2; a long cylinder is a rod, m l^2 / 12, a short one a disc, m r^2 / 2 about z."""
    np.testing.assert_allclose(HeldObject.sphere(5.0, 0.3).inertia, 0.18 * np.eye(3), rtol=1e-15)
    cylinder = HeldObject.cylinder(12.0, 0.2, 3.0)
    np.testing.assert_allclose(cylinder.inertia, np.diag([9.12, 9.12, 0.24]), rtol=1e-15)
    np.testing.assert_array_equal(cylinder.com, np.zeros(3))


def test_spatial_inertia():
    """Steiner: about the origin the inertia grows by m (d^2 1 - d d^T)."""
    com = np.array([0.1, -0.2, 0.3])
    steiner = 2.0 * (com @ com * np.eye(3) - np.outer(com, com))
    inertia = np.diag([0.3, 0.4, 0.5])
    for body in (Link(2.0, com, inertia), HeldObject(2.0, inertia, com)):
        np.testing.assert_allclose(body.spatial_inertia.I, inertia + steiner, atol=1e-15)
        np.testing.assert_allclose(body.spatial_inertia.h, 2.0 * com)
        assert body.spatial_inertia.m == 2.0


def test_arms():
    """`at` mounts a copy elsewhere, `with_tip` changes the tool; joint data stands base to tip; the original stays."""
    original, tool = arm(), Pose.translation(0, 0, 0.1)
    for base in (Pose.translation(1, 2, 3), [1, 0, 0, 0, 1, 2, 3]):
        mounted = original.at(base)
        np.testing.assert_array_equal(mounted.base.p, [1, 2, 3])
        assert mounted.joints == original.joints
    np.testing.assert_array_equal(original.base.p, np.zeros(3))
    np.testing.assert_array_equal(original.with_tip(tool).tip.p, tool.p)
    np.testing.assert_array_equal(original.tip.p, [0.5, 0, 0])
    joints = [Joint(armature=0.1, damping=0.2, position_limits=(-1, 1)), Joint(armature=0.3, damping=0.4)]
    made = Arm(joints, [bar(), Link(1.0)])
    assert made.joint_count == 2
    np.testing.assert_array_equal(made.armature, [0.1, 0.3])
    np.testing.assert_array_equal(made.damping, [0.2, 0.4])
    np.testing.assert_array_equal(made.position_limits, [[-1, 1], [-np.inf, np.inf]])


@pytest.mark.parametrize("kind", KINDS)
def test_freedom_and_transmission(kind):
    """Transmitted and free directions together are the six; K has orthonormal rows and K h = 0; limits go with all."""
    limits = WrenchLimits(5.0, 100.0)
    grasp = Grasp(kind, contact=CONTACTS.get(kind), wrench_limits=limits)
    assert (grasp.contact, grasp.wrench_limits, Grasp(kind).contact) == (CONTACTS.get(kind), limits, None)
    assert len(grasp.free) == KINDS[kind]
    assert sorted(grasp.transmitted + grasp.free) == list(range(6))
    K = grasp.transmission
    assert K.shape == (6 - KINDS[kind], 6)
    np.testing.assert_array_equal(K @ K.T, np.eye(len(K)))
    np.testing.assert_array_equal(K @ np.eye(6)[:, list(grasp.free)], 0)


def test_lever():
    """A moment counts as a force at the ratio of the limits; with one limit only, at 1 m."""
    assert WrenchLimits(3.0, 60.0).lever == 0.05
    assert [WrenchLimits(**x).lever for x in ({}, {"moment": 3}, {"force": np.float64(60)})] == [1.0] * 3
    assert WrenchLimits(np.inf, 10**400 // 10**399).force == 10.0


def test_arrays_are_not_shared_with_the_caller():
    """What the caller changes later does not reach the model."""
    a, inertia = np.array([1.0, 0.0, 0.0]), np.eye(3)
    made = Joint(axis=a, placement=Pose(np.eye(3), a)), Link(1, a, inertia), Grasp("hinge", Pose(inertia, a))
    a[:], inertia[:] = 7.0, 9.0
    for array in (made[0].axis, made[0].placement.p, made[1].com, made[1].inertia[0], made[2].frame.p):
        np.testing.assert_array_equal(array, [1, 0, 0])
    np.testing.assert_array_equal(made[2].frame.R, np.eye(3))
