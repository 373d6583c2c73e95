"""One version everywhere, and the changelog has it."""

import re
import tomllib
from pathlib import Path

import holdfast

ROOT = Path(__file__).parents[1]


def test_one_version():
    """The package, what it is built from, the citation and the changelog's newest version agree."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = re.findall(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    listed = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert listed[0] == "Unreleased"
    assert {project["version"], *cited, listed[1]} == {holdfast.__version__}
