"""One problem case answered by one algorithm, in the layout of the case file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.consistency import require_closed, require_rates
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.errors import MethodNotApplicable, ModelError, SingularChainError, StateError
from holdfast.io.case_file import Case, ExpectedData
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench


@dataclass(frozen=True, eq=False)
class Answer:
    """A result, or the reason why there is none.

    Attributes:
        case: the problem.
        method: the algorithm's name.
        result: what forward dynamics returned; None if refused.
        reason: `not_applicable: ...`, `singular: ...` or `inconsistent: ...`; None if solved.
        error: largest relative difference to the expected answer; None without one.
    """

    case: Case
    method: str
    result: ForwardResult | None = None
    reason: str | None = None
    error: float | None = None

    def as_json(self) -> dict[str, object]:
        """Return the answer as plain data; per arm, base to tip; numbers are null if refused."""
        r, names = self.result, self.case.chain.names
        return {
            "name": self.case.name,
            "method": self.method,
            "status": "refused" if r is None else "ok",
            "reason": self.reason,
            "qdd": None if r is None else [r[name].qdd.tolist() for name in names],
            "f": None if r is None else r.grasp_wrench.tolist(),
            "alpha_C": None if r is None else r.object_acceleration.tolist(),
            "W_dot": None if r is None else [r[name].contact_acceleration.tolist() for name in names],
            "f_unique": r is not None and r.status is Status.OK,
            "rank": None if r is None else r.rank,
            "mobility": None if r is None else r.mobility,
            "error_vs_expected": self.error,
        }


def answers(case: Case, methods: list[str]) -> list[Answer]:
    """Return the answer of every method to a case."""
    with np.errstate(all="ignore"):  # numbers beyond float64's range are refused below, not warned of
        motion = chain_motion(case.chain, case.state, case.tau, case.inputs.shaped(case.chain))
        try:
            require_closed(motion, case.state)
            if case.rates is not None:
                require_rates(motion, case.rates)
        except StateError as cause:
            return [Answer(case, method, reason=f"inconsistent: {cause}") for method in methods]
        found: list[Answer] = []
        for method in methods:
            ranks = [answer.result.rank for answer in found if answer.result is not None]
            # a rank once accepted is the generic one; looking for it again would take most of the time
            found.append(_answer(case, motion, method, ranks[0] if ranks else None))
        return found


def _answer(case: Case, motion: ChainMotion, method: str, generic_rank: int | None) -> Answer:
    options = {"inputs": case.inputs, "method": method, "check": False, "generic_rank": generic_rank}
    try:
        result = forward_dynamics(case.chain, case.state, case.tau, **options)
    except MethodNotApplicable as cause:
        return Answer(case, method, reason=f"not_applicable: {cause}")
    except (SingularChainError, ModelError) as cause:  # the latter: an arm whose mass matrix is singular
        return Answer(case, method, reason=f"singular: {cause}")
    numbers = (result.qdd, result.grasp_wrench, result.object_acceleration, result.contact_acceleration)
    if not all(np.isfinite(part).all() for part in numbers):
        return Answer(case, method, reason="singular: the answer is not finite; masses or lengths too far apart?")
    error = None if case.expected is None else error_vs_expected(result, case.expected, motion)
    return Answer(case, method, result, error=error)


def error_vs_expected(result: ForwardResult, expected: ExpectedData, motion: ChainMotion) -> float:
    """Return the largest of max|x - e| / max(1, max|e|) over qdd, f, alpha(C) and W_dot.

    All arms of a quantity together. Where f is not unique, sum_i phi(C, O_i) f_i takes its place.
    """
    wanted_f = np.array(expected.f)
    f = (result.grasp_wrench, wanted_f)
    if result.status is not Status.OK:
        f = (_about_C(result.grasp_wrench, motion), _about_C(wanted_f, motion))
    pairs = (
        (result.qdd, np.concatenate([np.array(part) for part in expected.qdd])),
        f,
        (result.object_acceleration, np.array(expected.alpha_C)),
        (result.contact_acceleration, np.concatenate([np.array(part) for part in expected.W_dot])),
    )
    return max(_relative_error(got, wanted) for got, wanted in pairs)


def _relative_error(got: Array, wanted: Array) -> float:
    return float(np.abs(got - wanted).max(initial=0.0)) / max(1.0, float(np.abs(wanted).max(initial=0.0)))


def _about_C(wrenches: Array, motion: ChainMotion) -> Array:
    """Return the total wrench on the object about C, (6,)."""
    return np.sum([shift_wrench(c.offset, f) for c, f in zip(motion.contacts, wrenches, strict=True)], axis=0)
