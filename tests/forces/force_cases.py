"""Questions with answers in 50 digits that machine code can be asked: least effort of arms in the world."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf
from holdfast.forces import distribution_parameters
from holdfast.io.force_case import ForceCase

FILE = Path(__file__).parents[1] / "data" / "cases_forces.json"


class Asked(NamedTuple):
    """A question about arms in the world.

    Attributes:
        chain, state: the chain and its state.
        call: what the compiled function is given by name besides the state.
        acceleration: what is asked of the object.
        expected: as in the file.
    """

    chain: hf.ClosedChain
    state: hf.State
    call: dict[str, Any]
    acceleration: np.ndarray
    expected: Any

    @property
    def arguments(self) -> tuple[np.ndarray, ...]:
        """The inputs of `distribute` in order."""
        s = self.state
        return s.q, s.qd, s.object_pose, s.object_twist, self.acceleration

    @property
    def efforts(self) -> np.ndarray:
        """Effort limits, 1 without one."""
        limits = np.array([joint.effort_limit for joint in self.chain.all_joints])
        return np.where(np.isfinite(limits), limits, 1.0)


@cache
def force_cases() -> dict[str, Asked]:
    """Return by name the questions of least effort about arms in the world whose whole acceleration is asked."""
    found = {}
    for case in hf.io.load_cases(FILE):
        assert isinstance(case, ForceCase)
        if case.form == "effort" and case.chain.trunk is None and np.array_equal(case.asked.rows, np.eye(6)):
            call = distribution_parameters(case.chain, case.state, case.limits, case.cost)
            call["force_scale"] = np.array(case.force)
            found[case.name] = Asked(case.chain, case.state, call, case.asked.values, case.expected)
    return found
