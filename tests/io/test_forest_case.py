"""Forests in case files: reading, refusals with their places, and the command."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest

import holdfast as hf
from holdfast.cli import main
from holdfast.dynamics import METHODS
from holdfast.errors import SceneError
from holdfast.io.case_file import parse_cases
from holdfast.io.forest_case import ForestCase

FILE = Path(__file__).parents[1] / "data" / "cases_tree.json"
CASES = json.loads(FILE.read_text(encoding="utf-8"))["cases"]
KEYS = {"name", "method", "status", "reason", "qdd", "alpha", "f", "coupling", "f_unique", "rank", "mobility"}
SMALL = next(case for case in CASES if case["name"] == "anything_generic_1")


def answered(capsys, file, *options: str) -> tuple[int, list[dict]]:
    """Return exit code and answers of the command."""
    code = main(["solve", str(file), "--format", "json", *options])
    out, err = capsys.readouterr()
    assert err == ""
    return code, json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))


@pytest.mark.slow
def test_every_forest(capsys):
    """The command answers all stored forests by `sequential` and `kkt`, and refuses the rest by name."""
    code, answers = answered(capsys, FILE, "--method", "all")
    assert code == 0
    assert len(answers) == len(CASES) * len(METHODS)
    tags = {case["name"]: case["tags"] for case in CASES}
    for answer in answers:
        assert set(answer) == KEYS | {"error_vs_expected"}
        if answer["method"] not in ("sequential", "kkt"):
            assert answer["status"] == "refused" and answer["reason"].startswith("not_applicable: ")
            continue
        expected = tags[answer["name"]]
        assert (answer["status"], answer["reason"]) == ("ok", None)
        assert answer["error_vs_expected"] <= (1e-8 if expected["variant"] == "light" else 1e-9)
        assert {key: answer[key] for key in ("rank", "mobility", "f_unique")} == {
            key: expected[key] for key in ("rank", "mobility", "f_unique")
        }


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_every_forest_by_machine_code(capsys):
    """All stored forests by `compiled`, to the same bars, with the smallest forces where they are not unique."""
    code, answers = answered(capsys, FILE, "--method", "compiled")
    assert code == 0 and len(answers) == len(CASES)
    for answer, case in zip(answers, CASES, strict=True):
        expected = case["tags"]
        assert (answer["status"], answer["reason"]) == ("ok", None)
        assert answer["error_vs_expected"] <= (1e-8 if expected["variant"] == "light" else 1e-9)
        assert {key: answer[key] for key in ("rank", "mobility", "f_unique")} == {
            key: expected[key] for key in ("rank", "mobility", "f_unique")
        }


def test_one_forest_by_machine_code(tmp_path, capsys):
    """A forest in an open state is refused by `compiled`, too."""
    case = copy.deepcopy(SMALL)
    file = tmp_path / "one.json"
    file.write_text(json.dumps(case), encoding="utf-8")
    code, (answer,) = answered(capsys, file, "--method", "compiled")
    assert code == 0 and answer["method"] == "compiled" and answer["error_vs_expected"] <= 1e-9
    case["closures"][0]["frame_a"]["p"][0] += 0.01
    file.write_text(json.dumps(case), encoding="utf-8")
    code, (answer,) = answered(capsys, file, "--method", "compiled")
    assert code == 3 and answer["reason"].startswith("inconsistent: ")


def test_one_forest(tmp_path, capsys):
    """A file may contain one forest; by default the command names its joints, closures and couplings."""
    file = tmp_path / "one.json"
    file.write_text(json.dumps(SMALL), encoding="utf-8")
    (case,) = hf.io.load_cases(file)
    assert isinstance(case, ForestCase) and len(case.forest.bodies) == len(SMALL["bodies"])
    assert main(["solve", str(file)]) == 0
    out = capsys.readouterr().out
    for words in ("ok, f not unique", "7 of 11", "cylindrical", "softfinger", "couplings: "):
        assert words in out


def test_other_commands_refuse(capsys):
    """`diagnose` says what answers a forest."""
    assert main(["diagnose", str(FILE), "--case", SMALL["name"]]) == 3
    assert "a forest answers forward dynamics only; try holdfast solve" in " ".join(capsys.readouterr().out.split())


def test_open_forest(tmp_path, capsys):
    """A state that violates a closure is inconsistent."""
    case = copy.deepcopy(SMALL)
    case["closures"][0]["frame_a"]["p"][0] += 0.01
    file = tmp_path / "open.json"
    file.write_text(json.dumps(case), encoding="utf-8")
    code, (answer,) = answered(capsys, file)
    assert code == 3
    assert answer["reason"].startswith("inconsistent: the state does not satisfy the forest: closure 0: position gap")


MUTATIONS = [
    (("bodies", 0, "joint", "type"), "hinge", r"\$\.bodies\[0\]\.joint\.kind: got 'hinge'"),
    (("bodies", 0, "joint", "axis"), [1.0, 1.0, 0.0], r"\$\.bodies\[0\]\.joint\.axis: expected a unit vector"),
    (("bodies", 1, "parent"), 5, r"\$: .*body 1.*expected the index of a body before it"),
    (("bodies", 0, "q"), [0.0] * 9, r"\$\.bodies\[0\]\.q: expected . numbers"),
    (("bodies", 0, "mass"), -1.0, r"\$\.bodies\[0\]\.mass: expected > 0"),
    (("bodies", 0, "wrench"), [1.0], r"\$\.bodies\[0\]\.wrench"),
    (("closures", 0, "type"), "knot", r"\$\.closures\[0\]\.kind: expected one of"),
    (("closures", 0, "b"), 77, r"\$: .*expected the index of a body"),
    (("couplings", 0, "terms"), [], r"\$\.couplings\[0\]\.terms: expected at least one"),
    (("expected", "f"), [], r"\$\.expected\.f: expected 2 entries"),
    (("expected", "qdd", 0), [], r"\$\.expected\.qdd\[0\]: expected"),
    (("bodies", 0, "colour"), "red", r"\$\.bodies\[0\]: .*unknown field `colour`"),
]


@pytest.mark.parametrize(("path", "value", "message"), MUTATIONS)
def test_refusals(path, value, message):
    """What is wrong is refused with its place in the file."""
    case = copy.deepcopy(SMALL)
    at = case
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    with pytest.raises(SceneError, match=message):
        parse_cases(json.dumps(case).encode(), "forest.json")
