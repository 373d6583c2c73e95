"""The closed chain as the object feels it."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import ClosedChain, Grasp, HeldObject, Pose, State
from holdfast.dynamics import motion_basis, object_inertia, object_mobility
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.errors import SingularChainError
from tests.dynamics.problems import motion_of
from tests.model.parts import arm
from tests.systems.problems import CASES, random_problem, relative_gap, stored

OPTIONS = {
    "rigid": {"grasps": "rigid", "joints": (7, 6, 8)},
    "mixed": {"grasps": ("rigid", "hinge", "softfinger", "ball"), "joints": (7, 6, 7, 6)},
}
systems = pytest.mark.parametrize(("kind", "seed"), [(kind, seed) for kind in OPTIONS for seed in range(3)])


@systems
def test_mobility_and_inertia(kind, seed):
    """A wrench w changes the object's acceleration by P w; P^-1 = M(C) + sum A^T K^T (K Lambda K^T)^-1 K A."""
    p = random_problem(seed, **OPTIONS[kind])
    P = object_mobility(p.chain, p.state)
    assert np.abs(P - P.T).max() < 1e-14 * np.abs(P).max()
    before = p.solved()
    for unit in np.eye(6):
        pushed = replace(p.inputs, object_wrench=p.inputs.object_wrench + unit)
        change = replace(p, inputs=pushed).solved().object_acceleration - before.object_acceleration
        assert relative_gap(change, P @ unit) < 1e-9
    s = Stacked(motion_of(p))
    omega = s.J @ s.mass_solve(s.J.T)
    expected = s.M_C + s.A.T @ s.K.T @ np.linalg.solve(s.K @ omega @ s.K.T, s.K @ s.A)
    got = object_inertia(p.chain, p.state)
    assert relative_gap(got, expected) < 1e-8
    np.testing.assert_allclose(got @ P, np.eye(6), atol=1e-10)
    assert np.linalg.eigvalsh(got - s.M_C)[0] > -1e-9 * np.abs(got).max()  # arms only resist


def test_held_fast():
    """Two one-joint arms that cannot move the object: its inertia is infinite there, its mobility zero."""
    p = stored("planar_2arm_6_6_omega_singular")
    with pytest.raises(SingularChainError, match=r"cannot move along 3 of 6 directions.*try object_mobility"):
        object_inertia(p.chain, p.state)
    assert np.linalg.matrix_rank(object_mobility(p.chain, p.state), tol=1e-9) == 3


def test_nobody_holds():
    """A free object's mobility is M(C)^-1, and every velocity is allowed."""
    chain = ClosedChain({"left": arm(2)}, HeldObject.box(2.0, 0.3, 0.2, 0.1), {})
    state = State(np.zeros(2), np.zeros(2), Pose.identity())
    expected = chain.held_object.spatial_inertia.symmetric().dense()
    np.testing.assert_allclose(object_inertia(chain, state), expected, atol=1e-14)
    np.testing.assert_array_equal(motion_basis(chain, state), np.eye(8))


@pytest.mark.parametrize("name", CASES)
def test_motion_basis(name):
    """Orthonormal, allowed by every grasp, as many as the mobility stored with the case."""
    p = stored(name)
    basis = motion_basis(p.chain, p.state)
    s = Stacked(motion_of(p))
    allowed = s.K @ np.hstack([s.J, -s.A])
    assert np.abs(allowed @ basis).max() < 1e-12
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-13)
    assert basis.shape == (p.chain.joint_count + 6, CASES[name]["tags"]["mobility"])


def test_locked():
    """A locked structure has no motion."""
    grasps = {name: Grasp("rigid", Pose.translation(x, 0, 0)) for name, x in (("left", 0.0), ("right", 0.1))}
    chain = ClosedChain({"left": arm(1), "right": arm(1)}, HeldObject.box(1.0, 0.1, 0.1, 0.1), grasps)
    chain = chain.with_bases({"right": Pose.translation(0.1, 0.0, 0.0)})
    turning = motion_basis(chain, State([0.0, 0.0], [0.0, 0.0], Pose.translation(0.5, 0, 0)))
    assert turning.shape == (8, 0)
