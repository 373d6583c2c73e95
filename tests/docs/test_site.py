"""The site builds without a warning, and what it builds asks nothing of the network."""

import re
import resource
import subprocess
import sys

import pytest

from tests.docs.pages import DOCS

LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"(https?:[^\"]+)\"")


def processor_time() -> float:
    """Return the processor time of all child processes that have ended [s]; other work beside them does not count."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.mark.long
def test_site(tmp_path):
    """`sphinx-build -W` takes below a minute of processor time; every page has a title; nothing comes from afar."""
    pytest.importorskip("furo", reason="the extra 'docs' is not installed")
    begin = processor_time()
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(DOCS), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = processor_time() - begin
    assert built.returncode == 0, built.stderr
    pages = sorted(tmp_path.rglob("*.html"))
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not LOADED.findall(text), page.name
        assert "<title>" in text
        misread = re.findall(r"\|---|Type<span class=\"colon\">|</strong> \(<em>", text)
        assert not misread, (page.name, "a table as text, or words of a docstring taken for a type")
    notebook = (tmp_path / "first_run.html").read_text(encoding="utf-8")
    assert notebook.count("<iframe") == 1 and notebook.count("data:image/png") == 4, (
        "the page and the pictures it shows"
    )
    print(f"{len(pages)} pages in {seconds:.0f} s of processor time")
    assert seconds < 60
