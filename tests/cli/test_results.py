"""`holdfast plot` and `holdfast export` from the command line."""

import pytest

from holdfast.cli import main
from tests.io.recorded import filled

FIGURES = ["grasp_wrenches", "joint_torques", "load_share", "closure_and_energy"]


def test_plot(result, tmp_path, capsys):
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
    monkeypatch.setattr("holdfast.cli.results.save_plots", lambda chain, run, folder: [f"{len(run)}.png"])
    assert main(["plot", str(result)]) == 0
    assert capsys.readouterr().out == f"look at {result / '3.png'}\n"


@pytest.fixture
def folder(tmp_path):
    """A complete result of seven samples."""
    w, _ = filled(tmp_path / "run", 4, 3)
    w.finish(None)
    return tmp_path / "run"


def test_export_csv_into_the_folder(folder, capsys):
    """Without options: CSV beside the chunks; not twice unless told to."""
    assert main(["export", str(folder)]) == 0
    said = capsys.readouterr()
    table, log = folder / "trajectory.csv", folder / "trajectory_occurrences.csv"
    assert said.out == f"{table}: 7 samples\n{log}: events\n"
    assert said.err == ""
    assert len((folder / "trajectory.csv").read_text().splitlines()) == 8
    assert main(["export", str(folder)]) == 2
    assert "trajectory.csv: exists already; try --overwrite" in capsys.readouterr().err
    assert main(["export", str(folder), "--overwrite"]) == 0


def test_export_parquet_elsewhere(folder, tmp_path, capsys):
    """The format and the place can be chosen."""
    pytest.importorskip("pyarrow")
    assert main(["export", str(folder), "--format", "parquet", "--out", str(tmp_path / "a.parquet")]) == 0
    assert (tmp_path / "a.parquet").read_bytes()[:4] == b"PAR1"
    assert "7 samples" in capsys.readouterr().out


def test_export_of_an_incomplete_run(tmp_path, capsys):
    """What is there is exported, and stderr says that it is not all."""
    filled(tmp_path / "run", 3)
    assert main(["export", str(tmp_path / "run"), "--out", str(tmp_path / "a.csv")]) == 0
    said = capsys.readouterr()
    assert "incomplete, up to t = 0.2 s of 30.0 s" in said.err
    assert "3 samples" in said.out
