"""`holdfast solve`: answers, refusals, JSON schema, exit codes."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from holdfast.cli import main
from holdfast.dynamics import METHODS
from tests.io.mutations import CASES, arm_with, small_case
from tests.systems import two_collinear_stretched_6r

FILE = Path(__file__).parents[1] / "data" / "cases.json"
TRUNKS = FILE.with_name("cases_trunk.json")
NUMERIC = ("qdd", "f", "alpha_C", "W_dot", "base_wrench", "rank", "mobility", "error_vs_expected")
KEYS = {"name", "method", "status", "reason", "f_unique", "trunk", *NUMERIC}
BY_NAME = {case["name"]: case for case in CASES}


@pytest.fixture
def solve(tmp_path, capsys):
    """Return a function that solves a file or a case and returns exit code and answers."""

    def run(problem, *options: str) -> tuple[int, list[dict]]:
        file = problem
        if not isinstance(problem, Path):
            file = tmp_path / "case.json"
            file.write_text(json.dumps(problem), encoding="utf-8")
        code = main(["solve", str(file), "--format", "json", *options])
        out, err = capsys.readouterr()
        assert err == ""
        return code, json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))

    return run


def assert_schema(answer: dict) -> None:
    """Assert keys, types and lengths of one answer."""
    assert set(answer) == KEYS
    arms = BY_NAME[answer["name"]]["arms"]
    if answer["status"] == "refused":
        assert answer["reason"].split(":")[0] in ("not_applicable", "singular", "inconsistent")
        assert all(answer[key] is None for key in NUMERIC)
        assert answer["f_unique"] is False
        return
    assert (answer["status"], answer["reason"]) == ("ok", None)
    freedoms = {"rigid": 0, "hinge": 1, "softfinger": 2, "ball": 3}
    assert [len(part) for part in answer["qdd"]] == [len(arm["q"]) for arm in arms]
    assert [len(part) for part in answer["f"]] == [6] * len(arms)
    assert [len(part) for part in answer["W_dot"]] == [freedoms[arm["grasp"]["type"]] for arm in arms]
    assert len(answer["alpha_C"]) == 6
    assert isinstance(answer["rank"], int)
    assert isinstance(answer["mobility"], int)
    assert isinstance(answer["f_unique"], bool)
    assert math.isfinite(answer["error_vs_expected"])


@pytest.mark.parametrize(("name", "key"), [("torso3_at_rest", "base_wrench"), ("space_hinge_ball", "acceleration")])
def test_trunk(solve, name, key):
    """A trunk has its own part of an answer; the paper's algorithms refuse it by name."""
    code, found = solve(TRUNKS, "--case", name, "--method", "all")
    assert code == 0
    solved = {answer["method"]: answer for answer in found if answer["status"] == "ok"}
    assert set(solved) == {"sequential", "kkt"}
    for answer in solved.values():
        assert set(answer["trunk"]) == {"qdd", key}
        assert len(answer["trunk"][key]) == 6
        assert len(answer["base_wrench"]) == len(answer["qdd"])
        assert answer["error_vs_expected"] < 1e-11
    refused = [answer for answer in found if answer["status"] == "refused"]
    assert all("has a trunk" in answer["reason"] for answer in refused)


def applies(method: str, tags: dict) -> bool:
    """Return whether an algorithm covers a stored case."""
    if method == "sequential":
        return True
    if method == "kkt":
        return tags["f_unique"]
    return tags["omega_regular"] and (tags["all_rigid"] or not METHODS[method].rigid_only)


@pytest.mark.slow
def test_all_cases_by_all_methods(solve):
    """42 cases: every algorithm within 1e-9 where it applies, refused by name where it does not."""
    code, answers = solve(FILE, "--method", "all")
    assert code == 0
    assert [(a["name"], a["method"]) for a in answers] == [(name, method) for name in BY_NAME for method in METHODS]
    for answer in answers:
        assert_schema(answer)
        tags = BY_NAME[answer["name"]]["tags"]
        if applies(answer["method"], tags):
            assert answer["status"] == "ok", answer
            assert answer["error_vs_expected"] <= 1e-9
            assert answer["f_unique"] == tags["f_unique"]
            assert answer["mobility"] == tags["mobility"]
        else:
            assert answer["reason"].startswith(f"not_applicable: {answer['method']}: ")


