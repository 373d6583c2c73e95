"""The site builds without a warning, and what it builds asks nothing of the network."""

import re
import resource
import subprocess
import sys
from urllib.parse import quote_plus

import pytest

from tests.docs.pages import DOCS
from tests.view.chromium import browser

LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"(https?:[^\"]+)\"")


def processor_time() -> float:
    """Return the processor time of all child processes that have ended [s]; other work beside them does not count."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


# what a reader types, and the page that answers
SEARCHED = {
    "QP": "how_to/force_distribution.html",
    "null space": "how_to/force_distribution.html",
    "posture": "glossary.html",
    "redundancy": "how_to/joint_paths.html",
    "friction": "how_to/force_distribution.html",
    "internal_force": "how_to/force_distribution.html",
    "inverse kinematics": "functions.html",
    "gripper": "glossary.html",
}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return the folder of the site and the processor time that it took [s]."""
    pytest.importorskip("furo", reason="needs the extra 'docs': pip install 'holdfast[docs]'")
    folder, begin = tmp_path_factory.mktemp("site"), processor_time()
    run = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(DOCS), str(folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return folder, processor_time() - begin


@pytest.mark.long
def test_site(built):
    """`sphinx-build -W` takes below a minute of processor time; every page has a title; nothing comes from afar."""
    folder, seconds = built
    pages = sorted(folder.rglob("*.html"))
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not LOADED.findall(text), page.name
        assert "<title>" in text
        misread = re.findall(r"\|---|Type<span class=\"colon\">|</strong> \(<em>", text)
        assert not misread, (page.name, "a table as text, or words of a docstring taken for a type")
    notebook = (folder / "first_run.html").read_text(encoding="utf-8")
    assert notebook.count("<iframe") == 1 and notebook.count("data:image/png") == 4, (
        "the page and the pictures it shows"
    )
    print(f"{len(pages)} pages in {seconds:.0f} s of processor time")
    assert seconds < 60


@pytest.mark.long
def test_search(built):
    """The search of the site leads to the page that answers: it is the first hit, or the second."""
    folder, _ = built
    with browser() as chromium:
        for words, page in SEARCHED.items():
            chromium.page.goto(f"{(folder / 'search.html').as_uri()}?q={quote_plus(words)}")
            chromium.page.wait_for_function(
                "() => /finished|matching/i.test(document.querySelector('#search-results').innerText)"
            )
            hits = chromium.ask(HITS)
            assert page in hits[:2], (words, hits[:5])


@pytest.mark.long
def test_the_first_screen(built):
    """On a laptop's screen and on a phone's nothing scrolls sideways; picture, program and installation come first."""
    folder, _ = built
    for width, height in ((1280, 800), (390, 844)):
        with browser(width, height) as chromium:
            chromium.page.goto((folder / "index.html").as_uri())
            assert chromium.ask("() => document.documentElement.scrollWidth") == width
            bottoms = chromium.ask(BOTTOMS)
            assert bottoms == sorted(bottoms)
            assert width < 1280 or bottoms[-1] < height


HITS = """() => [...document.querySelectorAll('#search-results ul.search > li > a')]
  .map(hit => new URL(hit.href).pathname.split('/site')[1].replace(/^[^/]*[/]/, ''))"""
BOTTOMS = """() => ['article img', '.highlight-python', '.highlight-console']
  .map(of => document.querySelector(of).getBoundingClientRect().bottom)"""
