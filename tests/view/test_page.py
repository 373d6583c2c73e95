"""The exported page: one file, the same for the same run, small, with nothing to fetch."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from holdfast.errors import ModelError
from holdfast.view.markers import arrow_scale
from holdfast.view.page import HERE, export_page, page, panel_data, plots, with_panel
from holdfast.view.playback import playback_of_run
from tests.view.runs import lifted, played

pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")


@pytest.fixture(scope="module")
def playback():
    return played("lift </script> & carry")


def test_same_playback_same_file(playback, tmp_path):
    """Byte for byte, so that a page can be kept and compared; the client and little else is in it."""
    export_page(playback, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text == page(playback)
    assert len(text) < 1.0e6
    assert "<title>lift &lt;/script&gt; &amp; carry</title>" in text


def test_nothing_to_fetch():
    """Our part of the page names no address but that of SVG's namespace."""
    for kind in ("css", "js"):
        text = (HERE / f"page_panel.{kind}").read_text()
        assert set(re.findall(r"https?://[^\s\"']+", text)) <= {"http://www.w3.org/2000/svg"}
        assert "@import" not in text
        assert "url(" not in text


def test_panel_data(playback):
    """What the panel shows is the playback's, and can be read back from the page whatever the title is."""
    frame = "<html><head><title>Viser</title></head><body></body></html>"
    text = with_panel(frame, playback, arrow_scale(playback))
    data = json.loads(re.search(r'id="holdfast-data">(.*?)</script>', text)[1])
    assert data == json.loads(json.dumps(panel_data(playback, arrow_scale(playback))))
    assert data["title"] == playback.title
    assert data["times"] == pytest.approx(playback.t)
    force, margin, _, condition = data["plots"]  # no moments, no plot of them
    assert [curve["label"] for curve in force["curves"]] == ["left", "right", "left, internal", "right, internal"]
    assert force["curves"][1]["values"] == pytest.approx(np.linalg.norm(playback.wrench[:, 1, 3:], axis=1), rel=1e-3)
    assert margin["curves"][0]["values"] == pytest.approx(playback.margin[:, 0], rel=1e-3)
    assert [plot["title"].count("[") for plot in data["plots"]] == [1] * 4, "a unit each"
    assert condition["log"]
    (meter,) = data["meters"]
    assert all(0.0 <= value < 0.5 for value in meter["values"])


def test_round_scales_and_the_trunks_colour(playback):
    """The length of 0.1 m stands for 1, 2 or 5 times a power of ten, of newtons and of newton metres."""
    said = panel_data(playback, arrow_scale(playback))["notes"][0]
    numbers = re.findall(r"0\.1\sm\sis\s([\d.e+-]+)", said)
    assert len(numbers) == 2 and {f"{float(number):e}"[0] for number in numbers} <= {"1", "2", "5"}
    assert {f"{float(number):e}"[2:8] for number in numbers} == {"000000"}
    assert "trunk" not in said


def test_a_spike_does_not_flatten_a_plot():
    """Its axis ends above what is usual; the values are all there."""
    chain, run = lifted("rigid", "rigid", 31)
    tau = run.tau.copy()
    tau[15, 5] = 48.0 * chain.arms["left"].joints[5].effort_limit
    found = plots(playback_of_run(chain, replace(run, tau=tau), "spike"))
    (torque,) = (plot for plot in found if plot["title"].startswith("largest torque"))
    assert max(torque["curves"][0]["values"]) == pytest.approx(4800.0)
    assert 20.0 < torque["range"][1] < 60.0
    assert [plot["range"] for plot in found if plot is not torque] == [None] * (len(found) - 1)


def test_no_plots_of_nothing():
    """Two-sided grasps have no margins to show."""
    chain, run = lifted("rigid", "rigid")
    playback = playback_of_run(chain, run, "rigid")
    titles = [plot["title"] for plot in panel_data(playback, arrow_scale(playback))["plots"]]
    assert not [title for title in titles if "margin" in title]
    assert "Friction" not in panel_data(playback, arrow_scale(playback))["notes"][0]


def test_a_page_of_several(playback, tmp_path):
    """Each playback's own page is in it, with arrows of one scale; titles tell them apart."""
    stronger = replace(playback, title="stronger", wrench=7.0 * playback.wrench)
    export_page([playback, stronger], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="pages">(.*?)</script>', text, re.DOTALL)[1])
    assert data["titles"] == [playback.title, "stronger"]
    assert data["pages"] == [page(one, arrow_scale(stronger)) for one in (playback, stronger)]
    for wrong, said in (([], "got 0"), ([playback] * 2, "twice"), ([playback, 3], "got a int")):
        with pytest.raises(ModelError, match=said):
            export_page(wrong, tmp_path / "none.html")
    assert not (tmp_path / "none.html").exists()
