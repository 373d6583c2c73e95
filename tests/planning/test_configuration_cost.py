"""The cost of a configuration has the derivatives that it says, and is zero away from limits and singular postures."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.near_singular import arm_strength
from holdfast.dynamics.posture import Posture, PostureCost
from holdfast.planning.configuration_cost import INNERMOST, ConfigurationCost, zone_cost
from tests.planning.examples import mobile, two_arms


def test_zone():
    """The cost of a zone has two continuous derivatives, also where it begins and where its parabola begins."""
    u, h = np.linspace(-0.2, 1.2, 1401), 1e-6
    value, first, second = zone_cost(u)
    ahead, behind = zone_cost(u + h), zone_cost(u - h)
    assert (ahead[0] - behind[0]) / (2 * h) == pytest.approx(first, rel=1e-5, abs=1e-6)
    smooth = np.abs(u - INNERMOST) > 2 * h  # the third derivative jumps there
    assert ((ahead[1] - behind[1]) / (2 * h))[smooth] == pytest.approx(second[smooth], rel=1e-5, abs=1e-5)
    assert (value[u >= 1] == 0).all() and (np.diff(value[u <= 1]) < 0).all()
    assert zone_cost(np.array([0.25]))[0][0] == pytest.approx(0.75**3 / 0.25)


def test_strengths_are_those_of_the_diagnosis():
    """The weakest strength that the cost sees is the one of `arm_strength`."""
    chain, state = two_arms("panda")
    motion = chain_at_rest(chain, state)
    cost = ConfigurationCost(chain, Posture().cost(chain, state), 0.1, 0.5)
    for name, u in cost._strengths(motion):
        expected = arm_strength(chain.arms[name], motion.arms[name].at, chain.grasps[name], state.object_frame.R)
        assert 0.5 * u.min() == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("kind", ["rigid", "ball", "softfinger"])
def test_slope(kind):
    """The gradient against differences, with the joints of a trunk, near limits and where every strength counts.

    The object does not move with the joints, as along its path.
    """
    chain, state = mobile()
    chain = replace(chain, grasps={name: hf.Grasp(kind, grasp.frame) for name, grasp in chain.grasps.items()})
    random, n = np.random.default_rng(3), chain.joint_count
    wish = PostureCost(random.uniform(-1, 1, n), random.uniform(0, 1, n))
    cost, h = ConfigurationCost(chain, wish, 0.45, 0.9), 1e-6
    q = state.q + random.uniform(-0.2, 0.2, n)

    def value(q):
        there = replace(state, q=q)
        return cost.value(q, chain_at_rest(chain, there))

    terms = cost.terms(q, chain_at_rest(chain, replace(state, q=q)))
    differences = [(value(q + h * e) - value(q - h * e)) / (2 * h) for e in np.eye(n)]
    assert terms.slope == pytest.approx(np.array(differences), rel=1e-5, abs=1e-6)
    assert terms.value == pytest.approx(value(q), rel=1e-12)
    assert np.linalg.eigvalsh(terms.curvature).min() >= -1e-9