def test_error_is_the_one_defined(solve):
    """A disturbed answer is off by exactly what the definition says, quantity by quantity."""
    for key, size in (("qdd", 1e-3), ("f", 2e-3), ("W_dot", 3e-3)):
        case = small_case()
        parts = case["expected"][key]
        largest = max(1.0, max(abs(x) for part in parts for x in part))
        parts[arm_with("ball")][2] += size * largest
        _, (answer,) = solve(case)
        assert answer["error_vs_expected"] == pytest.approx(size, rel=1e-2)


def test_error_where_forces_are_not_unique(solve):
    """Only the total wrench about C counts: another share of it is as right."""
    case = next(case for case in CASES if not case["tags"]["f_unique"])
    _, (answer,) = solve(FILE, "--case", case["name"])
    assert not np.allclose(answer["f"], case["expected"]["f"])
    assert answer["error_vs_expected"] <= 1e-9
    spoiled = case | {"expected": case["expected"] | {"f": (1.01 * np.array(case["expected"]["f"])).tolist()}}
    _, (answer,) = solve(spoiled)
    assert answer["error_vs_expected"] > 1e-4


def test_without_expected_answer(solve):
    """No answer in the file: nothing to compare."""
    case = small_case()
    del case["expected"]
    code, (answer,) = solve(case, "--method", "nonrigid")
    assert (code, answer["status"], answer["method"]) == (0, "ok", "nonrigid")
    assert answer["error_vs_expected"] is None


@pytest.mark.slow
def test_nothing_solved(solve, cli):
    """Exit 3 if no answer is ok; the table says why."""
    code, (answer,) = solve(FILE, "--case", "hinge_2arm", "--method", "rccfd2")
    assert code == 3
    assert answer["reason"].startswith("not_applicable: rccfd2: ")
    table = cli("solve", FILE, "--case", "hinge_2arm", "--method", "rccfd2", code=3).out
    assert "rccfd2: refused: not_applicable: " in table


@pytest.mark.slow
def test_singular(solve):
    """Two stretched arms on one line: every method refuses, naming the ranks."""
    plain = {key: value for key, value in two_collinear_stretched_6r(0).items() if key != "tags"}
    code, answers = solve(plain, "--method", "all")
    assert code == 3
    for answer in answers:
        assert answer["reason"].startswith("singular: "), answer["reason"]
        assert " rank 11 of 12 " in answer["reason"]


def test_an_arm_without_inertia_is_singular(solve):
    """A massless last link gives its joint nothing to accelerate: refused, the other case solved."""
    case = small_case() | {"name": "massless"}
    case["arms"][0]["links"][-1] = {"mass": 0.0, "com": [0, 0, 0], "inertia": [[0] * 3] * 3}
    code, (refused, solved) = solve([case, small_case()])
    assert code == 0
    assert refused["reason"].startswith("singular: arm 'arm1', joint 6: the inertia about its axis is 0")
    assert solved["status"] == "ok"


def spoiled(kind: str) -> tuple[dict, str, float]:
    """Return a case that breaks a grasp, which arm's, and by how much."""
    case, soft = small_case(), arm_with("softfinger")
    base, grasp = case["arms"][soft]["base"], case["arms"][soft]["grasp"]
    # a velocity along x moves the tip along
    numbers, k, gap = {"position": (base["p"], 1, 2e-3), "velocity": (base["v"], 0, 1e-2), "W": (grasp["W"], 1, 3e-4)}[
        kind
    ]
    numbers[k] += gap
    return case, f"arm{soft + 1}", gap


