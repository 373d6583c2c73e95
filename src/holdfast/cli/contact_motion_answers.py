"""Answers of `holdfast solve` to motions in which an object touches the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Console

from holdfast.control.controller import ControlLaw
from holdfast.errors import HoldfastError
from holdfast.io.contact_motion import ContactMotion, error_of
from holdfast.simulation.contact_events import EVENTS_WAY, IMPULSES_WAY
from holdfast.simulation.simulate import simulate

DEFAULT = "sequential"  # the default of `holdfast solve`
STEP = 1e-3  # s, of steps with impulses


@dataclass(frozen=True, eq=False)
class ContactMotionAnswer:
    """What a run finds of a motion, or the reason why there is none.

    Attributes:
        case: the motion.
        method: how contacts are followed.
        reason: why there is no answer; None if there is one.
        found: the fields of `expected`.
    """

    case: ContactMotion
    method: str
    reason: str | None = None
    found: dict[str, Any] = field(default_factory=dict)

    @property
    def answered(self) -> bool:
        """Whether there is an answer."""
        return self.reason is None

    @property
    def error(self) -> float | None:
        """The largest difference from what is expected, relative to it; None if nothing is."""
        return error_of(self.case, self.found) if self.answered else None

    def as_json(self) -> dict[str, object]:
        """Return the answer as plain data."""
        status = "ok" if self.answered else "refused"
        plain = {name: np.array(x).tolist() for name, x in self.found.items()}
        known = {name: x if np.isfinite(np.array(x)).all() else None for name, x in plain.items()}
        error = self.error if self.error is None or np.isfinite(self.error) else None
        shared = {"name": self.case.name, "method": self.method, "status": status, "reason": self.reason}
        return {**shared, **known, "error_vs_expected": error}

    @property
    def line(self) -> tuple[str, str, str, str]:
        """Status, nothing for rank and mobility, and error for a table."""
        status = "ok" if self.answered else f"refused: {(self.reason or '').partition(':')[0]}"
        return status, "", "", "" if self.error is None else f"{self.error:.1e}"

    def print_numbers(self, console: Console) -> None:
        """Print what was found beside what is expected."""
        for name, value in self.found.items():
            wanted = self.case.expected.get(name)
            console.print(f"{name}: {value}" + (f", expected {wanted}" if wanted is not None else ""), soft_wrap=True)


def contact_motion_answers(case: ContactMotion, methods: Sequence[str]) -> list[ContactMotionAnswer]:
    """Return the answer by events, and for all methods that by steps, too; other methods do not apply."""
    if DEFAULT not in methods:
        reason = f"not_applicable: a motion is answered by simulate(contacts={EVENTS_WAY!r}); try no --method, or all"
        return [ContactMotionAnswer(case, methods[0], reason)]
    return [_answer(case, way, step) for way, step in ((EVENTS_WAY, case.step), (IMPULSES_WAY, STEP))[: len(methods)]]


def _answer(case: ContactMotion, way: str, step: float) -> ContactMotionAnswer:
    chain = case.chain()
    none = np.zeros(chain.joint_count)
    try:
        unpowered = ControlLaw(lambda t, state, memory, given: (none, memory))
        run = simulate(chain, case.state(), unpowered, case.duration, step, contacts=way)
        if run.stopped is not None:
            return ContactMotionAnswer(case, way, f"stopped: {run.stopped}")
        return ContactMotionAnswer(case, way, None, case.found(run))
    except HoldfastError as cause:
        return ContactMotionAnswer(case, way, f"inconsistent: {cause}")
