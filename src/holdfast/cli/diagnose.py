"""`holdfast diagnose`: mobility and constraint rank of a scene's initial state or of problem cases."""

from __future__ import annotations

import math
import re
from dataclasses import asdict

import numpy as np

from holdfast.cli.console import is_standard, read_stdin, stdout, with_progress
from holdfast.cli.options import Changes, Diagnosed, Format, OptionalName, PackageOptions, Switch
from holdfast.cli.results import opened_scene, refuse_scene_options
from holdfast.cli.solve import chosen_cases, named_cases, print_json
from holdfast.cli.streams import EXIT_REFUSED
from holdfast.dynamics import consistency
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.diagnose import Diagnosis
from holdfast.dynamics.diagnose import diagnose as diagnosis_of
from holdfast.dynamics.tree.forest_diagnosis import ForestDiagnosis
from holdfast.errors import SceneError, StateError
from holdfast.io.case_file import AnyCase
from holdfast.io.contact_motion import ContactMotion
from holdfast.io.forest_case import ForestCase

BEGINS_JSON = re.compile(rb"\s*(\{|\[\s*[{\]])")  # TOML never begins like this, because a table's name follows `[`


def diagnose(
    file: Diagnosed,
    case: OptionalName = None,
    format: Format = "table",
    json: Switch = False,
    changes: Changes = (),
    trust_xacro: Switch = False,
    packages: PackageOptions = (),
) -> int:
    """Report mobility, rank, lost directions and indeterminate forces of a scene's initial state, or of problem cases.

    Args:
        file: a scene (.toml), or problem cases (JSON); - for stdin.
        case: diagnose only this one.
        format: a report as text (table), or one JSON document.
        json: the same as --format json.
        changes: set a key of the scene, such as simulation.step=0.001; may be repeated.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
        packages: the folder of a package that a robot's file refers to; may be repeated.

    Returns:
        0 if anything was diagnosed, else 3.

    Raises:
        SceneError: the file is invalid, or the case is unknown.
        ClosureError: an arm of the scene cannot reach its grasp.
    """
    found: list[tuple[str, Diagnosis | ForestDiagnosis | str]]
    given = read_stdin() if is_standard(file) else None
    if file.suffix.lower() == ".toml" or (given is not None and not BEGINS_JSON.match(given)):
        if case is not None:
            raise SceneError(f"{file}: expected no --case for a scene, got '{case}'")
        scenario = opened_scene(file, trust_xacro, changes, packages, given)
        found = [(scenario.name, diagnosis_of(scenario.chain, scenario.state))]
    else:
        refuse_scene_options(changes, packages, f"the problem cases {file}")
        cases = chosen_cases(file, case) if given is None else named_cases(given, "stdin", case)
        found = [(problem.name, _diagnosis(problem)) for problem in with_progress(cases, "diagnosing")]
    if json or format == "json":
        print_json([_as_json(name, outcome) for name, outcome in found])
    else:
        console = stdout()
        for name, outcome in found:
            text = f"refused: {outcome}" if isinstance(outcome, str) else outcome.report()
            console.print(f"{name}: {text}", soft_wrap=True)
    return EXIT_REFUSED if all(isinstance(outcome, str) for _, outcome in found) else 0


def _diagnosis(case: AnyCase) -> Diagnosis | str:
    """Return the diagnosis, or why there is none: the state is inconsistent with the chain, or a forest is asked."""
    if isinstance(case, ForestCase):
        return "not_applicable: a forest answers forward dynamics only; try holdfast solve"
    if isinstance(case, ContactMotion):
        return "not_applicable: a motion with contacts is answered by holdfast solve"
    with np.errstate(all="ignore"):
        try:
            motion = chain_motion(
                case.chain, case.state, np.zeros(case.chain.joint_count), case.inputs.shaped(case.chain)
            )
            consistency.require_closed(motion, case.state)
        except StateError as cause:
            return f"inconsistent: {cause}"
        return diagnosis_of(case.chain, case.state)


def _as_json(name: str, outcome: Diagnosis | ForestDiagnosis | str) -> dict[str, object]:
    if isinstance(outcome, str):
        return {"name": name, "status": "refused", "reason": outcome}
    condition = outcome.condition if math.isfinite(outcome.condition) else None
    return {"name": name, "status": outcome.status, "reason": None, **asdict(outcome), "condition": condition}
