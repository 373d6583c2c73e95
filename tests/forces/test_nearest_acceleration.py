"""An asked acceleration that gives way to the limits: `ForceCost.task`."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelError, StateError
from holdfast.forces import ForceCost, distribute, least_peak, lift_margin
from tests.control.two_pandas import rubber_pandas
from tests.systems.as_chain import as_chain
from tests.systems.special_systems import one_straight_arm_of_three

UP = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
NEAREST = ForceCost(task=100.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("bend", [1e-1, 1e-4, 1e-7])
def test_near_singular_postures(seed, bend):
    """However little two elbows are bent, torques keep their limits, and forward dynamics returns the acceleration."""
    p, random = as_chain(one_straight_arm_of_three(bend, (0, 1), seed)), np.random.default_rng(seed)
    limit, wanted = random.uniform(10.0, 60.0), random.normal(size=6) * 5.0
    arms = {
        name: replace(arm, joints=[replace(joint, effort_limit=limit) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    chain, state = replace(p.chain, arms=arms), p.state.at_rest()
    for form, weight in (("elastic", 100.0), ("effort", 100.0), ("elastic", 1e3)):
        found = distribute(chain, state, wanted, cost=ForceCost(task=weight), form=form)
        assert found.status == "optimal"
        assert np.abs(found.tau).max() <= limit * (1 + 1e-9)
        back = hf.forward_dynamics(chain, state, found.tau)
        np.testing.assert_allclose(back.object_acceleration, found.object_acceleration, atol=1e-10)


def test_the_weight():
    """Where the limits allow it, all that differs from an exact task falls with the square of the weight."""
    chain, state = rubber_pandas(0.8)
    exact = distribute(chain, state, UP)
    weights = np.array([10.0, 100.0, 1e3, 1e4])
    found = [distribute(chain, state, UP, cost=ForceCost(task=weight)) for weight in weights]
    for of in (
        [np.linalg.norm(one.object_acceleration - UP) for one in found],
        [np.abs(one.tau - exact.tau).max() for one in found],
        [exact.value - one.value for one in found],
    ):
        np.testing.assert_allclose(weights**2 * of, weights[0] ** 2 * of[0], rtol=0.01)
    heavy = distribute(chain, state, UP, cost=ForceCost(task=1e8))
    np.testing.assert_allclose(heavy.tau, exact.tau, atol=1e-9)


def test_nearer_than_a_share():
    """Beyond the limits, it is nearer to what is asked than its largest share, and the limits are kept."""
    chain, state = rubber_pandas(0.8)
    wanted = 2.0 * lift_margin(chain, state, UP).value * UP + 3.0 * np.eye(6)[0]
    assert distribute(chain, state, wanted).status == "infeasible"
    share = lift_margin(chain, state, wanted).object_acceleration
    nearest = distribute(chain, state, wanted, cost=NEAREST)
    assert (nearest.status, nearest.violation) == ("optimal", 0.0)
    assert np.linalg.norm(nearest.object_acceleration - wanted) < np.linalg.norm(share - wanted)
    rows = np.eye(6)[[0, 5]]  # the others are free
    free = distribute(chain, state, rows @ wanted, task=rows, cost=NEAREST)
    assert np.linalg.norm(rows @ (free.object_acceleration - wanted)) <= np.linalg.norm(
        rows @ (nearest.object_acceleration - wanted)
    )


def test_straight_arms():
    """What straight arms cannot follow is approached instead of refused."""
    p = as_chain(one_straight_arm_of_three(0.0, (0, 1)))
    state, wanted = p.state.at_rest(), np.ones(6)
    with pytest.raises(StateError, match="cannot change it along"):
        distribute(p.chain, state, wanted)
    found = distribute(p.chain, state, wanted, cost=ForceCost(task=1e4))
    back = hf.forward_dynamics(p.chain, state, found.tau)
    np.testing.assert_allclose(back.object_acceleration, found.object_acceleration, atol=1e-9)
    lost = wanted - found.object_acceleration
    assert np.linalg.norm(lost) > 0.1
    assert abs(lost @ found.object_acceleration) < 1e-5  # from the nearest one, they lead away at right angles


def test_refused_where_only_limits_count():
    """A largest margin or share and a least peak are those of an acceleration that is kept."""
    chain, state = rubber_pandas(0.8)
    for asked in (
        lambda: distribute(chain, state, UP, cost=NEAREST, form="margin"),
        lambda: lift_margin(chain, state, UP, cost=NEAREST),
        lambda: least_peak(chain, state, UP, cost=NEAREST),
    ):
        with pytest.raises(StateError, match="cost: task: expected None, got 100"):
            asked()
    with pytest.raises(ModelError, match="cost: task"):
        ForceCost(task=0.0)
