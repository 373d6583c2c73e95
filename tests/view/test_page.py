"""The exported page: one file, the same for the same run, small, with nothing to fetch."""

import json
import re

import numpy as np
import pytest

from holdfast.view.film import film_of_run
from holdfast.view.markers import arrow_scale
from holdfast.view.page import HERE, export_page, page, panel_data, with_panel
from tests.view.runs import lifted

pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")


@pytest.fixture(scope="module")
def film():
    chain, run = lifted()
    return film_of_run(chain, run, "lift </script> & carry")


def test_same_film_same_file(film, tmp_path):
    """Byte for byte, so that a page can be kept and compared; the client and little else is in it."""
    export_page(film, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text == page(film)
    assert len(text) < 1.0e6
    assert "<title>lift &lt;/script&gt; &amp; carry</title>" in text


def test_nothing_to_fetch():
    """Our part of the page names no address but that of SVG's namespace."""
    for kind in ("css", "js"):
        text = (HERE / f"page_panel.{kind}").read_text()
        assert set(re.findall(r"https?://[^\s\"']+", text)) <= {"http://www.w3.org/2000/svg"}
        assert "@import" not in text
        assert "url(" not in text


def test_panel_data(film):
    """What the panel shows is the film's, and can be read back from the page whatever the title is."""
    frame = "<html><head><title>Viser</title></head><body></body></html>"
    text = with_panel(frame, film, arrow_scale(film))
    data = json.loads(re.search(r'id="holdfast-data">(.*?)</script>', text)[1])
    assert data == json.loads(json.dumps(panel_data(film, arrow_scale(film))))
    assert data["title"] == film.title
    assert data["times"] == pytest.approx(film.t)
    force, _, margin, _, condition = data["plots"]
    assert [curve["label"] for curve in force["curves"]] == ["left", "right", "left, internal", "right, internal"]
    assert force["curves"][1]["values"] == pytest.approx(np.linalg.norm(film.wrench[:, 1, 3:], axis=1), rel=1e-3)
    assert margin["curves"][0]["values"] == pytest.approx(film.margin[:, 0], rel=1e-3)
    assert [plot["title"].count("[") for plot in data["plots"]] == [1] * 5, "a unit each"
    assert condition["log"]
    (meter,) = data["meters"]
    assert all(0.0 <= value < 0.5 for value in meter["values"])


def test_no_plots_of_nothing():
    """Two-sided grasps have no margins to show."""
    chain, run = lifted("rigid", "rigid")
    film = film_of_run(chain, run, "rigid")
    titles = [plot["title"] for plot in panel_data(film, arrow_scale(film))["plots"]]
    assert not [title for title in titles if "margin" in title]
    assert "Friction" not in panel_data(film, arrow_scale(film))["notes"][0]
