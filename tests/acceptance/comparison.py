"""Comparing an answer of the library with one of the oracle, field by field."""

from __future__ import annotations

import numpy as np

from holdfast import ForwardResult


def relative(x: object, expected: object, floor: float = 0.0) -> float:
    """Return max|x - e| / max(floor, max|e|)."""
    x, e = np.ravel(x), np.ravel(expected)
    return float(np.abs(x - e).max(initial=0.0) / max(floor, np.abs(e).max(initial=0.0), 1e-300))


def errors(result: ForwardResult, answer: dict) -> dict[str, float]:
    """Return the relative errors of joint accelerations, grasp forces and object acceleration."""
    return {
        "qdd": relative(result.qdd, np.concatenate(answer["qdd"])),
        "f": relative(result.grasp_wrench, np.array(answer["f"])),
        "alpha_C": relative(result.object_acceleration, answer["alpha_C"]),
    }


def disagreement(a: ForwardResult, b: ForwardResult) -> float:
    """Return the largest difference of two results over all fields, relative to max(1, size)."""
    fields = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")
    return max(relative(getattr(a, name), getattr(b, name), floor=1.0) for name in fields)