@pytest.mark.parametrize("kind", ["position", "velocity", "W"])
def test_inconsistent(kind, solve):
    """A state that breaks a grasp is refused by every method, with arm and gap."""
    case, arm, gap = spoiled(kind)
    code, answers = solve(case, "--method", "all")
    assert code == 3
    for answer in answers:
        reason = answer["reason"]
        assert reason.startswith("inconsistent: ")
        assert f"arm '{arm}': " in reason
        assert reason.count("arm '") == 1
        said = float(reason.partition(f"{kind} gap " if kind != "W" else "gap ")[2].split()[0].rstrip(","))
        # the residual is in contact axes: its largest entry, or a part of it across the spin
        assert gap / 3 < said <= gap * 1.001


def test_a_tiny_inconsistency_is_rounding(solve):
    """1e-9 in a position or velocity and 1e-10 in W are within the tolerances."""
    case = small_case()
    case["arms"][0]["base"]["p"][0] += 1e-9
    case["arms"][0]["base"]["v"][0] += 1e-9
    code, (answer,) = solve(case)
    assert (code, answer["status"]) == (0, "ok")


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--case", "hinge_2amr"], f"{FILE}: no case 'hinge_2amr'. Did you mean 'hinge_2arm'?"),
        (["--case", "42"], f"{FILE}: no case '42'. Known: rigid_1arm_6R, "),
        (["--method", "rccfd4"], "no method 'rccfd4'. Did you mean 'rccfd"),
        (["--method", "al"], "no method 'al'. Did you mean 'all'?"),
        (["--method", "magic"], "no method 'magic'. Known: all, compiled, sequential"),
        (["--format", "xml"], "invalid choice 'xml' for argument '--format'"),
        (["--metod", "kkt"], "Unrecognized options: --metod, kkt Perhaps you meant: --method"),
    ],
)
def test_unknown_names(options, problem, cli):
    """Exit 2, nothing on stdout, one line on stderr that helps."""
    out, err = cli("solve", FILE, *options, code=2)
    assert out == ""
    assert err.startswith(f"holdfast: error: {problem}")
    assert err.count("\n") == 1


def test_table_of_many(tmp_path, cli):
    """One line an answer, no escape codes in a pipe, and how many were refused."""
    names = ("rigid_1arm_6R", "hinge_2arm", "ball_3arm")
    file = tmp_path / "cases.json"
    file.write_text(json.dumps([BY_NAME[name] for name in names]), encoding="utf-8")
    out, err = cli("solve", file, "--method", "rccfd1")
    assert err == ""
    assert "\x1b" not in out
    for name in names:
        assert sum(f" {name} " in line for line in out.splitlines()) == 1
    refused = sum(not applies("rccfd1", BY_NAME[name]["tags"]) for name in names)
    assert f"refused: {refused} not_applicable; --case NAME or --format json states the reason" in out


def test_table_of_one(cli):
    """One answer in full: joints, forces at the grasps, units."""
    out = cli("solve", FILE, "--case", "mixed_5arm_prismatic").out
    case = BY_NAME["mixed_5arm_prismatic"]
    for unit in ("rad/s^2", "m/s^2", "[N]", "[N m]", "world axes"):
        assert unit in out
    for i, arm in enumerate(case["arms"]):
        assert f" arm{i + 1} " in out
        assert f"{case['expected']['qdd'][i][0]:+.6g}" in out
        assert f"{case['expected']['f'][i][3]:+.6g}" in out
        assert arm["grasp"]["type"] in out


def test_table_says_that_forces_are_not_unique(cli):
    """Smallest forces are shown as such."""
    out = cli("solve", FILE, "--case", "planar_2arm_6_6_omega_singular").out
    assert "ok, f not unique" in out
    assert "the smallest ones" in out


def test_names_are_printed_as_they_are(solve, tmp_path, cli):
    """Square brackets, colons and letters beyond ASCII in a name are no markup."""
    case = small_case() | {"name": "[red]Prüfung :smile:[/red]"}
    file = tmp_path / "case.json"
    file.write_text(json.dumps(case), encoding="utf-8")
    assert case["name"] in cli("solve", file).out
