"""The site builds without a warning, and what it builds asks nothing of the network."""

import re
import subprocess
import sys
import time

import pytest

from tests.docs.pages import DOCS

LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"(https?:[^\"]+)\"")


@pytest.mark.long
def test_site(tmp_path):
    """`sphinx-build -W` passes within a minute; every page has a title; nothing is loaded from elsewhere."""
    pytest.importorskip("furo", reason="the extra 'docs' is not installed")
    begin = time.perf_counter()
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(DOCS), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = time.perf_counter() - begin
    assert built.returncode == 0, built.stderr
    pages = sorted(tmp_path.rglob("*.html"))
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not LOADED.findall(text), page.name
        assert "<title>" in text
    notebook = (tmp_path / "first_run.html").read_text(encoding="utf-8")
    assert notebook.count("<iframe") == 1 and notebook.count("data:image/png") == 4, (
        "the page and the pictures it shows"
    )
    print(f"{len(pages)} pages in {seconds:.0f} s")
    assert seconds < 60
