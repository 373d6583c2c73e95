"""`holdfast plot` from the command line."""

import pytest

from holdfast.cli import main
from holdfast.errors import MissingExtra
from tests.cli.test_view import EXAMPLE

FIGURES = ["grasp_wrenches", "joint_torques", "load_share", "closure_and_energy"]


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A result of three samples, without plots."""
    folder = tmp_path_factory.mktemp("plot")
    text = EXAMPLE.read_text().replace("duration = 2.0", "duration = 0.02").replace("step = 0.002", "step = 0.01")
    (folder / "short.toml").write_text(text)
    assert main(["simulate", str(folder / "short.toml"), "--out", str(folder / "result"), "--no-plots"]) == 0
    return folder / "result"


def test_figures(result, tmp_path, capsys):
    """Every figure that has something to show, and where to look for it."""
    capsys.readouterr()
    place = tmp_path / "new"
    assert main(["plot", str(result), "--out", str(place)]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert said.out.splitlines() == [f"look at {place / name}.png" for name in FIGURES]
    assert all((place / f"{name}.png").read_bytes().startswith(b"\x89PNG") for name in FIGURES)


def test_beside_the_result(result, monkeypatch, capsys):
    """Without a place of their own the figures go into the result folder."""
    monkeypatch.setattr("holdfast.cli.plot.save_plots", lambda chain, run, folder: [f"{len(run)}.png"])
    assert main(["plot", str(result)]) == 0
    assert capsys.readouterr().out == f"look at {result / '3.png'}\n"


def test_refused(result, tmp_path, capsys, monkeypatch):
    """No result, a place that cannot be written, no matplotlib: one line on stderr, code 2."""
    (tmp_path / "file").touch()
    for arguments, message in (
        ([str(tmp_path)], "meta.json"),
        ([str(result), "--out", str(tmp_path / "file" / "in")], "cannot be written"),
    ):
        assert main(["plot", *arguments]) == 2
        assert message in capsys.readouterr().err

    def missing(*arguments):
        raise MissingExtra("plots need matplotlib; try pip install 'holdfast[plot]'")

    monkeypatch.setattr("holdfast.cli.plot.save_plots", missing)
    assert main(["plot", str(result)]) == 2
    assert "pip install 'holdfast[plot]'" in capsys.readouterr().err
