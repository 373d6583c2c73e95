"""Orders of other libraries: what is swapped comes back, and Pinocchio's vectors become ours."""

import numpy as np
import pytest

from holdfast import ClosedChain, HeldObject, ModelError
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.posture import posture
from holdfast.interop.joint_order import angular_first, linear_first, pinocchio_order, wxyz, xyzw
from holdfast.robots import panda, ur5e

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
        assert M[part, part] == pytest.approx(mass_matrix(arm, posture(arm, q[part]))[0], abs=1e-13)
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
