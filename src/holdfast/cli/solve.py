"""`holdfast solve`: answers to problem cases."""

from __future__ import annotations

from pathlib import Path

from holdfast.cli import REFUSED
from holdfast.cli.answer import Answer, answers
from holdfast.cli.answer_table import print_answers
from holdfast.cli.case_choice import chosen_cases, print_json
from holdfast.cli.console import with_progress
from holdfast.dynamics.methods import METHODS
from holdfast.errors import SceneError
from holdfast.model import checks


def solve(file: Path, case: str | None, method: str, format: str) -> int:
    """Print the answers of one or all methods to one or all cases.

    Returns:
        0 if anything was solved, else 3.

    Raises:
        SceneError: a bad file, an unknown case or method.
    """
    methods = _chosen_methods(method)
    found: list[Answer] = []
    for problem in with_progress(chosen_cases(file, case), "solving"):
        found += answers(problem, methods)
    if format == "json":
        print_json([answer.as_json() for answer in found])
    else:
        print_answers(found)
    return 0 if any(answer.result is not None for answer in found) else REFUSED


def _chosen_methods(name: str) -> list[str]:
    if name == "all":
        return list(METHODS)
    if name not in METHODS:
        raise SceneError(f"no method {name!r}.{checks.did_you_mean(name, ['all', *METHODS])}")
    return [name]
