"""Manufactured closed-chain systems for tests: random ones and singular ones."""

from tests.systems.closing import closure_gaps, scaled_condition
from tests.systems.random_systems import random_system, well_conditioned_system
from tests.systems.special_systems import (
    one_straight_arm_of_three,
    planar_parallelogram,
    planar_three_arms,
    tip_conditions,
    two_collinear_stretched_6r,
)

__all__ = [
    "closure_gaps",
    "one_straight_arm_of_three",
    "planar_parallelogram",
    "planar_three_arms",
    "random_system",
    "scaled_condition",
    "tip_conditions",
    "two_collinear_stretched_6r",
    "well_conditioned_system",
]
