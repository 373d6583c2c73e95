"""A result that several commands read."""

from pathlib import Path

import pytest

from holdfast.cli import main

EXAMPLE = Path(__file__).parents[2] / "examples" / "two_pandas.toml"


@pytest.fixture(scope="session")
def result(tmp_path_factory):
    """A result of three samples, without plots."""
    folder = tmp_path_factory.mktemp("result")
    text = EXAMPLE.read_text().replace("duration = 2.0", "duration = 0.02").replace("step = 0.002", "step = 0.01")
    (folder / "short.toml").write_text(text)
    assert main(["simulate", str(folder / "short.toml"), "--out", str(folder / "result"), "--no-plots"]) == 0
    return folder / "result"


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """The demo's scene, ten steps long, in the folder where the test runs."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "short.toml"
    path.write_text(EXAMPLE.read_text().replace("duration = 2.0", "duration = 0.02"))
    return path
