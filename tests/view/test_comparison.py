"""Figures of several runs: a curve of each run in each panel, under its name, with the run's own numbers."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.simulation.setting import Setting
from tests.view.runs import lifted

pytest.importorskip("matplotlib", reason="needs matplotlib: pip install 'holdfast[plot]'")


@pytest.fixture(scope="module")
def runs():
    """Return a run, and one of other grasps that ends sooner."""
    found = {}
    for name, (chain, run) in {"soft": lifted(), "stiff": lifted("rigid", "rigid", 4)}.items():
        found[name] = replace(run, setting=Setting(chain))
    return found


@pytest.fixture(scope="module")
def figures(runs):
    return hf.plot.compare_runs(runs)


def drawn(panel) -> dict[str, np.ndarray]:
    """Return the curves of a panel by name."""
    return {line.get_label(): line.get_xydata() for line in panel.lines if not line.get_label().startswith("_")}


def test_every_run_by_name(runs, figures):
    """Each panel of what both have shows both, at their own times; the legend names them once."""
    assert list(figures) == ["hands", "object", "balance"]
    for figure in figures.values():
        assert [text.get_text() for text in figure.legends[0].get_texts()] == ["soft", "stiff"]
    first = drawn(figures["hands"].axes[0])
    for name, run in runs.items():
        force = np.linalg.norm(run.grasp_wrench[:, 0, 3:], axis=1)
        assert np.array_equal(first[name], np.column_stack([run.t, force]))


def test_what_one_run_lacks(figures):
    """Rigid grasps have no margin: that panel shows the other run alone."""
    margins = [panel for panel in figures["hands"].axes if panel.get_ylabel() == "margin [N]"]
    assert [list(drawn(panel)) for panel in margins] == [["soft"]]


def test_rows_that_nobody_fills(runs):
    """They are left out."""
    two = {"a": runs["stiff"], "b": runs["stiff"]}
    labels = [panel.get_ylabel() for panel in hf.plot.compare_runs(two)["hands"].axes]
    assert "margin [N]" not in labels and "internal [N]" in labels


def test_nothing_is_cut_off(runs, figures):
    """The panels of a row have one axis, which takes in the largest of every arm and run."""
    larger = replace(runs["stiff"], grasp_wrench=runs["stiff"].grasp_wrench * np.array([1.0, 9.0])[:, None])
    for panel in hf.plot.compare_runs({**runs, "larger": larger})["hands"].axes:
        low, high = panel.get_ylim()
        for curve in drawn(panel).values():
            assert np.nanmin(curve[:, 1]) >= low - 1e-12 and np.nanmax(curve[:, 1]) <= high


def test_refusals(runs):
    """What is no mapping of runs, too few, and what does not know its chain."""
    for given, said in (
        ({"soft": runs["soft"]}, "expected 2 to 20 runs by name, got 1"),
        (list(runs.values()), "got a list"),
        ({"a": runs["soft"], "b": 3}, "'b': expected a run, got a int"),
        ({"a": runs["soft"], "b": replace(runs["soft"], setting=None)}, "chain"),
    ):
        with pytest.raises(hf.errors.StateError, match=said):
            hf.plot.compare_runs(given)
