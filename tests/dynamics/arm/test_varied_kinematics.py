"""Derivatives of an arm's configuration as a mechanism of turning bodies, against those of every matrix entry."""

import numpy as np
import pytest

from holdfast import Pose
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics, link_twists, tip_twist
from holdfast.dynamics.arm.varied_kinematics import varied_kinematics
from holdfast.spatial import rotation
from holdfast.spatial.differentiation import gradient, linearised
from tests.dynamics.problems import random_arm
from tests.longer import mostly_slow

seeds = pytest.mark.parametrize("seed", range(6))


def functions(seed):
    """Return the same function of joint positions and base rotation by either kinematics, and where it is evaluated."""
    given = random_arm(seed)
    qd, twist = given.qd, given.base_twist

    def of(kinematics):
        def function(q, R):
            arm = given.arm.standing_at(Pose.unchecked(R, given.arm.base.p))
            at = kinematics(arm, q)
            V = link_twists(arm, at, qd, twist)
            loaded = [E @ v[:3] for E, v in zip(at.E, V, strict=True)]
            tip = [tip_twist(arm, at, V, twist), at.tip.R.ravel(), at.tip.p, at.from_base, at.end.ravel()]
            return [np.concatenate([*V, *loaded, *tip, *(R.ravel() for R in at.R), *at.reach])]

        return function

    return of(varied_kinematics), of(forward_kinematics), (given.q, given.arm.base.R)


@seeds
def test_rates_and_gradients(seed):
    """Arms with revolute and prismatic joints: all poses and twists, by joint positions and by the base's rotation."""
    own, plain, at = functions(seed)
    random = np.random.default_rng(seed)
    turn = random.normal(size=3)
    rates = random.normal(size=at[0].shape), np.cross(turn, at[1], axisb=0, axisc=0)
    found, expected = linearised(own, *at), linearised(plain, *at)
    (rate,), (truth,) = found.rates(*rates), expected.rates(*rates)
    np.testing.assert_allclose(rate, truth, rtol=0, atol=1e-13 * np.abs(truth).max())
    bar = random.normal(size=truth.shape)
    for x, y in zip(found.gradient(bar), expected.gradient(bar), strict=True):
        np.testing.assert_allclose(x, y, rtol=0, atol=1e-13 * np.abs(y).max())


@pytest.mark.parametrize("seed", mostly_slow(range(6), range(5)))
def test_derivatives_of_derivatives(seed):
    """Rates of a gradient, where numbers carry derivatives of both."""
    own, plain, (q, R) = functions(seed)
    random = np.random.default_rng(seed)
    weights, rate = random.normal(size=plain(q, R)[0].shape), random.normal(size=q.shape)

    def changed(function):
        def by_q(q):
            return gradient(lambda x: weights @ (function(x, R)[0] * function(x, R)[0]), q)

        return linearised(by_q, q).rates(rate)[0]

    expected = changed(plain)
    np.testing.assert_allclose(changed(own), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_rate_of_the_tip_is_its_twist():
    """The rate of the tip's pose along joint rates is the twist of the Jacobian's columns."""
    given = random_arm(2)

    def tip(q):
        at = varied_kinematics(given.arm, q)
        return [at.tip.R, at.tip.p]

    of_R, of_p = linearised(tip, given.q).rates(given.qd)
    at = forward_kinematics(given.arm, given.q)
    twist = tip_twist(given.arm, at, link_twists(given.arm, at, given.qd, np.zeros(6)), np.zeros(6))
    np.testing.assert_allclose(of_p, twist[3:], rtol=1e-12)
    h = 1e-6
    turned = rotation.exp(h * twist[:3]) @ at.tip.R, rotation.exp(-h * twist[:3]) @ at.tip.R
    np.testing.assert_allclose(of_R, (turned[0] - turned[1]) / (2 * h), atol=1e-8)
