"""`holdfast solve`: forward dynamics of problem cases by one or all algorithms; `holdfast methods` lists these."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from holdfast.cli.console import print_document, read_input, stdout, with_progress
from holdfast.cli.contact_answers import ContactAnswer, contact_answers
from holdfast.cli.contact_motion_answers import ContactMotionAnswer, contact_motion_answers
from holdfast.cli.force_answers import METHOD as FORCE_METHOD
from holdfast.cli.force_answers import ForceAnswer, force_answer, relative_error
from holdfast.cli.forest_answers import COMPILED, ForestAnswer, forest_answers
from holdfast.cli.options import CaseFile, Format, Name, OptionalName, Switch
from holdfast.cli.streams import EXIT_REFUSED
from holdfast.compiled.chain import compile
from holdfast.compiled.result import CompiledResult
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.consistency import require_closed, require_rates
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.methods import METHODS
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.errors import MethodNotApplicable, ModelError, SceneError, SingularChainError, StateError
from holdfast.io.case_data import CaseExpected
from holdfast.io.case_file import AnyCase, Case, parse_cases
from holdfast.io.contact_case import ContactCase
from holdfast.io.contact_motion import ContactMotion
from holdfast.io.files import one_line
from holdfast.io.force_case import ForceCase
from holdfast.io.forest_case import ForestCase
from holdfast.io.typed import refusal
from holdfast.model import checks
from holdfast.model.trunk import TRUNK
from holdfast.questions.arrays import ARRAYS, state_fields
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench

OF_FORCES = f"a question about forces is answered by '{FORCE_METHOD}'; try no --method, or all"


@dataclass(frozen=True, eq=False)
class Answer:
    """A result, or the reason why there is none.

    Attributes:
        case: the problem.
        method: name of the algorithm.
        result: result of forward dynamics; None if refused.
        reason: `not_applicable: ...`, `singular: ...` or `inconsistent: ...`; None if solved.
        error: largest relative difference from the expected results; None if the case has none.
    """

    case: Case
    method: str
    result: ForwardResult | None = None
    reason: str | None = None
    error: float | None = None

    def as_json(self) -> dict[str, object]:
        """Return the answer as plain data, by arm and from base to tip; numbers are null if refused."""
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
            "base_wrench": None if r is None else r.base_wrench.tolist(),
            "trunk": None if r is None else _of_trunk(r),
            "f_unique": r is not None and r.status is Status.OK,
            "rank": None if r is None else r.rank,
            "mobility": None if r is None else r.mobility,
            "error_vs_expected": self.error,
        }

    @property
    def answered(self) -> bool:
        """Whether there is a result."""
        return self.result is not None

    @property
    def line(self) -> tuple[str, str, str, str]:
        """Status, rank, mobility and error for a table."""
        if self.result is None:
            return f"refused: {_kind(self)}", "", "", ""
        r = self.result
        status = "ok" if r.status is Status.OK else "ok, f not unique"
        error = "" if self.error is None else f"{self.error:.1e}"
        return status, f"{r.rank} of {r.chain.constraint_row_count}", str(r.mobility), error

    def print_numbers(self, console: Console) -> None:
        """Print joint accelerations, grasp forces and the object's acceleration of the answer."""
        r = self.result
        if r is None:
            return
        joints = Table("arm", "joint", "acceleration", "unit", title="joint accelerations, base to tip")
        for name, arm in r.chain.arms.items():
            for k, (joint, qdd) in enumerate(zip(arm.joints, r[name].qdd, strict=True)):
                unit = "rad/s^2" if joint.turns else "m/s^2"
                joints.add_row(name if k == 0 else "", joint.name or f"{joint.kind} {k + 1}", f"{qdd:+.6g}", unit)
        console.print(joints)

        title = "what each arm exerts on the object, about the contact point, world axes"
        forces = Table("arm", "grasp", "force x, y, z [N]", "moment x, y, z [N m]", title=title)
        for name, grasp in r.chain.grasps.items():
            moment, force = r[name].grasp_wrench[:3], r[name].grasp_wrench[3:]
            forces.add_row(name, grasp.kind, _triple(force), _triple(moment))
        console.print(forces)
        if r.status is not Status.OK:
            console.print(r.status.value, soft_wrap=True)
        angular, linear = r.object_acceleration[:3], r.object_acceleration[3:]
        console.print(f"object: angular acceleration {_triple(angular)} rad/s^2, of C {_triple(linear)} m/s^2")


AnyAnswer = Answer | ContactMotionAnswer | ContactAnswer | ForceAnswer | ForestAnswer


