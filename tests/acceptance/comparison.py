"""Comparing an answer of the library with one of the oracle, field by field."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics import ForwardResult
from tests.systems.problems import ANSWERS
from tests.systems.problems import relative_gap as relative

__all__ = ["disagreement", "errors", "relative"]


def errors(result: ForwardResult, answer: dict) -> dict[str, float]:
    """Return the relative errors of joint accelerations, grasp forces and object acceleration."""
    return {
        "qdd": relative(result.qdd, np.concatenate(answer["qdd"])),
        "f": relative(result.grasp_wrench, np.array(answer["f"])),
        "alpha_C": relative(result.object_acceleration, answer["alpha_C"]),
    }


def disagreement(a: ForwardResult, b: ForwardResult) -> float:
    """Return the largest difference of two results over all fields, relative to max(1, size)."""
    return max(relative(getattr(a, name), getattr(b, name), floor=1.0) for name in ANSWERS)
