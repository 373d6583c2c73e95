"""What is expected of every command: `-`, one JSON document, several folders, keys set from outside."""

import io
import json
import shutil
import sys

import numpy as np
import pytest

import holdfast
from holdfast.cli import main
from holdfast.identification.feasible_bodies import is_feasible
from tests.cli.conftest import EXAMPLE
from tests.cli.test_commands import FILE

SHORT = ["--set", "simulation.duration=0.02", "--set", "simulation.step=0.01"]


@pytest.fixture
def stdin(monkeypatch):
    """Return what puts bytes into stdin."""
    return lambda content: monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))


@pytest.fixture
def document(cli):
    """Return a function that returns what a command prints with --json: one document and nothing else."""
    return lambda *arguments: json.loads(cli(*arguments, "--json").out)


def test_a_scene_on_stdin_with_keys_set(stdin, tmp_path, monkeypatch, document, cli):
    """The run is that of the changed scene, whose text the folder keeps, so that it can be looked at later."""
    monkeypatch.chdir(tmp_path)
    stdin(EXAMPLE.read_bytes())
    command = ("simulate", "-", *SHORT, "--set", "object.mass=2.5", "--set", "arms.left.base.position.1=0.01")
    found = document(*command, "--out", "run", "--no-plots")
    assert (found["result"], found["stopped"], found["summary"]["samples"]) == ("run", None, 3)
    chain = holdfast.load_scene("run/scene.toml").chain
    assert (chain.held_object.mass, chain.arms["left"].base.p.tolist()) == (2.5, [-0.55, 0.01, 0.0])
    assert holdfast.load_result("run").trajectory.t[-1] == 0.02
    stdin(EXAMPLE.read_bytes())
    assert (
        "nothing to resume: the run is complete" in cli(*command, "--out", "run", "--no-plots", "--resume", code=2).err
    )


@pytest.mark.slow
def test_stdin_is_told_apart(stdin, document):
    """`diagnose -` takes a scene, and cases."""
    stdin(EXAMPLE.read_bytes())
    (of_scene,) = document("diagnose", "-")
    assert (of_scene["rank"], of_scene["mobility"]) == (12, 8)
    with open(FILE, "rb") as file:
        content = file.read()
    stdin(content)
    assert document("diagnose", "-", "--case", "ball_3arm") == document("diagnose", FILE, "--case", "ball_3arm")
    stdin(content)
    assert document("solve", "-", "--case", "ball_3arm")[0]["status"] == "ok"


@pytest.mark.slow
def test_tables_on_stdout(result, tmp_path, capfdbinary):
    """The bytes that a file gets."""
    assert main(["export", str(result), "--out", str(tmp_path / "a.csv")]) == 0
    capfdbinary.readouterr()
    assert main(["export", str(result), "--out", "-"]) == 0
    assert capfdbinary.readouterr().out == (tmp_path / "a.csv").read_bytes()


def test_a_page_on_stdout(result, tmp_path, capfdbinary):
    """Likewise."""
    pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
    assert main(["view", str(result), "--export", str(tmp_path / "a.html"), "--json"]) == 0
    assert json.loads(capfdbinary.readouterr().out)["moments"] == 2
    assert main(["view", str(result), "--export", "-"]) == 0
    assert capfdbinary.readouterr().out == (tmp_path / "a.html").read_bytes()


def test_several_folders(result, document):
    """One document of all, in their order."""
    folders = [result, result]
    assert [one["result"] for one in document("summary", *folders)] == [str(result)] * 2
    exported = document("export", *folders, "--overwrite")
    assert [one["samples"] for one in exported] == [3, 3]
    assert exported[0]["files"] == [str(result / "trajectory.csv")]
    written = json.loads((result / "summary.json").read_text())
    assert document("summary", result)[0]["summary"] == written


def test_figures_of_several(result, tmp_path, monkeypatch, document):
    """One set that compares them, in a place of its own; each run is called by what tells its folder apart."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(result, "one/run")
    shutil.copytree(result, "two/run")
    seen = []
    monkeypatch.setattr("holdfast.cli.results.compare_runs", lambda runs: seen.append(list(runs)) or {})
    for out, place in (((), "results/comparison"), (("--out", "here"), "here")):
        found = document("plot", "one/run", "two/run", *out)
        assert found == {"results": ["one/run", "two/run"], "files": []}
        assert (tmp_path / place).is_dir()
    assert seen == [["one/run", "two/run"]] * 2


@pytest.mark.parametrize("command", ["plot", "view"])
def test_several_that_cannot_be_told_apart(result, tmp_path, monkeypatch, cli, command):
    """None, and the same one by two names, are refused before anything is drawn."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(result)
    assert "expected one or more" in cli(command, code=2).err
    assert "expected different ones, got link twice; try each once" in cli(command, result, "link", code=2).err
    assert "together, got 21; try some of them" in cli(command, *map(str, range(21)), code=2).err
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_documents_of_the_others(result, document, monkeypatch):
    """Their keys are names that a reader knows."""
    monkeypatch.setattr("holdfast.cli.results.save_plots", lambda chain, run, folder: ["a.png"])
    assert document("plot", result) == {"results": [str(result)], "files": [str(result / "a.png")]}
    assert {one["name"] for one in document("methods")} == set(holdfast.dynamics.METHODS)
    assert document("doctor")["holdfast"] == holdfast.__version__


def test_odd_arguments(cli):
    """Text that no file can be called, and one that fills screens: a line of moderate length each."""
    assert "expected a name that files can have" in cli("plot", "\ud800", code=2).err
    assert len(cli("methods", "--export", "x" * 5000, code=2).err) < 1200


def test_numbers_that_linear_algebra_cannot_bear(cli, monkeypatch):
    """They are bad input, not a fault of this program."""

    def answers(*given):
        with np.errstate(all="ignore"):
            return is_feasible(np.array([1.0, *np.full(9, np.inf)]))

    monkeypatch.setattr("holdfast.cli.solve.answers", answers)
    assert "input: expected numbers of comparable sizes" in cli("solve", FILE, code=2).err
