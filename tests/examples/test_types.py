"""A user's strict type checker accepts the examples, hence the library's annotations: pyright does in `make test`."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WRONG = """
import holdfast as hf

state = hf.State([0.0], [0.0], hf.Pose.identity())
length: int = state.q
hf.Pose(None, [0, 0, 0])
"""


def mypy(cache: Path, *arguments: str) -> tuple[int, str]:
    """Return the exit code and the output of mypy by the project's settings, which are strict."""
    if find_spec("mypy") is None:
        pytest.skip("needs mypy: pip install 'holdfast[dev]'")
    found = subprocess.run(
        [sys.executable, "-m", "mypy", "--cache-dir", str(cache), *arguments],
        cwd=ROOT, capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    return found.returncode, found.stdout + found.stderr


@pytest.mark.slow
def test_examples_are_strictly_typed(tmp_path):
    """`mypy --strict` finds nothing in the examples, and what is wrong in a script that is."""
    code, output = mypy(tmp_path)
    assert code == 0, output
    (tmp_path / "wrong.py").write_text(WRONG)
    code, output = mypy(tmp_path, str(tmp_path / "wrong.py"))
    assert code == 1
    assert 'expression has type "ndarray' in output
    assert 'Argument 1 to "Pose" has incompatible type "None"' in output
