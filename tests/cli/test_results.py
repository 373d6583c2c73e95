"""`holdfast plot` and `holdfast export` from the command line."""

import pytest

from holdfast.cli import main
from tests.io.recorded import filled

FIGURES = ["grasp_wrenches", "joint_torques", "load_share", "closure_and_energy"]


@pytest.mark.slow
def test_plot(result, tmp_path, cli):
    """Every figure that has something to show, and where to look for it."""
    place = tmp_path / "new"
    said = cli("plot", result, "--out", place)
    assert said.err == ""
    assert said.out.splitlines() == [f"look at {place / name}.png" for name in FIGURES]
    assert all((place / f"{name}.png").read_bytes().startswith(b"\x89PNG") for name in FIGURES)


def test_beside_the_result(result, monkeypatch, cli):
    """Without a place of their own the figures go into the result folder."""
    monkeypatch.setattr("holdfast.cli.results.save_plots", lambda chain, run, folder: [f"{len(run)}.png"])
    assert cli("plot", result).out == f"look at {result / '3.png'}\n"


@pytest.fixture
def folder(tmp_path):
    """A complete result of seven samples."""
    w, _ = filled(tmp_path / "run", 4, 3)
    w.finish(None)
    return tmp_path / "run"


def test_export_csv_into_the_folder(folder, cli):
    """Without options: CSV beside the chunks; not twice unless told to."""
    said = cli("export", folder)
    table, log = folder / "trajectory.csv", folder / "trajectory_occurrences.csv"
    assert said.out == f"{table}: 7 samples\n{log}: events\n"
    assert said.err == ""
    assert len((folder / "trajectory.csv").read_text().splitlines()) == 8
    assert "trajectory.csv: exists already; try --overwrite" in cli("export", folder, code=2).err
    assert main(["export", str(folder), "--overwrite"]) == 0


def test_export_parquet_elsewhere(folder, tmp_path, cli):
    """The format and the place can be chosen."""
    pytest.importorskip("pyarrow")
    assert "7 samples" in cli("export", folder, "--format", "parquet", "--out", tmp_path / "a.parquet").out
    assert (tmp_path / "a.parquet").read_bytes()[:4] == b"PAR1"


def test_export_of_an_incomplete_run(tmp_path, cli):
    """What is there is exported, and stderr says that it is not all."""
    filled(tmp_path / "run", 3)
    said = cli("export", tmp_path / "run", "--out", tmp_path / "a.csv")
    assert "incomplete, up to t = 0.2 s of 30.0 s" in said.err
    assert "3 samples" in said.out
