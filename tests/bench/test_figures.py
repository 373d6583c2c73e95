"""The figures of the page."""

import sys
from pathlib import Path

import pytest

from tests.bench.tiny import tiny_document

pytest.importorskip("matplotlib", reason="needs matplotlib: pip install 'holdfast[plot]'")


@pytest.fixture
def bench_plots(monkeypatch):
    """The script's module."""
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parents[2] / "benchmarks"), *sys.path])
    import bench_plots

    return bench_plots


def test_figures(bench_plots, tmp_path):
    """Three pictures, log-log, our line in each."""
    names = bench_plots.save(tiny_document(), tmp_path)
    assert sorted(names) == ["bench_arms.png", "bench_batch.png", "bench_links.png"]
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in names)
    figure = bench_plots.batch_curve(tiny_document())
    (panel,) = figure.axes
    assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
    assert any(line.get_label().startswith("holdfast") for line in panel.lines)
