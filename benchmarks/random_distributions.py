"""Random questions about forces: residuals, verdicts against the least violation, and costs beside Clarabel.

    python -m benchmarks.random_distributions --count 10000 [--first 0]

Chains of 2 to 6 arms with all kinds of grasps, in the world, on trunks and on floating bases, half of them asked for
what their limits do not allow. Clarabel (pip install clarabel) is compared if it is installed. What machine code runs
is asked on floats, with its 16 iterations, about as many chains whose bases are in the world.
"""

from __future__ import annotations

import argparse
from collections import Counter
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from tests.systems.limited import asked_of, limited_problem

from holdfast.errors import HoldfastError
from holdfast.forces.acceleration_map import acceleration_map, motion_without_torques, scaled_map
from holdfast.forces.affine_map import AccelerationTask
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.distribute import elastic
from holdfast.forces.elastic_distribution import DISTRIBUTE
from holdfast.forces.force_question import ForceQuestion, force_question
from holdfast.forces.limit_rows import limit_rows
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.forces.programmes import Form, Posed, costs
from holdfast.forces.smooth_distribution import smooth_parameters, smooth_solution
from holdfast.questions.derivatives import asked_case

clarabel: Any = import_module("clarabel") if find_spec("clarabel") else None

FORMS: tuple[Form, ...] = ("effort", "elastic", "margin", "peak", "scale", "violation")
PRICE = ForceCost().price
CLEAR = 1e-6  # least violations beyond this, in units of F0, leave no doubt
SOLVED = ("Solved", "PrimalInfeasible", "DualInfeasible")


class Outcome(NamedTuple):
    """The answer to one question.

    Attributes:
        seed: of the question.
        form: what was asked.
        verdict: how it ended.
        residual: of the conditions, or of the proof.
        least: least violation [F0]; NaN if no limit bounds it.
        wrong: whether the verdict contradicts the least violation.
        gap: difference of values from Clarabel's, relative to max(1, |value|); NaN where one of them does not solve it.
        other: Clarabel's verdict; empty without it.
    """

    seed: int
    form: Form
    verdict: Verdict
    residual: float
    least: float
    wrong: bool
    gap: float
    other: str


def question(seed: int, form: Form) -> ForceQuestion:
    """Return a random question.

    Raises:
        StateError: the arms cannot give the object the acceleration that is asked.
    """
    p = limited_problem(seed)
    values, task = asked_of(seed)
    motion = motion_without_torques(p.chain, p.state, p.inputs.shaped(p.chain))
    v1 = None
    if form == "scale":
        found, v1 = scaled_map(motion, AccelerationTask(np.eye(6), np.zeros(6)), np.resize(values, 6))
    else:
        found = acceleration_map(motion, AccelerationTask(np.eye(6) if task is None else task, values))
    return ForceQuestion(p.state, found, limit_rows(found, p.state, ForceLimits()), costs(found, ForceCost()), v1)


def by_clarabel(of: Posed) -> tuple[str, float]:
    """Return Clarabel's verdict and value."""
    P, c, G, h, cones = of.programme
    kinds: list[Any] = [clarabel.NonnegativeConeT(cones.rows)] if cones.rows else []
    kinds += [clarabel.SecondOrderConeT(cones.size)] * cones.number
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = 1e-11
    done = clarabel.DefaultSolver(sparse.csc_matrix(np.triu(P)), c, sparse.csc_matrix(G), h, kinds, settings).solve()
    return str(done.status), float(done.obj_val)


def outcome(seed: int, form: Form) -> Outcome:
    """Return the answer to a random question.

    Raises:
        StateError: the arms cannot give the object the acceleration that is asked.
    """
    asked = question(seed, form)
    of = asked.posed(form, PRICE)
    done = asked.asked(form, PRICE)
    still = asked if asked.v1 is None else asked._replace(v1=None)  # sigma = 0
    least = done if form == "violation" else still.asked("violation")
    v = least.extra if least.verdict is Verdict.OPTIMAL else np.nan
    wrong = done.verdict is Verdict.INFEASIBLE and (v < -CLEAR or form in ("elastic", "violation"))
    wrong |= form == "effort" and done.verdict is Verdict.OPTIMAL and v > CLEAR
    if form == "elastic":
        status = elastic(asked, PRICE).status
        wrong |= status == ("infeasible" if v < -CLEAR else "optimal" if v > CLEAR else "")
    gap, other = np.nan, ""
    if clarabel is not None:
        other, value = by_clarabel(of)
        if other == "Solved" and done.verdict is Verdict.OPTIMAL:
            own = done.value - of.constant if form in ("effort", "elastic") else abs(done.extra)
            gap = abs(own - (value if form in ("effort", "elastic") else abs(value))) / max(1.0, abs(own))
    return Outcome(seed, form, done.verdict, done.residual, v, bool(wrong), gap, other)