def _of_trunk(r: ForwardResult) -> dict[str, list[float]] | None:
    """Return the trunk's part of a result, or None without a trunk."""
    if r.trunk_base_wrench is None:
        return None
    qdd = r.qdd[r.chain.joints[TRUNK]].tolist()
    if r.base_acceleration is not None:
        return {"qdd": qdd, "acceleration": r.base_acceleration.tolist()}
    return {"qdd": qdd, "base_wrench": r.trunk_base_wrench.tolist()}


def answers(case: AnyCase, methods: list[str]) -> Sequence[AnyAnswer]:
    """Return the answer of every method to a case; a question about forces has a single one."""
    if isinstance(case, ContactMotion):
        return contact_motion_answers(case, methods)
    if isinstance(case, ForestCase):
        return forest_answers(case, methods)
    if isinstance(case, ContactCase):
        return contact_answers(case, methods)
    if isinstance(case, ForceCase):
        if "sequential" not in methods:  # the default
            return [ForceAnswer(case, methods[0], reason=f"not_applicable: {OF_FORCES}")]
        return [force_answer(case)]
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
            # an accepted rank is the generic one, and finding it again would take most of the time
            found.append(_answer(case, motion, method, ranks[0] if ranks else None))
        return found


def _answer(case: Case, motion: ChainMotion, method: str, generic_rank: int | None) -> Answer:
    options = {"inputs": case.inputs, "method": method, "check": False, "generic_rank": generic_rank}
    try:
        if method == COMPILED:
            result = compiled_result(case)
        else:
            result = forward_dynamics(case.chain, case.state, case.tau, **options)
    except MethodNotApplicable as cause:
        return Answer(case, method, reason=f"not_applicable: {cause}")
    except (SingularChainError, ModelError) as cause:  # the latter: an arm whose mass matrix is singular
        return Answer(case, method, reason=f"singular: {cause}")
    numbers = (result.qdd, result.grasp_wrench, result.object_acceleration, result.contact_acceleration)
    if not all(np.isfinite(part).all() for part in numbers):
        return Answer(
            case,
            method,
            reason="singular: the result is not finite; do masses or lengths differ by too many orders of magnitude?",
        )
    error = None if case.expected is None else error_vs_expected(result, case.expected, motion)
    return Answer(case, method, result, error=error)


def compiled_result(case: Case) -> CompiledResult:
    """Return the answer of machine code to a case."""
    chain, inputs = case.chain, case.inputs.shaped(case.chain)
    given = {name: getattr(case.state, field) for name, field in state_fields(chain).items()}
    acting = {name: getattr(inputs, row.field) for name, row in ARRAYS.items() if row.role == "input" and row.field}
    acting = {name: x for name, x in acting.items() if x is not None and (name == "object_wrench" or x.any())}
    further = [name for name in ("link_wrench",) if {name, f"trunk_{name}"} & {*acting}]
    return compile(chain, parameters=further).forward_dynamics(**given, tau=case.tau, **acting)


def error_vs_expected(result: ForwardResult, expected: CaseExpected, motion: ChainMotion) -> float:
    """Return the largest of max|x - e| / max(1, max|e|) over qdd, f, alpha(C), W_dot and the base wrenches.

    Each quantity is taken over the trunk and all arms together. If f is not unique, it is replaced by
    sum_i phi(C, O_i) f_i, and the base wrenches are left out.
    """
    wanted_f, unique, trunk = np.array(expected.f), result.status is Status.OK, expected.trunk
    f = (result.grasp_wrench, wanted_f)
    if not unique:
        f = (_about_C(result.grasp_wrench, motion), _about_C(wanted_f, motion))
    of_trunk = [] if trunk is None else [np.array(trunk.qdd)]
    pairs = [
        (result.qdd, np.concatenate([*of_trunk, *(np.array(part) for part in expected.qdd)])),
        f,
        (result.object_acceleration, np.array(expected.alpha_C)),
        (result.contact_acceleration, np.concatenate([np.array(part) for part in expected.W_dot])),
    ]
    if expected.base_wrench is not None and unique:
        pairs.append((result.base_wrench, np.array(expected.base_wrench)))
    if trunk is not None and trunk.acceleration is not None and result.base_acceleration is not None:
        pairs.append((result.base_acceleration, np.array(trunk.acceleration)))
    if trunk is not None and trunk.base_wrench is not None and result.trunk_base_wrench is not None:
        pairs.append((result.trunk_base_wrench, np.array(trunk.base_wrench)))
    return max(relative_error(got, wanted) for got, wanted in pairs)


