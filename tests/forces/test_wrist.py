"""Wrenches across the tip and across the last joint: cut there, and everything beyond obeys Newton and Euler."""

import numpy as np
import pytest

from holdfast.dynamics.energy import MovingBody, bodies
from holdfast.forces.wrist import last_joint_wrenches, wrist_wrenches
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from tests.laws.moving import moving
from tests.laws.systems import mixed
from tests.spatial.dual import slopes_of
from tests.systems.problems import random_problem

seeds = pytest.mark.parametrize("seed", range(6))
TOLERANCE = 1e-11  # of the sum of absolute terms


def needed(now: MovingBody, later: MovingBody, gravity, load, point) -> list[np.ndarray]:
    """Return rate of momentum, less weight, less load (about the body's origin): terms about a fixed point, world."""
    rate = slopes_of(shift_wrench(later.origin - point, rotate(later.R, later.inertia.apply(later.twist))))
    weight = np.r_[np.cross(now.com - now.inertia.m * point, gravity), now.inertia.m * gravity]
    return [rate, -weight, -shift_wrench(now.origin - point, load)]


def one_arm(seed: int):
    """Return an arm that holds the object alone, on a moving base, everything on, solved."""
    kind = ("rigid", "rigid", "hinge", "softfinger", "ball", "rigid")[seed]
    p = random_problem(seed, grasps=(kind,), joints=(6,), moving_base=True, gravity=(1.0, -2.0, -9.0))
    return p, p.solved()


@seeds
def test_one_arm(seed):
    """What tip and last joint transmit is what the object, and the last link with it, need; whatever the grasp."""
    p, result = one_arm(seed)
    *links, held = bodies(p.chain, p.state, p.inputs)
    *later_links, later = bodies(*moving(p, result))
    point, R = links[-1].origin, links[-1].R
    terms = needed(held, later, p.chain.gravity, p.inputs.object_wrench, point)
    terms += needed(links[-1], later_links[-1], p.chain.gravity, p.inputs.link_wrenches[-1], point)
    found = rotate(R, last_joint_wrenches(p.chain, p.state, result, p.inputs)[0])
    assert np.abs(found - np.sum(terms, axis=0)).max() <= TOLERANCE * np.abs(terms).sum(axis=0).max()

    arm = p.chain.arms["arm1"]
    terms = needed(held, later, p.chain.gravity, p.inputs.object_wrench, point + R @ arm.tip.p)
    found = rotate(R @ arm.tip.R, wrist_wrenches(p.chain, p.state, result)[0])
    assert np.abs(found - np.sum(terms, axis=0)).max() <= TOLERANCE * np.abs(terms).sum(axis=0).max()
    assert np.abs(found).max() > 1


@seeds
def test_several_arms(seed):
    """Five arms: together the tips carry the object; an arm that holds nothing carries its last link alone."""
    p, result = mixed(seed)
    *links, held = bodies(p.chain, p.state, p.inputs)
    *later_links, later = bodies(*moving(p, result))
    across_tips = wrist_wrenches(p.chain, p.state, result)
    terms = [-x for x in needed(held, later, p.chain.gravity, p.inputs.object_wrench, held.origin)]
    for (name, arm), f in zip(p.chain.arms.items(), across_tips, strict=True):
        last = links[p.chain.joints[name].stop - 1]
        terms.append(shift_wrench(last.R @ arm.tip.p + last.origin - held.origin, rotate(last.R @ arm.tip.R, f)))
    assert np.abs(np.sum(terms, axis=0)).max() <= TOLERANCE * np.abs(terms).sum(axis=0).max()

    np.testing.assert_array_equal(across_tips[2], np.zeros(6))
    k = p.chain.joints["arm3"].stop - 1
    last = links[k]
    terms = needed(last, later_links[k], p.chain.gravity, p.inputs.link_wrenches[k], last.origin)
    found = rotate(last.R, last_joint_wrenches(p.chain, p.state, result, p.inputs)[2])
    assert np.abs(found - np.sum(terms, axis=0)).max() <= TOLERANCE * np.abs(terms).sum(axis=0).max()


@seeds
def test_the_drive_carries_its_part(seed):
    """Along the last joint's axis: the drive's torque less damping and what turns its rotor."""
    p, result = mixed(seed)
    across = last_joint_wrenches(p.chain, p.state, result, p.inputs)
    for (name, arm), F in zip(p.chain.arms.items(), across, strict=True):
        k, joint = p.chain.joints[name].stop - 1, arm.joints[-1]
        along = joint.axis @ (F[:3] if joint.kind == "revolute" else F[3:])
        drive = p.tau[k] - joint.damping * p.state.qd[k] - joint.armature * result.qdd[k]
        assert abs(along - drive) <= TOLERANCE * (np.abs(F).max() + abs(p.tau[k]))
