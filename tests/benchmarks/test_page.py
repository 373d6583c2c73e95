"""From the document to Markdown, and to the figures of the page."""

import copy

import pytest
from benchmarks import bench_page as page
from benchmarks.bench import tables
from benchmarks.bench.tables import Table, number

from tests.benchmarks.tiny import tiny_document


@pytest.mark.slow
def test_readme_is_a_pure_function_of_the_document():
    """The same document gives the same text and is left as it was; its numbers are the document's."""
    document = tiny_document()
    before = copy.deepcopy(document)
    text = page.readme(document)
    assert page.readme(copy.deepcopy(before)) == text
    assert document == before
    own = document["systems"][0]["entries"][0]
    assert f"| 2 x 7 | {number(own['microseconds'])} us |" in text
    assert "| 3 x 6 |" not in text  # not among the sizes of the README


@pytest.mark.slow
def test_page_has_everything():
    """Every system, entry and version is on the page; no date."""
    document = tiny_document()
    text = page.page(document)
    for record in document["systems"]:
        assert record["name"] in text
        for entry in record["entries"]:
            assert f"{entry['library']} {entry['name']}" in text
    for peer in document["peers"].values():
        assert peer.get("version", "Not compared") in text
    assert document["machine"]["processor"] in text
    assert "images/bench_arms.png" in text


@pytest.mark.slow
def test_absent_and_skipped_are_on_the_page():
    """What was not compared is said, with the reason."""
    document = copy.deepcopy(tiny_document())
    document["peers"]["mujoco"] = {"absent": "not here; try pip install mujoco-core"}
    document["systems"][0]["skipped"] = [{"library": "pinocchio", "name": "lcaba, free", "reason": "needs 3 GB"}]
    text = page.page(document)
    assert "mujoco: not compared: not here; try pip install mujoco-core" in text
    assert "pinocchio lcaba, free at 2 x 7: skipped: needs 3 GB" in text


def test_between_the_markers():
    """Only what is between the markers changes, however often."""
    text = f"above\n{page.BEGIN}\nold\n{page.END}\nbelow\n"
    once = page.with_table(text, "new\n")
    assert once == f"above\n{page.BEGIN}\nnew\n{page.END}\nbelow\n"
    assert page.with_table(once, "new\n") == once
    with pytest.raises(ValueError, match="bench:begin"):
        page.with_table("no markers", "new\n")


def test_markdown_and_cut():
    """A table as Markdown, and cut into narrower ones whose last has the notes."""
    table = Table("t", ["x", "a", "b", "c"], [["1", "2", "3", "4"]], ["note"])
    assert table.markdown() == "| x | a | b | c |\n| --- | --- | --- | --- |\n| 1 | 2 | 3 | 4 |\n\nnote\n"
    left, right = table.cut(2)
    assert (left.header, left.rows, left.notes) == (["x", "a", "b"], [["1", "2", "3"]], [])
    assert (right.header, right.rows, right.notes) == (["x", "c"], [["1", "4"]], ["note"])


def test_numbers():
    """About three digits."""
    assert [number(x) for x in (0.1234, 1.234, 12.34, 123.4, 12345.6)] == ["0.123", "1.23", "12.3", "123", "12,346"]


@pytest.mark.slow
def test_disturbed_times_are_marked():
    """Quartiles that are far apart tell that others used the machine."""
    document = copy.deepcopy(tiny_document())
    entry = document["systems"][0]["entries"][0]
    entry |= {"lower_quartile": 1.0, "microseconds": 1.5, "upper_quartile": 2.0}
    assert tables.times(document).rows[0][1] == "~1.50"


@pytest.fixture
def plots():
    """The module, which needs matplotlib."""
    pytest.importorskip("matplotlib", reason="needs matplotlib: pip install 'holdfast[plot]'")
    from benchmarks import bench_plots as plots

    return plots


@pytest.mark.slow
def test_figures(plots, tmp_path):
    """Three pictures, log-log, our line in each."""
    names = plots.save(tiny_document(), tmp_path)
    assert sorted(names) == ["bench_arms.png", "bench_batch.png", "bench_links.png"]
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in names)
    figure = plots.batch_curve(tiny_document())
    (panel,) = figure.axes
    assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
    assert any(line.get_label().startswith("holdfast") for line in panel.lines)