def _about_C(wrenches: Array, motion: ChainMotion) -> Array:
    """Return the total wrench on the object about C, (6,)."""
    held = {name: f for name, f in zip(motion.chain.arms, wrenches, strict=True) if name in motion.chain.grasps}
    return np.sum([shift_wrench(c.offset, f) for c, f in zip(motion.contacts, held.values(), strict=True)], axis=0)


def chosen_cases(file: Path, name: str | None) -> list[AnyCase]:
    """Return all cases of a file, or the named one.

    Raises:
        SceneError: the file is unreadable or invalid, or has no such case.
    """
    if file.suffix.lower() == ".toml":
        raise refusal(str(file), "expected problem cases (JSON), got a scene; try holdfast simulate, view or diagnose")
    return named_cases(*read_input(file), name)


def named_cases(text: bytes, source: str, name: str | None) -> list[AnyCase]:
    """Return all cases of a text, or the named one.

    Raises:
        SceneError: the text is invalid, or has no such case.
    """
    cases = parse_cases(text, source)
    if name is None:
        return cases
    known = [case.name for case in cases]
    if name not in known:
        raise refusal(source, f"no case '{one_line(name, 60)}'.{checks.did_you_mean(name, known)}")
    return [cases[known.index(name)]]


def print_json(items: Sequence[dict[str, object]]) -> None:
    """Print a JSON list on stdout, one item per line; it must not contain NaN or infinity."""
    lines = [json.dumps(item, allow_nan=False, default=np.ndarray.tolist) for item in items]
    print("[" + ",\n ".join(lines) + "]")


def print_answers(answers: Sequence[AnyAnswer]) -> None:
    """Print a line per answer, the reasons of refusals, and the numbers if there is a single answer."""
    console = stdout()
    table = Table("case", "method", "status", "rank", "mobility", "error")
    for answer in answers:
        table.add_row(answer.case.name, answer.method, *answer.line)
    console.print(table)
    refused = [answer for answer in answers if not answer.answered]
    if len({answer.case.name for answer in answers}) == 1:
        for answer in refused:
            console.print(f"{answer.method}: refused: {answer.reason}", soft_wrap=True)
    elif refused:
        kinds = Counter(_kind(answer) for answer in refused)
        listed = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        console.print(f"refused: {listed}; --case NAME or --format json states the reason")
    if len(answers) == 1:
        answers[0].print_numbers(console)


def _kind(answer: AnyAnswer) -> str:
    return (answer.reason or "").partition(":")[0]


def _triple(vector) -> str:
    return ", ".join(f"{x:+.6g}" for x in vector)


def solve(
    file: CaseFile,
    case: OptionalName = None,
    method: Name = "sequential",
    format: Format = "table",
    json: Switch = False,
) -> int:
    """Solve forward dynamics problems: joint accelerations, grasp forces, object acceleration.

    Args:
        file: problem cases, JSON; - for stdin.
        case: solve only this one.
        method: an algorithm (`holdfast methods` lists them), `all`, or `compiled`: `sequential` as machine code, which
            takes seconds to make for each kind of chain.
        format: a table, or one JSON document.
        json: the same as --format json.

    Returns:
        0 if anything was solved, else 3.

    Raises:
        SceneError: the file is invalid, or the case or the method is unknown.
    """
    methods = _chosen_methods(method)
    found: list[AnyAnswer] = []
    for problem in with_progress(chosen_cases(file, case), "solving"):
        found += answers(problem, methods)
    if json or format == "json":
        print_json([answer.as_json() for answer in found])
    else:
        print_answers(found)
    return 0 if any(answer.answered for answer in found) else EXIT_REFUSED


def _chosen_methods(name: str) -> list[str]:
    if name == "all":
        return list(METHODS)
    if name not in (*METHODS, COMPILED):
        raise SceneError(f"no method {name!r}.{checks.did_you_mean(name, ['all', COMPILED, *METHODS])}")
    return [name]


def methods(json: Switch = False) -> int:
    """List the forward dynamics algorithms, with their equation, cost and applicability.

    Args:
        json: print one JSON document instead of a table.
    """
    if json:
        keys = ("name", "equation", "cost", "applies")
        print_document([{key: getattr(method, key) for key in keys} for method in METHODS.values()])
        return 0
    table = Table("method", "equation", "cost", "applies to")
    for method in METHODS.values():
        table.add_row(method.name, method.equation, method.cost, method.applies)
    console = stdout()
    console.print(table)
    console.print("n joints in all, l arms, N joints an arm; 'sequential' is the default")
    return 0
