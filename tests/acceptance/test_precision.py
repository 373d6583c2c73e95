"""`sequential` keeps its digits: light and heavy objects, nearly straight arms, far-off points."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from holdfast import forward_dynamics
from tests.acceptance.comparison import errors
from tests.oracles.maximal_kkt import solve
from tests.systems import one_straight_arm_of_three, well_conditioned_system
from tests.systems.as_chain import as_chain

DIGITS = 50
TOLERANCE = 1e-12
GRASPS = {
    "rigid": ["rigid", "rigid", "rigid"],
    "mixed": ["rigid", "hinge", "ball"],
    "rigid last": ["softfinger", "hinge", "rigid"],
    "no rigid": ["softfinger", "ball", "hinge"],
    "balls": ["ball", "ball", "ball"],
}


def worst_errors(case: dict) -> dict[str, float]:
    """Return the relative errors of `sequential` by both routes against 50 digits."""
    answer, p = solve(case, digits=DIGITS), as_chain(case)
    each = [
        errors(forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs, route=route), answer)
        for route in ("mass_matrix", "recursive")
    ]
    return {key: max(e[key] for e in each) for key in each[0]}


def over_seeds(seeds: range, **options) -> dict[str, float]:
    """Return the worst errors over well-conditioned random systems."""
    each = [worst_errors(well_conditioned_system(seed, **options)) for seed in seeds]
    return {key: max(e[key] for e in each) for key in each[0]}


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1.0, 1e2, 1e8])
@pytest.mark.parametrize("grasps", GRASPS)
def test_object_mass_does_not_cost_digits(scale, grasps):
    """Object mass and inertia from 1e-8 to 1e8 of the usual: <= 1e-12 (every Lambda_i regular)."""
    worst = over_seeds(range(1), grasps=GRASPS[grasps], joints=7, object_scale=scale)
    assert max(worst.values()) <= TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("grasps", GRASPS)
def test_object_mass_sweep(grasps):
    """The same over every decade from 1e-8 to 1e8 and ten seeds, printed."""
    for scale in 10.0 ** np.arange(-8, 9):
        worst = over_seeds(range(10), grasps=GRASPS[grasps], joints=7, object_scale=float(scale))
        print(f"\nobject x {scale:.0e}, {grasps}: " + ", ".join(f"{k} {v:.1e}" for k, v in worst.items()), end="")
        assert max(worst.values()) <= TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("arm_count", [1, 2, 5])
def test_light_object_any_arms(arm_count):
    """Objects from 1e-8 to 1e2 of the usual mass, arms of 3 to 12 joints, condition < 1e3: <= 1e-12."""
    for scale in (1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2):
        worst = over_seeds(range(8), arms=arm_count, grasps="rigid", object_scale=scale, limit=1e3)
        print(
            f"\nobject x {scale:.0e}, {arm_count} arms: " + ", ".join(f"{k} {v:.1e}" for k, v in worst.items()), end=""
        )
        assert max(worst.values()) <= TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("scale", [1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2])
def test_stored_cases_of_any_mass(scale):
    """Every stored rigid or mixed case with the object scaled: <= 1e-12."""
    worst = {}
    for case in json.loads((Path(__file__).parents[1] / "data" / "cases.json").read_text())["cases"]:
        kinds = {arm["grasp"]["type"] for arm in case["arms"]}
        if case["tags"]["f_unique"] and (kinds == {"rigid"} or len(kinds) > 1):
            case["object"]["mass"] *= scale
            case["object"]["inertia"] = (scale * np.array(case["object"]["inertia"])).tolist()
            worst[case["name"]] = max(worst_errors(case).values())
    name = max(worst, key=worst.__getitem__)
    print(f"\n{len(worst)} cases, object x {scale:.0e}: worst {worst[name]:.1e} ({name})", end="")
    assert worst[name] <= TOLERANCE


@pytest.mark.parametrize("which", [(0,), (1,), (2,), (0, 1), (1, 2), (0, 2)])
def test_nearly_straight_arms(which):
    """One arm of three (first, middle, last) or two, 1e-6 rad from straight: <= 1e-12."""
    worst = worst_errors(one_straight_arm_of_three(1e-6, which))
    assert max(worst.values()) <= TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("joints", [(6, 6, 6), (7, 7, 7)])
@pytest.mark.parametrize("which", [(0,), (1,), (2,), (0, 1), (1, 2), (0, 2)])
def test_straight_arm_sweep(which, joints):
    """Bends from 0.1 rad to exactly straight: <= 1e-12 throughout, printed."""
    for bend in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 0.0):
        each = [worst_errors(one_straight_arm_of_three(bend, which, seed, joints)) for seed in range(3)]
        worst = {key: max(e[key] for e in each) for key in each[0]}
        print(
            f"\narms {which} of {joints}, bend {bend:.0e}: " + ", ".join(f"{k} {v:.1e}" for k, v in worst.items()),
            end="",
        )
        assert max(worst.values()) <= TOLERANCE


@pytest.mark.parametrize(
    "options",
    [
        {"com_offset": 1.0},
        {"world_offset": (20.0, -15.0, 10.0)},
        {"angle_scale": 100.0},
        {"moving_base": True, "base_speed": 5.0},
        {"joint_speed": 10.0},
    ],
    ids=lambda options: next(iter(options)),
)
@pytest.mark.parametrize("grasps", [None, "rigid"])
def test_stretched_systems(options, grasps):
    """C a metre off, contacts 20 m from the origin, angles of 100 rad, fast bases and joints: <= 1e-11."""
    worst = over_seeds(range(3), grasps=grasps, **options)
    assert max(worst.values()) <= 1e-11
