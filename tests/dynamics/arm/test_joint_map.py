"""H takes wrenches to drives and H^T rates to twists, dual to each other."""

import numpy as np
import pytest

from holdfast import Joint
from holdfast.dynamics.arm.forward_kinematics import column, expand, project
from holdfast.spatial.symmetric import symmetric6
from tests.systems.random_parts import unit_vector


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("seed", range(4))
def test_duality(kind, seed):
    """<H f, r> = <f, H^T r>, and P H^T is the column of P."""
    rng = np.random.default_rng(seed)
    joint = Joint(kind, unit_vector(rng))
    f, r = rng.normal(size=6), rng.normal()
    twist = expand(joint, r)
    expected = np.r_[joint.axis * r, np.zeros(3)] if kind == "revolute" else np.r_[np.zeros(3), joint.axis * r]
    np.testing.assert_array_equal(twist, expected)
    assert project(joint, f) * r == pytest.approx(f @ twist, abs=1e-14)
    P = rng.normal(size=(6, 6))
    P = P + P.T
    np.testing.assert_allclose(column(joint, symmetric6(P)) * r, P @ twist, atol=1e-13)
