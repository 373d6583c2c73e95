"""Questions with answers in 50 digits that machine code can be asked: those of least effort."""

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
    """A question of least effort.

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
    def rows(self) -> np.ndarray:
        """The rows on the object's acceleration that are asked, (6, 6)."""
        return self.call.get("task", np.eye(6))

    @property
    def efforts(self) -> np.ndarray:
        """Effort limits, 1 without one."""
        limits = np.array([joint.effort_limit for joint in self.chain.all_joints])
        return np.where(np.isfinite(limits), limits, 1.0)


@cache
def all_cases() -> dict[str, Asked]:
    """Return the questions of least effort by name."""
    found = {}
    for case in hf.io.load_cases(FILE):
        assert isinstance(case, ForceCase)
        if case.form == "effort":
            task = None if np.array_equal(case.asked.rows, np.eye(6)) else case.asked.rows
            call = distribution_parameters(case.chain, case.state, case.limits, case.cost, task)
            call["force_scale"] = np.array(case.force)
            found[case.name] = Asked(case.chain, case.state, call, case.asked.smallest, case.expected)
    return found


@cache
def force_cases() -> dict[str, Asked]:
    """Return by name those about arms in the world whose whole acceleration is asked."""
    return {name: of for name, of in all_cases().items() if of.chain.trunk is None and "task" not in of.call}


@cache
def border_cases() -> dict[str, Asked]:
    """Return by name the others, in which arms share accelerations of a trunk or of the object."""
    return {name: of for name, of in all_cases().items() if name not in force_cases()}
