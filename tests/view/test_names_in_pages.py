"""No name can break a page, a figure or a file: pages are read as browsers read them, and opened in one."""

import json
import re
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelError
from holdfast.interop import to_mjcf
from holdfast.view.inline import InlinePage
from holdfast.view.markers import arrow_scale
from holdfast.view.page import export_page, panel_data, with_chooser, with_panel
from holdfast.view.playback import playback_of_run
from holdfast.view.plots import figures, write_figures
from tests.view.chromium import browser
from tests.view.runs import lifted

NAMES = [
    "<!--<script>", "</script><b>", "<!--<SCRIPT ", "-->", "]]>", "\"'`${1}\\", "&lt;&amp;", "a\u2028b\u2029c",
    "a\x00b\x1b[31m\rc", "\u202eright to left", "שלום", "$x_1 \\frac{$", "_low", "a/b", "(own)", "..", "__proto__",
    "constructor", "x" * 300, "", " ", "\U0001f916",
]  # fmt: skip


class Page(HTMLParser):
    """What a browser makes of a page: its title, the contents of scripts, and other elements by their ids.

    `html.parser` knows no double-escaped script data: `script_texts` follows that rule of HTML (13.2.5.20 and later).
    """

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.title, self.ids, self._in_title = "", {}, False
        self.scripts, outside = script_texts(text)
        self.feed(outside)

    def handle_starttag(self, tag, attributes):
        self._in_title = tag == "title"
        self.ids[dict(attributes).get("id")] = tag

    def handle_data(self, data):
        self.title += data if self._in_title else ""

    def handle_endtag(self, tag):
        self._in_title = False


OPENING = re.compile(r"<script\b([^>]*)>", re.IGNORECASE)
MARKS = re.compile(r"<!--|-->|<script[\s/>]|</script[\s/>]", re.IGNORECASE)


def script_texts(text):
    """Return the texts of all scripts by id, and the page without them; a script that is never closed raises."""
    scripts, outside, at = {}, [], 0
    while (opening := OPENING.search(text, at)) is not None:
        outside.append(text[at : opening.start()])
        state, end = "data", None
        for mark in MARKS.finditer(text, opening.end()):
            what = mark[0].lower()
            if what == "<!--" and state == "data":
                state = "escaped"
            elif what == "-->":
                state = "data"
            elif what.startswith("<script") and state == "escaped":
                state = "double"
            elif what.startswith("</script"):
                if state != "double":
                    end = mark
                    break
                state = "escaped"
        assert end is not None, "the rest of the page is part of a script"
        scripts[(re.search(r'id="([^"]*)"', opening[1]) or [None, None])[1]] = text[opening.end() : end.start()]
        at = text.index(">", end.start()) + 1
    return scripts, "".join([*outside, text[at:]])


FRAME = "<html><head><title>Viser</title></head><body><div id='root'></div></body></html>"


@pytest.fixture(scope="module")
def lifting():
    return lifted()


def named(lifting, name):
    """Return the playback of the run, with the name as title and as that of the left arm and its first joint."""
    chain, run = lifting
    arm = chain.arms["left"]
    joints = [replace(arm.joints[0], name=name), *arm.joints[1:]]
    both = {name: replace(arm, joints=joints, name=name), "right": chain.arms["right"]}
    renamed = replace(chain, arms=both, grasps={name: chain.grasps["left"], "right": chain.grasps["right"]})
    return playback_of_run(renamed, run, name), renamed, run


@pytest.mark.parametrize("name", NAMES)
def test_a_page_of_any_name(name, lifting):
    """The page has its panel, data and script, with every name as it is; also among several, and in a notebook."""
    playback, *_ = named(lifting, name)
    playback = replace(playback, notes=(name,))
    text = with_panel(FRAME, playback, arrow_scale(playback))
    page = Page(text)
    assert json.loads(page.scripts["holdfast-data"]) == panel_data(playback, arrow_scale(playback))
    assert "getElementById" in page.scripts[None]
    assert page.ids["holdfast"] == "aside" and page.ids["root"] == "div"
    assert page.title.replace("\r", "\n") == name.replace("\r", "\n")
    several = Page(with_chooser([text, FRAME], [name, "other"]))
    assert json.loads(several.scripts["pages"]) == {"titles": [name, "other"], "pages": [text, FRAME]}
    assert several.title.replace("\r", "\n") == f"{name}, other".replace("\r", "\n")
    inline = InlinePage(text, name)._repr_html_()
    assert inline.count("<") == 2 and inline.count('"') == 6


