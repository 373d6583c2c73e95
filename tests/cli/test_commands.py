"""The program around the commands: help, versions, interruptions, the console entry."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import holdfast
from holdfast.cli import solve as solve_command
from holdfast.dynamics import METHODS
from holdfast.errors import ClosureError, SingularChainError
from tests.io.mutations import CASES, small_case
from tests.systems import two_collinear_stretched_6r

FILE = str(Path(__file__).parents[1] / "data" / "cases.json")
COMMANDS = (
    "solve", "diagnose", "calibrate", "identify", "simulate", "sweep", "summary", "plot", "view", "export",
    "export-c", "methods", "doctor",
)  # fmt: skip


def test_help(cli):
    """Without arguments, and on request, every command is listed; exit 0."""
    for arguments in ([], ["--help"], ["-h"]):
        out, err = cli(*arguments)
        assert err == ""
        assert all(command in out for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command(command, cli):
    """Every command explains itself and its arguments."""
    out = cli(command, "--help").out
    assert f"holdfast {command}" in out
    assert "{None}" not in out


def test_version(cli):
    """The installed version."""
    assert cli("--version").out == f"{holdfast.__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["slove", FILE], "no command 'slove'. Did you mean 'solve'?"),
        (["fly"], f"no command 'fly'. Known: {', '.join(COMMANDS)}."),
        (["bench"], "no command 'bench'; try `python -m benchmarks.bench` in a clone of the repository"),
        (["solve"], "Missing from holdfast solve: FILE"),
        (["--verbose"], "Unrecognized options: --verbose"),
        (["methods", "extra"], "Unrecognized options: extra"),
    ],
)
def test_usage_errors(arguments, problem, cli):
    """Exit 2 and one line."""
    out, err = cli(*arguments, code=2)
    assert out == ""
    assert err.startswith(f"holdfast: error: {problem}"), err
    assert err.count("\n") == 1


def test_methods(cli):
    """Every algorithm with its equation, cost and range."""
    out = cli("methods").out
    for method in METHODS.values():
        (line,) = [line for line in out.splitlines() if f" {method.name} " in line]
        for text in (method.equation, method.cost, method.applies):
            assert text in line


def test_doctor(cli):
    """Versions, processor features, extras with the command that brings what is missing."""
    out = cli("doctor").out
    libraries, features = ("holdfast", "python", "numpy"), ("processor", "avx2", "avx512", "fma", "neon")
    for word in (*libraries, *features, "machine code", "cache", "extra 'plot'"):
        assert word in out


def test_doctor_names_what_is_missing(cli, monkeypatch):
    """A package that is not there is named with its extra."""
    from holdfast.cli import doctor

    monkeypatch.setattr(doctor, "_version", lambda package: None if package == "matplotlib" else "1.0")
    assert "missing matplotlib: pip install 'holdfast[plot]'" in cli("doctor").out


def test_interrupted(cli, monkeypatch):
    """Ctrl-C ends with 130 and no traceback."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(solve_command, "chosen_cases", interrupted)
    assert cli("solve", FILE, code=130).err == "holdfast: error: interrupted\n"


@pytest.mark.parametrize("error", [ClosureError, SingularChainError])
def test_physics_refused(error, cli, monkeypatch):
    """What physics refuses ends with 3; a message of several lines becomes one."""

    def refuse(*_):
        raise error("out of reach\n  by 0.1 m")

    monkeypatch.setattr(solve_command, "chosen_cases", refuse)
    assert cli("solve", FILE, code=3).err == "holdfast: error: out of reach by 0.1 m\n"


def test_faults_are_named(monkeypatch, cli):
    """An exception that is none of ours: one line with its type, its message and the place in this program, and 70."""

    def broken(*_):
        raise ZeroDivisionError("a fault")

    monkeypatch.setattr(solve_command, "chosen_cases", broken)
    said = cli("solve", FILE, code=70).err
    assert said.startswith("holdfast: error: internal fault at cli/solve.py:")
    assert "ZeroDivisionError: a fault; please report" in said
    assert said.count("\n") == 1
    monkeypatch.setenv("HOLDFAST_TRACEBACK", "1")
    said = cli("solve", FILE, code=70).err
    assert said.startswith("Traceback") and "internal fault at cli/solve.py:" in said


def test_diagnose_all_cases(cli):
    """Rank, mobility and whether forces are unique, of every stored case."""
    out, err = cli("diagnose", FILE, "--format", "json")
    assert err == ""
    for found, case in zip(json.loads(out), CASES, strict=True):
        assert found["name"] == case["name"]
        assert found["mobility"] == case["tags"]["mobility"]
        assert found["rank"] == found["generic_rank"]
        assert found["rows"] == 6 * len(case["arms"])
        assert found["status"] == ("regular" if case["tags"]["f_unique"] else "indeterminate")
        assert (found["indeterminate_forces"] == []) == case["tags"]["f_unique"]


def test_diagnose_in_words(tmp_path, cli):
    """A singular configuration is a finding: exit 0, lost directions in words; an open grasp is refused."""
    singular = {key: value for key, value in two_collinear_stretched_6r(0).items() if key != "tags"}
    apart = small_case() | {"name": "open"}
    apart["arms"][0]["base"]["p"][0] += 0.1
    file = tmp_path / "cases.json"
    file.write_text(json.dumps([singular, apart]), encoding="utf-8")
    out = cli("diagnose", file).out
    assert "singular: rank 11 of 12" in out
    assert "cannot move its tip along" in out
    assert "open: refused: inconsistent: " in out
    refused = cli("diagnose", file, "--case", "open", "--format", "json", code=3).out
    assert json.loads(refused)[0]["status"] == "refused"


def program() -> list[str]:
    """Return the installed console entry."""
    script = Path(sys.executable).with_name("holdfast.exe" if os.name == "nt" else "holdfast")
    return [str(script)] if script.exists() else [sys.executable, "-c", "import holdfast.cli as c; exit(c.main())"]


def test_console_entry():
    """The installed program: JSON alone on stdout, exit codes of the process."""
    done = subprocess.run(
        [*program(), "solve", FILE, "--case", "ball_3arm", "--format", "json"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)[0]["error_vs_expected"] < 1e-9
    done = subprocess.run(
        [sys.executable, "-m", "holdfast", "solve", "none.json"], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "holdfast: error: none.json: cannot be read: No such file or directory\n"


@pytest.mark.slow
def test_a_terminal_without_the_letters(tmp_path):
    """Letters beyond the terminal's are escaped."""
    file = tmp_path / "case.json"
    file.write_text(json.dumps(small_case() | {"name": "Prüfung"}), encoding="utf-8")
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    command = [*program(), "solve", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert r"Pr\xfcfung" in done.stdout
