"""Manufactured systems are consistent, physical, and as singular as they claim."""

import json

import numpy as np
import pytest

from tests.oracles.maximal_kkt import solve, solve_min_norm
from tests.systems import (
    closure_gaps,
    one_straight_arm_of_three,
    planar_parallelogram,
    planar_three_arms,
    random_system,
    scaled_condition,
    tip_conditions,
    two_collinear_stretched_6r,
    well_conditioned_system,
)
from tests.systems.closing import velocity_constraint
from tests.systems.random_parts import KINDS

STRETCHES = (
    {"object_scale": 1e-8},
    {"object_scale": 1e8},
    {"com_offset": 5.0},
    {"world_offset": (20.0, -20.0, 10.0)},
    {"angle_scale": 100.0},
    {"base_speed": 20.0, "moving_base": True},
    {"joint_speed": 0.0, "gravity": (0.0, 0.0, 0.0)},
)


@pytest.mark.parametrize("seed", range(8))
def test_random_system_is_consistent(seed):
    """Contacts coincide, velocities agree to rounding, bodies are physical; the case is plain data."""
    case = random_system(seed)
    assert max(closure_gaps(case)) < 1e-13
    assert json.loads(json.dumps(case)) == case == random_system(seed)
    assert 1 <= len(case["arms"]) <= 8
    assert all(3 <= len(arm["joints"]) <= 12 for arm in case["arms"])
    for body in [case["object"]] + [link for arm in case["arms"] for link in arm["links"]]:
        low, middle, high = np.linalg.eigvalsh(body["inertia"])
        assert body["mass"] > 0
        assert low > 0 and low + middle > high * 1.01


@pytest.mark.parametrize("options", STRETCHES, ids=str)
def test_stretched_options_stay_consistent(options):
    """Extreme masses, places, angles and speeds keep the system closed."""
    for seed in range(2):
        case = random_system(seed, **options)
        assert max(closure_gaps(case)) < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_most_draws_are_usable(kind):
    """At least half of the draws of each grasp kind are well conditioned."""
    good = [scaled_condition(random_system(seed, grasps=kind)) < 1e4 for seed in range(10)]
    assert np.mean(good) >= 0.5


def test_well_conditioned_system():
    """Rejection finds a sound system, and says so when there is none; lists of different lengths are refused."""
    assert scaled_condition(well_conditioned_system(1, grasps="rigid", arms=8)) < 1e4
    with pytest.raises(ValueError, match="none of 3"):
        well_conditioned_system(1, tries=3, joints=[3] * 6, grasps="rigid")
    with pytest.raises(ValueError, match="disagree"):
        random_system(0, arms=3, joints=[6, 6])


def test_special_systems():
    """Flat, planar and collinear systems are closed and lose the ranks that they claim; no solution if collinear."""
    systems = [(planar_parallelogram(angle), 8 if angle == 0.0 else 9) for angle in (0.5, 1e-4, 0.0)]
    systems += [(planar_three_arms(4, tilted=tilted), 12) for tilted in (False, True)]
    systems += [(two_collinear_stretched_6r(0, opposed=opposed), 11) for opposed in (True, False)]
    for case, rank in systems:
        assert max(closure_gaps(case)) < 1e-13
        values = np.linalg.svd(velocity_constraint(case)[0], compute_uv=False)
        assert int(np.sum(values > 1e-9)) == rank
        assert (solve_min_norm(case)["residual"] > 1e-3) == (rank == 11)


@pytest.mark.parametrize("which", [(0,), (0, 1), (0, 1, 2)])
@pytest.mark.parametrize("joints", [(6, 6, 6), (7, 6, 7)])
def test_straight_arms_keep_forces_unique(which, joints):
    """Straight arms are singular by themselves; the whole system is not."""
    for bend, low, high in ((1e-3, 1e6, 1e10), (0.0, 1e14, np.inf)):
        case = one_straight_arm_of_three(bend, which=which, joints=joints)
        assert max(closure_gaps(case)) < 1e-13
        assert scaled_condition(case) < 1e4
        for i, condition in enumerate(tip_conditions(case)):
            assert low < condition <= high if i in which else condition < 1e6
    answer, exact = solve(case), solve(case, digits=40)
    np.testing.assert_allclose(answer["f"], exact["f"], rtol=1e-10, atol=1e-11)