def test_lone_surrogates(lifting):
    """A title with one is shown; the model takes no such name, since no file could contain it."""
    playback = replace(playback_of_run(*lifting, "run"), title="a\ud800b")
    text = with_panel(FRAME, playback, arrow_scale(playback))
    assert text.encode("utf-8")
    assert json.loads(Page(text).scripts["holdfast-data"])["title"] == "a\ud800b"
    for wrong in (
        lambda: hf.Joint("revolute", name="\ud800"),
        lambda: hf.Link(1.0, inertia=np.eye(3), name="\udfff"),
        lambda: named(lifting, "\ud800"),
        lambda: hf.Arm([], [], name="\ud800"),
    ):
        with pytest.raises(ModelError, match="expected a text that UTF-8 can encode"):
            wrong()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["$x_1 \\frac{$", "_low", "x" * 300, "", "a\x00b\r", "\u05e9\u202e\U0001f916"])
def test_figures_of_any_name(name, lifting, tmp_path):
    """They are drawn without a warning and without formulas, and legends have every arm and joint."""
    pytest.importorskip("matplotlib", reason="needs matplotlib: pip install 'holdfast[plot]'")
    _, chain, run = named(lifting, name)
    drawn = {one: figure for one, figure in figures(chain, run).items() if one in ("joint_torques", "load_share")}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_figures(drawn, tmp_path)
    shown = drawn["joint_torques"].axes[0].title.get_text()
    assert shown.count("$") == shown.count(r"\$") == name.count("$")
    of = {one: [*figure.legends, *(axes.get_legend() for axes in figure.axes)] for one, figure in drawn.items()}
    legends = {one: [text.get_text() for x in found if x for text in x.get_texts()] for one, found in of.items()}
    assert legends["load_share"] == [shown, "right"]
    assert (shown if name else "joint1") in legends["joint_torques"]


@pytest.mark.parametrize("name", NAMES)
def test_mjcf_of_any_name(name, lifting):
    """The model has the name, or it is refused because XML could not contain it."""
    _, chain, _ = named(lifting, name)
    if name.isprintable():
        bodies = {body.get("name") for body in ElementTree.fromstring(to_mjcf(chain)).iter("body")}
        assert name in bodies or not name
    else:
        with pytest.raises(ModelError, match="expected printable names"):
            to_mjcf(chain)


TEXTS = """() => [...document.querySelectorAll("#holdfast h1 bdi, #holdfast p, #holdfast .values bdi")]
    .map(node => node.textContent)"""
SHOWN = [name for name in NAMES if name.strip()]


@pytest.mark.long
def test_names_in_a_browser(lifting, tmp_path):
    """Title, legend and notes of the page in Chromium are the names; the panel follows; nothing complains."""
    pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")
    name, title = "</script><b>\u202e\u2028(own)/..\x00\"'", "<!--<script>"
    playback, *_ = named(lifting, name)
    export_page(replace(playback, title=title, notes=(f"note {name}",)), tmp_path / "page.html")
    with browser(480, 300) as chromium:
        chromium.open(tmp_path / "page.html")
        texts = chromium.ask(TEXTS)
        assert texts[0] == title == chromium.page.title()
        assert f"note {name}" in texts and f"{name}, internal" in texts and texts.count(name) >= 3
        chromium.page.wait_for_function("() => document.getElementById('holdfast').see({time: 1.0})")
        chromium.page.wait_for_selector("#holdfast output:has-text('t = 1.00 s')")
        assert chromium.ask("() => document.querySelectorAll('b').length") == 0
        export_page([replace(playback_of_run(*lifting, name), title=name) for name in SHOWN[:3]], tmp_path / "all.html")
        chromium.page.goto((tmp_path / "all.html").as_uri())
        assert chromium.ask("() => [...document.querySelectorAll('nav button')].map(b => b.textContent)") == SHOWN[:3]
        chromium.page.query_selector("iframe.shown").content_frame().wait_for_selector("#holdfast h1", timeout=60_000)
        assert not chromium.errors
