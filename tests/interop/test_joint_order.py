"""Orders of other libraries: what is swapped comes back, and Pinocchio's vectors become ours."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import ClosedChain, HeldObject, Trunk, forward_dynamics
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.errors import ModelError
from holdfast.interop.joint_order import angular_first, free_flyer, linear_first, pinocchio_order, wxyz, xyzw
from holdfast.robots import panda, ur5e
from tests.oracles.pinocchio_model import JOINTS, inertia, se3
from tests.systems.problems import random_problem
from tests.systems.trunk_problems import on_trunk

pin = pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")


def test_orders_and_back():
    """[moment; force] becomes [force; moment] and back, along any axis; quaternions have their scalar last."""
    assert linear_first(np.arange(6.0)).tolist() == [3, 4, 5, 0, 1, 2]
    J = np.arange(12.0).reshape(6, 2)
    assert (linear_first(J, 0)[:3] == J[3:]).all()
    assert (angular_first(linear_first(J, 0), 0) == J).all()
    for wrong in (np.zeros(5), np.float64(3.0)):
        with pytest.raises(ModelError, match="expected 6"):
            linear_first(wrong)
    q = np.array([[1.0, 2.0, 3.0, 4.0]])
    assert xyzw(q).tolist() == [[2, 3, 4, 1]]
    assert (wxyz(xyzw(q)) == q).all()


def pinocchio_model(chain, prefix):
    """Return a model with the chain's arms in reverse, each behind a joint of its own, and an object first."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
    for name, arm in reversed(chain.arms.items()):
        parent = 0
        for k, (joint, link) in enumerate(zip(arm.joints, arm.links, strict=True)):
            at = arm.base @ joint.placement if not k else joint.placement
            label = f"{name}/{joint.name}" if prefix else joint.name
            parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.array(at.R), np.array(at.p)), label)
            body = pin.Inertia(link.mass, np.array(link.com), np.array(link.inertia))
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model


@pytest.mark.parametrize("prefix", [True, False])
def test_pinocchio(prefix):
    """Mass matrix blocks agree after permutation; q and v have places of their own behind a free flyer."""
    chain = ClosedChain({"left": panda(), "right": ur5e()}, HeldObject.box(1, 1, 1, 1), {})
    model = pinocchio_model(chain, prefix)
    order, rng = pinocchio_order(chain, model), np.random.default_rng(0)
    q, configuration = rng.normal(size=13), pin.neutral(model)
    configuration[order.q] = q
    M = np.array(pin.crba(model, model.createData(), configuration))
    M = (np.triu(M) + np.triu(M, 1).T)[np.ix_(order.v, order.v)]
    for name, arm in chain.arms.items():
        part = chain.joints[name]
        assert M[part, part] == pytest.approx(mass_matrix(arm, forward_kinematics(arm, q[part]))[0], abs=1e-13)
    assert chain.joint_names()[7] == "right/shoulder_pan_joint"
    assert (order.q == order.v + 1).all()


def test_pinocchio_refusals():
    """A joint that is not there, has a circle for its position, or stands for two of ours is refused."""
    chain = ClosedChain({"left": ur5e()}, HeldObject.box(1, 1, 1, 1), {})
    model = pin.Model()
    parent = model.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), "shoulder_pan_joint")
    with pytest.raises(ModelError, match="'shoulder_pan_joint': expected one position and one velocity"):
        pinocchio_order(chain, model)
    model.addJoint(parent, pin.JointModelRZ(), pin.SE3.Identity(), "elbow")
    with pytest.raises(ModelError, match="no joint 'left/"):
        pinocchio_order(chain, pin.Model())
    twins = ClosedChain({"left": ur5e(), "right": ur5e()}, HeldObject.box(1, 1, 1, 1), {})
    with pytest.raises(ModelError, match="two of our joints"):
        pinocchio_order(twins, pinocchio_model(chain, False))


@pytest.mark.parametrize(("joints", "floating"), [(3, False), (2, True), (0, True)])
def test_pinocchio_on_a_trunk(joints, floating):
    """Accelerations of trunk, arms and floating base are those of `aba`, through the order and `free_flyer`."""
    p = on_trunk(random_problem(3, arms=3, joints=5, grasps="rigid", moving_base=False), 3, joints, floating=floating)
    chain, state = replace(p.chain, grasps={}), p.state
    model = pin.Model()
    model.gravity.linear = np.array(chain.gravity)
    parents, at = [], se3(chain.trunk.base)
    parent = 0
    if floating:
        parent, at = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint"), pin.SE3.Identity()
        model.appendBodyToJoint(parent, inertia(chain.trunk.floating), pin.SE3.Identity())
        parents.append(parent)
    names = iter(chain.joint_names())

    def add(parent, at, joints, links):
        """Append joints and links, and yield their numbers."""
        for joint, link in zip(joints, links, strict=True):
            placement = at * se3(joint.placement)
            parent = model.addJoint(parent, JOINTS[joint.kind](np.array(joint.axis)), placement, next(names))
            model.appendBodyToJoint(parent, inertia(link), pin.SE3.Identity())
            at = pin.SE3.Identity()
            yield parent

    parents += add(parent, at, chain.trunk.joints, chain.trunk.links)
    for name, arm in chain.arms.items():
        list(add(parents[chain.mounted_on[name]] if name in chain.mounts else 0, se3(arm.base), arm.joints, arm.links))
    order = pinocchio_order(chain, model)
    armature, q, v, tau = np.zeros(model.nv), pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    for k, joint in zip(order.v, chain.all_joints, strict=True):
        armature[k] = joint.armature
    model.armature = armature
    q[order.q], v[order.v] = state.q, state.qd
    if floating:
        q[order.base_q], v[order.base_v] = free_flyer(state.base_pose, state.base_twist)
    taken = [
        j.damping * rate + j.stiffness * (at - j.rest)
        for j, rate, at in zip(chain.all_joints, state.qd, state.q, strict=True)
    ]
    tau[order.v] = p.tau - taken
    found = forward_dynamics(chain, state, p.tau)
    theirs = np.array(pin.aba(model, model.createData(), q, v, tau))
    assert theirs[order.v] == pytest.approx(found.qdd, rel=1e-9, abs=1e-9)
    assert (len(order.base_v), len(order.base_q)) == ((6, 7) if floating else (0, 0))
    if floating:  # Pinocchio's is of v in moving axes: R^T (v_dot - omega x v)
        R, (omega, speed) = state.base_frame.R, np.split(state.base_twist, 2)
        ours = np.r_[(found.base_acceleration[3:] - np.cross(omega, speed)) @ R, found.base_acceleration[:3] @ R]
        assert theirs[order.base_v] == pytest.approx(ours, rel=1e-9, abs=1e-9)
        with pytest.raises(ModelError, match="expected a free flyer called 'trunk' or 'root_joint'"):
            pinocchio_order(replace(chain, trunk=Trunk(floating=chain.trunk.floating), mounts={}), model_of_arms(chain))


def model_of_arms(chain):
    """Return a model of the arms alone."""
    model = pin.Model()
    for name, arm in chain.arms.items():
        parent = 0
        for k, joint in enumerate(arm.joints):
            axis = JOINTS[joint.kind](np.array(joint.axis))
            parent = model.addJoint(parent, axis, pin.SE3.Identity(), f"{name}/{joint.name or f'joint{k + 1}'}")
    return model
