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


def constraint_rank(case: dict) -> tuple[int, int]:
    """Return rank and row count of the velocity constraint."""
    matrix, _ = velocity_constraint(case)
    values = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(values > 1e-9)), len(matrix)


@pytest.mark.parametrize("seed", range(20))
def test_random_system_is_consistent(seed):
    """Contacts coincide and velocities agree to rounding; the case is plain data."""
    case = random_system(seed)
    assert max(closure_gaps(case)) < 1e-13
    assert json.loads(json.dumps(case)) == case == random_system(seed)
    assert 1 <= len(case["arms"]) <= 8
    assert all(3 <= len(arm["joints"]) <= 12 for arm in case["arms"])


@pytest.mark.parametrize("options", STRETCHES, ids=str)
def test_stretched_options_stay_consistent(options):
    """Extreme masses, places, angles and speeds keep the system closed."""
    for seed in range(4):
        case = random_system(seed, **options)
        assert max(closure_gaps(case)) < 1e-12


@pytest.mark.parametrize("seed", range(10))
def test_bodies_are_physical(seed):
    """Principal moments are positive and strictly satisfy the triangle inequality."""
    case = random_system(seed)
    for body in [case["object"]] + [link for arm in case["arms"] for link in arm["links"]]:
        low, middle, high = np.linalg.eigvalsh(body["inertia"])
        assert body["mass"] > 0
        assert low > 0 and low + middle > high * 1.01


def test_extras_are_optional():
    """Extras appear when asked for, and an arm may hold nothing."""
    plain = random_system(1, extras=False, grasps=["ball", None])
    assert "wrench" not in plain["object"]
    assert plain["arms"][1]["grasp"] is None
    rich = random_system(1, arms=2, joints=[4, 7])
    assert [len(arm["link_wrench"]) for arm in rich["arms"]] == [4, 7]
    assert all(joint["armature"] >= 0 for arm in rich["arms"] for joint in arm["joints"])


@pytest.mark.parametrize("kind", KINDS)
def test_most_draws_are_usable(kind):
    """At least half of the draws of each grasp kind are well conditioned."""
    good = [scaled_condition(random_system(seed, grasps=kind)) < 1e4 for seed in range(20)]
    assert np.mean(good) >= 0.5


def test_well_conditioned_system():
    """Rejection finds a sound system, and says so when there is none."""
    assert scaled_condition(well_conditioned_system(1, grasps="rigid", arms=8)) < 1e4
    with pytest.raises(ValueError, match="none of 3"):
        well_conditioned_system(1, tries=3, joints=[3] * 6, grasps="rigid")


def test_arm_counts_must_agree():
    """Lists of different lengths are refused."""
    with pytest.raises(ValueError, match="disagree"):
        random_system(0, arms=3, joints=[6, 6])


def test_parallelogram_loses_rank_only_when_flat():
    """Rank 9 of 12 and a steady answer away from flat; rank 8 and another one at 0."""
    steady = np.array([1.0, -1.0, 1.0, -1.0])
    answers = {}
    for angle in (0.5, 1e-2, 1e-4, 0.0):
        case = planar_parallelogram(angle)
        assert max(closure_gaps(case)) < 1e-14
        assert constraint_rank(case) == (8 if angle == 0.0 else 9, 12)
        answers[angle] = solve_min_norm(case)
    rate = answers[0.5]["qdd"][0][0]
    for angle in (0.5, 1e-2, 1e-4):
        np.testing.assert_allclose(np.concatenate(answers[angle]["qdd"]), rate * steady, rtol=1e-6)
    growth = np.linalg.norm(answers[1e-4]["f"]) / np.linalg.norm(answers[1e-2]["f"])
    assert 90.0 < growth < 110.0
    assert np.max(np.abs(np.concatenate(answers[0.0]["qdd"]) - rate * steady)) > 1e-2


@pytest.mark.parametrize("tilted", [False, True])
def test_planar_arms_are_always_deficient(tilted):
    """Three planar arms have rank 12 of 18, and a solution all the same."""
    case = planar_three_arms(4, tilted=tilted)
    assert max(closure_gaps(case)) < 1e-13
    assert constraint_rank(case) == (12, 18)
    assert solve_min_norm(case)["residual"] < 1e-10
    assert scaled_condition(case) == np.inf


@pytest.mark.parametrize("opposed", [True, False])
def test_collinear_arms_have_no_solution(opposed):
    """Arms stretched along one line have rank 11 of 12 and no fitting acceleration."""
    case = two_collinear_stretched_6r(0, opposed=opposed)
    assert max(closure_gaps(case)) < 1e-13
    assert constraint_rank(case) == (11, 12)
    assert solve_min_norm(case)["residual"] > 1e-3


@pytest.mark.parametrize("which", [(0,), (0, 1), (0, 1, 2)])
@pytest.mark.parametrize("joints", [(6, 6, 6), (7, 6, 7)])
def test_straight_arms_keep_forces_unique(which, joints):
    """Straight arms are singular by themselves; the whole system is not."""
    for bend, low, high in ((1e-3, 1e6, 1e10), (0.0, 1e14, np.inf)):
        case = one_straight_arm_of_three(bend, which=which, joints=joints)
        assert max(closure_gaps(case)) < 1e-13
        assert constraint_rank(case) == (18, 18)
        assert scaled_condition(case) < 1e4
        for i, condition in enumerate(tip_conditions(case)):
            assert low < condition <= high if i in which else condition < 1e6
    answer, exact = solve(case), solve(case, digits=40)
    np.testing.assert_allclose(answer["f"], exact["f"], rtol=1e-10, atol=1e-11)
