"""Cases of contacts: the stored file is read and answered as it is, and faults are refused with their place."""

import copy
import json
from pathlib import Path

import pytest

from holdfast.cli.solve import answers
from holdfast.errors import SceneError
from holdfast.io import load_cases
from holdfast.io.case_file import parse_cases

FILE = Path(__file__).parents[1] / "data" / "cases_contact.json"
DATA = json.loads(FILE.read_text(encoding="utf-8"))


def test_all_are_read():
    """All 36 cases are read, of every kind."""
    cases = load_cases(FILE)
    assert [case.name for case in cases] == [case["name"] for case in DATA["cases"]]
    assert {getattr(case, "kind", None) for case in cases} >= {"impact", "rest", "sliding", "rod"}


@pytest.mark.parametrize(("number", "status"), [(0, "OK"), (1, "JAMMED"), (2, "AMBIGUOUS")])
def test_rods_say_how_many_solutions(number, status):
    """Painleve's rod: one force, none, or two; the answer has the fields of `expected`."""
    case = next(case for case in load_cases(FILE) if case.name == f"contact_rod_{number}")
    (answer,) = answers(case, ["sequential"])
    told = answer.as_json()
    assert told["status"] == status
    assert told["error_vs_expected"] < 1e-9
    assert set(next(c for c in DATA["cases"] if c["name"] == case.name)["expected"]) <= set(told)


def test_answers_have_the_fields_of_expected():
    """An instant's answer names everything that its case expects, but for the margin."""
    stored = [next(c for c in DATA["cases"] if c.get("kind") == kind) for kind in ("impact", "rest", "sliding")]
    for case, data in zip(parse_cases(json.dumps(stored).encode(), "stored"), stored, strict=True):
        (answer,) = answers(case, ["sequential"])
        assert set(data["expected"]) - {"margin"} <= set(answer.as_json())
        json.dumps(answer.as_json(), allow_nan=False)


def test_methods_that_do_not_apply():
    """An impact is answered by one method only."""
    (answer,) = answers(load_cases(FILE)[0], ["kkt"])
    assert answer.as_json()["reason"].startswith("not_applicable")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda case: case.update(kind="push"), "kind"),
        (lambda case: case["contacts"][0].update(normal=[0, 0, 2]), r"contacts\[0\]"),
        (lambda case: case["contacts"][0].update(mu=-1.0), "friction"),
        (lambda case: case["contacts"][0].pop("offset"), "offset"),
        (lambda case: case["expected"].update(modes=[]), "modes"),
        (lambda case: case["expected"].update(qd=[[0.0]]), "qd"),
        (lambda case: case.update(contacts=[]), "points"),
    ],
)
def test_faults_are_refused_with_their_place(change, message):
    """A wrong case names the JSON path of its first fault."""
    case = copy.deepcopy(DATA["cases"][0])
    change(case)
    with pytest.raises(SceneError, match=message):
        parse_cases(json.dumps([case]).encode(), "wrong")