class Text(NamedTuple):
    """What the text of machine code says of a question.

    Attributes:
        seed: of the question.
        residual: of the optimality conditions.
        gap: difference of the costs from the reference's, relative to max(1, |cost|).
    """

    seed: int
    residual: float
    gap: float


@np.errstate(all="ignore")
def text(seed: int) -> Text:
    """Return what the text of machine code says of a random question about arms in the world.

    Raises:
        StateError: the arms cannot give the object the acceleration that is asked.
    """
    p = limited_problem(seed, trunks=False)
    wanted = 2.0 * np.random.default_rng([seed, 43]).normal(size=6)
    call = {"chain": p.chain, "state": p.state, "acceleration": wanted, "task": None, "cost": None, "limits": None}
    call |= {"inputs": p.inputs}
    asked, case = force_question(**call), asked_case(DISTRIBUTE, call | {"form": "elastic"}, smooth_parameters)
    found = smooth_solution(case, asked.found, asked.limits, asked.costs)
    expected = asked.asked("elastic", PRICE)
    return Text(seed, found.residual, abs(found.value - expected.value) / max(1.0, abs(expected.value)))


def outcomes(first: int, count: int) -> tuple[list[Outcome], list[Text], Counter[str]]:
    """Return the answers to some questions, form by form in turn, and why others could not be asked."""
    found, texts, refused = [], [], Counter[str]()
    for seed in range(first, first + count):
        for answers, ask in ((found, lambda seed: outcome(seed, FORMS[seed % len(FORMS)])), (texts, text)):
            try:
                answers.append(ask(seed))
            except HoldfastError as cause:
                refused[str(cause).partition(";")[0]] += 1
    return found, texts, refused


def main() -> None:
    """Print counts, residuals, wrong verdicts and gaps."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--count", type=int, default=10000)
    arguments.add_argument("--first", type=int, default=0)
    given = arguments.parse_args()
    found, texts, refused = outcomes(given.first, given.count)
    for form in FORMS:
        own = [one for one in found if one.form == form]
        verdicts = ", ".join(f"{n} {name}" for name, n in Counter(one.verdict.value for one in own).items())
        print(f"{form:10} {len(own):6}: {verdicts}")
    decided = np.array([one.residual for one in found])
    shares = [f"{share:.0%}: {np.quantile(decided, share):.1e}" for share in (0.5, 0.9, 0.99)]
    print(
        f"residuals {', '.join(shares)}, largest: {decided.max():.1e}; at most 1e-9 on {np.mean(decided <= 1e-9):.2%}"
    )
    print(f"wrong verdicts: {sum(one.wrong for one in found)}; refused: {dict(refused) or 'none'}")
    if clarabel is not None:
        gaps = np.array([one.gap for one in found])
        gaps = gaps[np.isfinite(gaps)]
        print(f"values beside Clarabel ({len(gaps)}): 99 %: {np.quantile(gaps, 0.99):.1e}, largest: {gaps.max():.1e}")
        pairs = Counter((one.verdict.value, one.other) for one in found)
        print("; ".join(f"{ours} / {theirs}: {n}" for (ours, theirs), n in sorted(pairs.items())))
        for one in found:
            opposed = (one.verdict is Verdict.INFEASIBLE and one.other == "Solved") or (
                one.verdict is Verdict.OPTIMAL and one.other == "PrimalInfeasible"
            )
            if opposed or one.gap > 1e-7:
                print(one)
    residuals, gaps = (np.array(x) for x in zip(*(one[1:] for one in texts), strict=True))
    shares = [f"{share:.0%}: {np.quantile(residuals, share):.1e}" for share in (0.5, 0.9, 0.99)]
    print(
        f"text of machine code, 16 iterations ({len(texts)}): residuals {', '.join(shares)}, largest:"
        f" {residuals.max():.1e}; above 1e-6: {(residuals > 1e-6).sum()}; costs beside the reference: 99 %:"
        f" {np.quantile(gaps, 0.99):.1e}, largest: {gaps.max():.1e}"
    )
    for one in texts:
        if one.residual > 1e-6 or one.gap > 1e-6:
            print(one)
    for one in found:
        if one.wrong or one.residual > 1e-7 or one.verdict is Verdict.UNDECIDED:
            print(one)


if __name__ == "__main__":
    main()
