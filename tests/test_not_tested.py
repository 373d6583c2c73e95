"""What a machine lacks for some tests is named once, at the end of a run."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
SKIPPED = """
import pytest

@pytest.mark.parametrize("k", range(3))
def test_pages(k):
    pytest.skip("needs a browser: apt-get install browser")

def test_elsewhere():
    pytest.skip("not on this system")

def test_here():
    pass
"""


def test_missing_programs_are_named(tmp_path):
    """With the number of tests and the command; other skips are not, and pytest's own line is still the last."""
    (tmp_path / "test_skipped.py").write_text(SKIPPED)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "tests.conftest", str(tmp_path)]
    env = {name: value for name, value in os.environ.items() if name != "PYTEST_ADDOPTS"}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=120)
    lines = done.stdout.strip().splitlines()
    assert done.returncode == 0
    assert lines.count("3 tests not run: needs a browser: apt-get install browser") == 1
    assert "NOT TESTED ON THIS MACHINE" in lines[-3] and "not on this system" not in done.stdout
    assert lines[-1].startswith("1 passed, 4 skipped in")
