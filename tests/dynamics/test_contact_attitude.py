"""Appendix A: Theta_dot = F(Theta) W, in quaternions and in Euler angles."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import Grasp, Pose
from holdfast.dynamics import contact_attitudes
from holdfast.errors import StateError
from holdfast.spatial import rotation
from tests.dynamics.problems import later, motion_of
from tests.systems.problems import random_problem, stored

FREE = {"rigid": 0, "hinge": 1, "softfinger": 2, "ball": 3}
OPTIONS = {"grasps": tuple(FREE), "joints": (7, 6, 7, 6)}
STEP = 1e-5


@pytest.mark.parametrize("parameters", ["quaternion", "euler"])
@pytest.mark.parametrize("moving_base", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_rates(parameters, moving_base, seed):
    """Theta moves by F W dt for every kind of grasp: central differences of the moved state."""
    p = random_problem(seed, moving_base=moving_base, **OPTIONS)
    now = contact_attitudes(p.chain, p.state, parameters, p.inputs)
    ahead, behind = (contact_attitudes(*later(p, s * STEP), parameters) for s in (1, -1))
    for name, grasp in p.chain.grasps.items():
        got = now[name]
        assert got.F.shape == ({"quaternion": 4, "euler": 3}[parameters], FREE[grasp.kind])
        assert got.W.shape == (FREE[grasp.kind],)
        measured = (ahead[name].theta - behind[name].theta) / (2 * STEP)
        np.testing.assert_allclose(got.rate, measured, atol=1e-7 * max(1.0, np.abs(measured).max()))
        if grasp.kind != "rigid":
            assert np.abs(got.rate).max() > 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_attitudes(seed):
    """Theta is the rotation from the tip's frame to the object's contact frame, both ways of writing."""
    p = random_problem(seed, **OPTIONS)
    motion = motion_of(p)
    quaternions = contact_attitudes(p.chain, p.state, inputs=p.inputs)
    angles = contact_attitudes(p.chain, p.state, "euler", p.inputs)
    for name, c in zip(p.chain.grasps, motion.contacts, strict=True):
        expected = motion.arms[name].at.tip.R.T @ c.R
        np.testing.assert_allclose(rotation.from_quaternion(quaternions[name].theta), expected, atol=1e-13)
        np.testing.assert_allclose(rotation.from_euler_zyx(*angles[name].theta), expected, atol=1e-13)
        np.testing.assert_array_equal(quaternions[name].W, c.W)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, np.pi / 2 - 5e-7])
def test_euler_singularity(pitch):
    """At a pitch of +-pi/2 Euler rates do not exist: reported by grasp; quaternions go on."""
    p = stored("ball_2arm")
    motion = motion_of(p)
    R = p.state.object_frame.R.T @ motion.arms["arm2"].at.tip.R @ rotation.from_euler_zyx(0.3, pitch, 0.0)
    turned = Grasp("ball", Pose(R, p.chain.grasps["arm2"].frame.p))
    chain = replace(p.chain, grasps={**p.chain.grasps, "arm2": turned})
    message = r"grasp 'arm2': Euler angles are singular at pitch -?1\.57079\d rad; try parameters='quaternion'"
    with pytest.raises(StateError, match=message):
        contact_attitudes(chain, p.state, "euler")
    found = contact_attitudes(chain, p.state)["arm2"]
    assert np.linalg.norm(found.rate) == pytest.approx(0.5 * np.linalg.norm(found.W), rel=1e-12)
