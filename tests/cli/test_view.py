"""`holdfast view` from the command line: pages, scenes, refusals, and how it ends."""

import shutil
import signal
import subprocess
import sys
import urllib.request

import pytest

from tests.cli.conftest import EXAMPLE

pytest.importorskip("viser", reason="needs viser: pip install 'holdfast[view]'")


def test_page_of_a_result(result, tmp_path, cli):
    """One file, its size and number of frames on stdout; it is not overwritten unasked."""
    page = tmp_path / "page.html"
    said = cli("view", result, "--export", page, "--rate", "100")
    assert said.out == f"{page}: 0.8 MiB, 3 frames\n"
    assert said.err == ""
    assert "<title>two pandas lift a box</title>" in page.read_text()
    assert "try --overwrite" in cli("view", result, "--export", page, code=2).err
    assert "2 frames" in cli("view", result, "--export", page, "--overwrite", "--rate", "1").out
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


@pytest.mark.parametrize(
    ("again", "said"),
    [
        (("--export", "b.html"), "--export: expected once, got --export a.html and --export b.html"),
        (("--export=b.html",), "--export: expected once, got --export a.html and --export b.html"),
        (("--no-overwrite", "--overwrite"), "--overwrite: expected once, got --no-overwrite and --overwrite"),
    ],
)
def test_an_option_twice(tmp_path, monkeypatch, cli, again, said):
    """Neither the first nor the last is obeyed: both are named, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    assert (
        cli("view", EXAMPLE, "--export", "a.html", *again, code=2).err
        == f"holdfast: error: {said}; try one of them, or two commands\n"
    )
    assert not list(tmp_path.iterdir())


def test_page_of_a_scene(tmp_path, cli):
    """The state in which a scene begins, with the forces of its controller's torques."""
    page = tmp_path / "page.html"
    assert ", 1 frame\n" in cli("view", EXAMPLE, "--export", page).out
    assert '"label":"left, commanded","colour":"#0072B2","dashed":true,"values":[20.0]' in page.read_text()


def test_a_page_of_several(result, tmp_path, cli):
    """A run and a scene in one page, each under its own name."""
    page, scene = tmp_path / "page.html", tmp_path / "start.toml"
    shutil.copy(EXAMPLE, scene)
    assert cli("view", result, scene, "--export", page).out.endswith(" MiB, 2 runs, 3 frames\n")
    text = page.read_text()
    assert "<title>result, start.toml</title>" in text
    assert '"titles":["result","start.toml"]' in text


def test_another_scene(result, tmp_path, cli):
    """A folder whose scene was exchanged is refused before anything is drawn."""
    shutil.copytree(result, tmp_path / "copy")
    scene = tmp_path / "copy" / "scene.toml"
    scene.write_text(scene.read_text().replace('"left"', '"first"'))
    assert (
        "scene.toml is damaged, or another"
        in cli("view", tmp_path / "copy", "--export", tmp_path / "page.html", code=2).err
    )
    assert not (tmp_path / "page.html").exists()


# as at a terminal, whoever runs the tests: shells start what they put into the background with Ctrl-C ignored
PROGRAM = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from holdfast.cli import main
from tests.cli.conftest import EXAMPLE
sys.exit(main())
"""


@pytest.mark.slow
def test_a_live_viewer_ends_with_ctrl_c(result):
    """It prints its address, serves the page, and ends cleanly with code 0."""
    command = [sys.executable, "-c", PROGRAM, "view", str(result)]
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True) as viewer:
        try:
            address = viewer.stdout.readline().split()[0]
            assert address.startswith("http://127.0.0.1:")
            assert b"<html" in urllib.request.urlopen(address, timeout=10).read(500)
            viewer.send_signal(signal.SIGINT)
            out, err = viewer.communicate(timeout=30)
        finally:
            viewer.kill()
    assert (out, err, viewer.returncode) == ("closed\n", "", 0)
