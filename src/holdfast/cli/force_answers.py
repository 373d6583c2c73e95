"""Answers of `holdfast solve` to questions about forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.consistency import require_closed, require_rates
from holdfast.errors import StateError
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.distribute import proof
from holdfast.forces.force_question import ForceQuestion
from holdfast.forces.programmes import Solved
from holdfast.io.force_case import ForceCase, listed_name
from holdfast.spatial.scalar import Array

METHOD = "embedding"  # the homogeneous embedding of `forces.cone_solver`
NO_MULTIPLIER = 1e-12  # multipliers of which all entries are below this are left out


@dataclass(frozen=True, eq=False)
class ForceAnswer:
    """An answer to a question about forces, or the reason why there is none.

    Attributes:
        case: the question.
        method: name of the algorithm.
        question: the programmes; None if refused.
        solved: the answer; None if refused.
        violation: the answer to the least violation, for a scale at sigma = 1; None if refused.
        reason: `not_applicable: ...`, `inconsistent: ...` or `impossible: ...` if refused; which limits conflict if
            they do.
    """

    case: ForceCase
    method: str
    question: ForceQuestion | None = None
    solved: Solved | None = None
    violation: Solved | None = None
    reason: str | None = None

    @property
    def status(self) -> str:
        """`optimal`, `infeasible`, `unbounded`, `undecided` or `refused`."""
        return "refused" if self.solved is None else self.solved.verdict.value

    @property
    def answered(self) -> bool:
        """Whether there is a verdict."""
        return self.solved is not None

    @property
    def line(self) -> tuple[str, str, str, str]:
        """Status, nothing for rank and mobility, and error for a table."""
        status = self.status if self.answered else f"refused: {(self.reason or '').partition(':')[0]}"
        return status, "", "", "" if self.error is None else f"{self.error:.1e}"

    def print_numbers(self, console: Console) -> None:
        """Print the reason, or the value and the torques."""
        if self.answered and self.reason is not None:
            console.print(self.reason, soft_wrap=True)
        found = self.found
        if found["value"] is not None:
            console.print(f"{self.case.form}: value {found['value']:.6g}")
        if self.question is None or self.solved is None or found["tau"] is None:
            return
        table = Table("joint", "torque", "acceleration", title="torques [N m or N] and joint accelerations")
        mapped, v = self.question.found, self.solved.v
        for name, tau, qdd in zip(self.case.chain.joint_names(), mapped.T @ v + mapped.t, v[mapped.qdd], strict=True):
            table.add_row(name, f"{tau:+.6g}", f"{qdd:+.6g}")
        console.print(table)

    @property
    def found(self) -> dict[str, Any]:
        """The fields of `expected` in a case file; null where there is nothing to tell."""
        names = ("value", "tau", "qdd", "alpha_C", "f", "prices", "margin", "peak", "scale")
        names = (*names, "least_violation", "certificate", "certificate_residual")
        found: dict[str, Any] = dict.fromkeys(map(str, names))
        if self.question is None or self.solved is None or self.violation is None:
            return found
        if self.violation.verdict is Verdict.OPTIMAL:
            found["least_violation"] = self.violation.extra * self.case.force
        if self.solved.verdict is Verdict.INFEASIBLE:
            of_all = proof(self.question, self.violation)
            found["certificate"] = self._listed(self.violation.parts)
            found["certificate_residual"] = of_all.residual
        if self.solved.verdict is Verdict.OPTIMAL:
            found |= self._forces() if self.case.form == "effort" else self._extreme()
        return found

    def _forces(self) -> dict[str, object]:
        """Return torques, accelerations and wrenches; those of a floating base come first."""
        assert self.question is not None and self.solved is not None
        found, v = self.question.found, self.solved.v
        return {
            "value": self.solved.value,
            "tau": [*[0.0] * found.base.stop, *(found.T @ v + found.t).tolist()],
            "qdd": v[: found.qdd.stop].tolist(),
            "alpha_C": v[found.alpha].tolist(),
            "f": found.grasp_wrenches(v).tolist(),
            "prices": self._listed(self.solved.parts),
        }

    def _extreme(self) -> dict[str, object]:
        """Return the number that is extreme, and the value, which is to be small."""
        assert self.solved is not None
        form, extra = self.case.form, self.solved.extra
        return {
            "value": extra if form == "peak" else -extra,
            form: extra * (self.case.force if form == "margin" else 1),
        }

    def _listed(self, parts: list[Array]) -> dict[str, list[float]]:
        assert self.question is not None
        named = zip(self.question.limits, parts, strict=True)
        return {listed_name(limit): z.tolist() for limit, z in named if np.abs(z).max() > NO_MULTIPLIER}

    @property
    def error(self) -> float | None:
        """The largest of max|x - e| / max(1, max|e|) over what is expected; 1 for another verdict."""
        expected, found = self.case.expected, self.found
        if expected is None or self.solved is None:
            return None
        decided = expected.status in ("optimal", "infeasible")
        if decided and self.status != expected.status:
            return 1.0
        names = ["least_violation"]
        names += ["value", "tau", "qdd", "alpha_C", "f", "margin", "peak", "scale"] if decided else []
        pairs = [(found[name], getattr(expected, name)) for name in names]
        errors = [relative_error(got, wanted) for got, wanted in pairs if wanted is not None and got is not None]
        return max(errors, default=0.0)

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


def relative_error(got: object, wanted: object) -> float:
    """Return max|x - e| / max(1, max|e|)."""
    a, b = np.asarray(got, dtype=float), np.asarray(wanted, dtype=float)
    return float(np.abs(a - b).max(initial=0.0)) / max(1.0, float(np.abs(b).max(initial=0.0)))


def force_answer(case: ForceCase) -> ForceAnswer:
    """Return the answer to a question about forces."""
    with np.errstate(all="ignore"):  # numbers beyond float64's range are refused below, not warned of
        motion = chain_motion(case.chain, case.state, np.zeros(case.chain.joint_count), case.inputs.shaped(case.chain))
        try:
            require_closed(motion, case.state)
            if case.rates is not None:
                require_rates(motion, case.rates)
        except StateError as cause:
            return ForceAnswer(case, METHOD, reason=f"inconsistent: {cause}")
        try:
            question = case.question()
        except StateError as cause:
            return ForceAnswer(case, METHOD, reason=f"impossible: {cause}")
        solved = question.asked(case.form)
        least = question.whole().asked("violation")
    words = proof(question, least).words if solved.verdict is Verdict.INFEASIBLE else None
    return ForceAnswer(case, METHOD, question, solved, least, words)
