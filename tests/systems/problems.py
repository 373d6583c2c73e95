"""The stored cases and random systems as library objects, and how far two answers are apart."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests.systems.as_chain import Problem, as_chain
from tests.systems.random_systems import well_conditioned_system

CASES = {
    case["name"]: case for case in json.loads((Path(__file__).parents[1] / "data" / "cases.json").read_text())["cases"]
}
STATE = ("q", "qd", "object_pose", "object_twist")
ANSWERS = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")


def relative_gap(got, expected, floor: float = 0.0) -> float:
    """Return the largest difference relative to the largest expected entry, or to the floor where that is larger."""
    got, expected = np.asarray(got, dtype=float), np.asarray(expected, dtype=float)
    assert got.shape == expected.shape
    size = max(floor, np.abs(expected).max(initial=0.0))
    # an expected zero gives nothing to be relative to
    return float(np.abs(got - expected).max(initial=0.0) / (size if size > 1e-9 else 1.0))


def largest_gaps(residuals: Mapping[str, Any]) -> np.ndarray:
    """Return the largest position and velocity gap, (2,), of what `closure` has returned."""
    return np.max([[np.abs(part).max(initial=0.0) for part in gap] for gap in residuals.values()], axis=0)


@cache
def stored(name: str) -> Problem:
    """Return a stored case."""
    return as_chain(CASES[name])


@cache
def random_case(seed: int, **options) -> dict:
    """Return a sound random system with everything on (one dict: do not change it)."""
    return well_conditioned_system(seed, **options)


@cache
def random_problem(seed: int, **options) -> Problem:
    """Return a sound random system as library objects."""
    return as_chain(random_case(seed, **options))
