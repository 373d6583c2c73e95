"""`python -m benchmarks.bench`."""

import json

import pytest
from benchmarks.bench import __main__ as command

from tests.benchmarks.tiny import TINY, tiny_document


@pytest.fixture
def quickly(monkeypatch):
    """The command shows the tiny run; returns the plans it was asked for."""
    plans = []

    def run(plan, report):
        plans.append(plan)
        report("something", 0.5)
        return tiny_document()

    monkeypatch.setattr(command, "run", run)
    return plans


@pytest.mark.slow
def test_json_only_on_stdout(quickly, capsys):
    """One document on stdout, nothing else."""
    assert command.main(["--quick", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == tiny_document()
    assert err == "measuring: something\n"
    assert quickly == [command.QUICK]


@pytest.mark.slow
def test_tables(quickly, capsys):
    """Ratios before times, then the acceptance checks; every entry is named."""
    assert command.main([]) == 0
    out, err = capsys.readouterr()
    assert err == "measuring: something\n"
    assert quickly == [command.FULL]
    assert out.index("Time over ours") < out.index("Microseconds per evaluation") < out.index("Acceptance checks")
    for entry in tiny_document()["systems"][0]["entries"]:
        assert f"{entry['library']} {entry['name']}" in out
    assert "the ratios travel better" in out


@pytest.mark.slow
def test_absent_peer(quickly, capsys, monkeypatch):
    """What was not compared is said below the tables."""
    monkeypatch.setitem(tiny_document()["peers"], "mujoco", {"absent": "No module named 'mujoco'; try pip install x"})
    assert command.main(["--quick"]) == 0
    assert "mujoco: not compared: No module named 'mujoco'; try pip install x" in capsys.readouterr().out


@pytest.mark.long
def test_quick_run(capsys):
    """The real thing, small."""
    assert command.main(["--quick", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["mode"] == "quick"
    assert [record["name"] for record in document["systems"]] == ["2 x 7", "4 x 7", "2 x 24"]


def test_plans():
    """The full run has the sizes of every acceptance check."""
    names = {f"{arms} x {joints}" for arms, joints in command.FULL.systems}
    assert {"2 x 7", "16 x 7", "64 x 7", "2 x 96"} <= names
    assert set(command.QUICK.systems) < set(command.FULL.systems)
    assert TINY.mode == "tiny"
