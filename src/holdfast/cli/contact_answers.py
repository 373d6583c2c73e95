"""Answers of `holdfast solve` to contacts of the object with the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Console

from holdfast.cli.force_answers import relative_error
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.dynamics.contact.solved_contacts import ContactMode, ContactStatus
from holdfast.dynamics.contact.touch import touch
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.object_level import object_mobility
from holdfast.errors import ContactError, MethodNotApplicable, SingularChainError, StateError
from holdfast.io.contact_case import ContactCase
from holdfast.io.contact_case_data import ContactExpected, RodExpected
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench

OF_IMPACTS = "an impact is answered by 'sequential'; try no --method"
WORDS = {
    ContactStatus.OK: "one solution",
    ContactStatus.INDETERMINATE_FORCES: "one motion; contact forces are not unique",
    ContactStatus.AMBIGUOUS: "several solutions: a motion or an impulse without a collision is not decided by the laws",
}


@dataclass(frozen=True, eq=False)
class ContactAnswer:
    """An answer about contacts, or the reason why there is none.

    Attributes:
        case: the problem.
        method: name of the algorithm.
        status: name of the `ContactStatus`; "refused" if there is no answer.
        reason: why there is none, or what to know about it.
        found: the fields of `expected`; None where there is nothing to tell.
    """

    case: ContactCase
    method: str
    status: str = "refused"
    reason: str | None = None
    found: dict[str, Any] = field(default_factory=dict)

    @property
    def answered(self) -> bool:
        """Whether there is a verdict; that there is no solution is one."""
        return self.status != "refused"

    @property
    def error(self) -> float | None:
        """The largest of max|x - e| / max(1, max|e|) over what is expected; 1 for other modes or another verdict."""
        expected = self.case.expected
        if not self.answered or expected is None:
            return None
        names = [name for name in expected.__struct_fields__ if name not in NOT_COMPARED]
        pairs = [(self.found.get(name), getattr(expected, name)) for name in names]
        if isinstance(expected, ContactExpected) and not expected.contact_force_unique:
            pairs = [pair for name, pair in zip(names, pairs, strict=True) if name not in ("contact_force", "modes")]
        errors = [self._difference(got, wanted) for got, wanted in pairs if wanted is not None]
        if isinstance(expected, RodExpected) and (expected.normal_force is None) != (
            self.found["normal_force"] is None
        ):
            errors.append(1.0)
        return max(errors, default=0.0)

    @staticmethod
    def _difference(got: Any, wanted: Any) -> float:
        if got is None:
            return 1.0
        if isinstance(wanted, bool) or (isinstance(wanted, list) and wanted and isinstance(wanted[0], str)):
            return float(got != wanted)
        flat = [np.concatenate([np.ravel(part) for part in x]) if isinstance(x, list) else x for x in (got, wanted)]
        return relative_error(*flat)

    def as_json(self) -> dict[str, object]:
        """Return the answer as plain data."""
        return {
            "name": self.case.name,
            "method": self.method,
            "status": self.status,
            "reason": self.reason,
            **self.found,
            "error_vs_expected": self.error,
        }

    @property
    def line(self) -> tuple[str, str, str, str]:
        """Status, nothing for rank and mobility, and error for a table."""
        status = self.status if self.answered else f"refused: {(self.reason or '').partition(':')[0]}"
        return status, "", "", "" if self.error is None else f"{self.error:.1e}"

    def print_numbers(self, console: Console) -> None:
        """Print the reason and what was found."""
        if self.reason is not None:
            console.print(self.reason, soft_wrap=True)
        for name, value in self.found.items():
            console.print(f"{name}: {value}", soft_wrap=True)


NOT_COMPARED = ("margin", "words")


def contact_answers(case: ContactCase, methods: Sequence[str]) -> list[ContactAnswer]:
    """Return the answer of every method."""
    return [_answer(case, method) for method in methods]


def _answer(case: ContactCase, method: str) -> ContactAnswer:
    if case.kind == "impact" and method != "sequential":
        return ContactAnswer(case, method, reason=f"not_applicable: {OF_IMPACTS}")
    try:
        return _impact(case, method) if case.kind == "impact" else _forces(case, method)
    except ContactError as cause:
        found = _of_rod(case, None) if case.kind == "rod" else {}
        status = "refused" if cause.status == ContactStatus.UNRESOLVED.name else cause.status
        return ContactAnswer(case, method, status, f"{cause.status.lower()}: {cause}", found)
    except MethodNotApplicable as cause:
        return ContactAnswer(case, method, reason=f"not_applicable: {cause}")
    except SingularChainError as cause:
        return ContactAnswer(case, method, reason=f"singular: {cause}")
    except StateError as cause:
        return ContactAnswer(case, method, reason=f"inconsistent: {cause}")


def _impact(case: ContactCase, method: str) -> ContactAnswer:
    hit, chain = touch(case.chain, case.state, inputs=case.inputs), case.chain
    found = {
        **_contacts(hit.touch_mode, hit.touch_impulse, hit.touch_status, hit.touch_wrench),
        "object_twist": hit.state.object_twist.tolist(),
        "qd": [hit.state.qd[chain.joints[name]].tolist() for name in chain.names],
        "grasp_impulse": hit.grasp_impulse.tolist(),
        "energy_change": hit.energy_change,
    }
    return ContactAnswer(case, method, hit.touch_status.name, _words(hit.touch_status), found)


def _forces(case: ContactCase, method: str) -> ContactAnswer:
    chain, state = case.chain, case.state
    r = forward_dynamics(chain, state, case.tau, inputs=case.inputs, method=method)
    status, force, mode = r.touch_status, r.touch_force, r.touch_mode
    assert status is not None and force is not None and mode is not None
    if case.kind == "rod":
        unique = force[0, 2] if status is ContactStatus.OK else None
        return ContactAnswer(case, method, status.name, _words(status), _of_rod(case, unique, status))
    assert chain.touching is not None
    points = contact_rows(chain.touching, state.object_frame, state.object_twist).point
    wrench = sum(shift_wrench(l, np.concatenate([np.zeros(3), f])) for l, f in zip(points, force, strict=True))
    found = {
        **_contacts(mode, force, status, np.asarray(wrench)),
        "qdd": [r[name].qdd.tolist() for name in chain.names],
        "f": r.grasp_wrench.tolist(),
        "alpha_C": r.object_acceleration.tolist(),
    }
    return ContactAnswer(case, method, status.name, _words(status), found)


def _words(status: ContactStatus) -> str | None:
    return None if status is ContactStatus.OK else WORDS[status]


def _contacts(mode: Array, force: Array, status: ContactStatus, wrench: Array) -> dict[str, Any]:
    return {
        "modes": [ContactMode(int(one)).name.lower() for one in mode],
        "contact_force": force.tolist(),
        "contact_force_unique": status is ContactStatus.OK,
        "object_wrench": wrench.tolist(),
    }


def _of_rod(case: ContactCase, normal_force: float | None, status: ContactStatus | None = None) -> dict[str, Any]:
    """Return p = n^T P (n - mu t), the free acceleration of the end along the normal, and the force."""
    chain, state = case.chain, case.state
    assert chain.touching is not None
    rows = contact_rows(chain.touching, state.object_frame, state.object_twist)
    (C,), (u,), (drift,), (mu,) = rows.C, rows.velocity(state.object_twist), rows.drift, rows.friction
    t = u[:2] / np.linalg.norm(u[:2])
    along = C[2] - mu * (t @ C[:2])
    free = float(C[2] @ np.concatenate([np.zeros(3), chain.gravity]) + drift[2])
    words = "no solution: an impulse without a collision follows" if status is None else WORDS[status]
    return {
        "p": float(C[2] @ object_mobility(chain, state) @ along),
        "free_normal_acceleration": free,
        "normal_force": None if normal_force is None else float(normal_force),
        "words": words,
    }
