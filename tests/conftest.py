"""What all tests share: a cache of machine code of their own, and a summary that names what this machine lacks."""

import gc
import os
from collections import Counter
from pathlib import Path

import pytest

NEEDS = "Skipped: needs "


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    """Leave the user's cache alone; this one is shared by all processes, or all runs that `tests.portable` starts."""
    place = tmp_path_factory.getbasetemp()
    if place.name.startswith("popen-"):  # a worker's: its parent is the run's
        place = place.parent
    folder = Path(os.environ.get("HOLDFAST_TEST_CACHE") or place / "machine-code")
    folder.mkdir(mode=0o700, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOLDFAST_CACHE", str(folder))
        yield


@pytest.fixture
def cli(capsys):
    """Return a function that calls the program, requires its exit code, and returns what it prints, as (out, err)."""
    from holdfast.cli import main

    def call(*arguments, code=0):
        capsys.readouterr()
        assert main([*map(str, arguments)]) == code
        return capsys.readouterr()

    return call


def pytest_collection_finish():
    """Leave ten thousand tests and their modules out of every later search for garbage: they stay to the end."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter):
    """Name every program that tests were skipped for; their reasons begin with `needs` and end with a command."""
    lacking = Counter(
        report.longrepr[2].removeprefix(NEEDS)
        for report in terminalreporter.stats.get("skipped", [])
        if isinstance(report.longrepr, tuple) and report.longrepr[2].startswith(NEEDS)
    )
    if lacking:
        terminalreporter.section("NOT TESTED ON THIS MACHINE", sep="!", red=True, bold=True)
        for what, count in sorted(lacking.items()):
            terminalreporter.write_line(f"{count} test{'s' * (count > 1)} not run: needs {what}", red=True, bold=True)
