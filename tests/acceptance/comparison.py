"""Comparing an answer of the library with one of the oracle, field by field."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics import ForwardResult
from tests.oracles.every_body import EveryBody, Truth
from tests.systems.problems import ANSWERS
from tests.systems.problems import relative_gap as relative

__all__ = ["disagreement", "errors", "relative", "trunk_errors"]


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


def trunk_errors(result: ForwardResult, oracle: EveryBody, truth: Truth) -> dict[str, float]:
    """Return the relative errors of a chain with a trunk; where forces are not unique, of what drives and object feel.

    Args:
        result: of a method.
        oracle: what solved the same problem.
        truth: its solution.
    """
    chain = result.chain
    found = {
        "qdd": relative(result.qdd, truth.qdd),
        "alpha_C": relative(result.object_acceleration, truth.object_acceleration),
        "felt": relative(oracle.felt({name: result[name].grasp_wrench for name in chain.grasps}), truth.felt),
        "trunk's base": relative(result.trunk_base_wrench, truth.trunk_base_wrench, floor=1.0),
    }
    if truth.base_acceleration is not None:
        found["base"] = relative(result.base_acceleration, truth.base_acceleration)
    if oracle.unique:
        found["f"] = relative(result.grasp_wrench, truth.grasp_wrench)
        found["arms' bases"] = relative(result.base_wrench, truth.base_wrench)
    return found
