"""Lines of code and the shape of the library, of a repository small enough to be counted by hand."""

import json
import sys

import pytest
from benchmarks import code_lines

FILES = {
    "src/holdfast/__init__.py": '"""Top."""\n',
    "src/holdfast/__init__.pyi": "from .model.arm import Arm as Arm\nfrom .model.arm import Link as Link\n",
    "src/holdfast/model/arm.py": "from holdfast.model import link\n\n\ndef late():\n    import holdfast.view.page\n",
    "src/holdfast/model/link.py": "from holdfast.model.joint import Joint\n",
    "src/holdfast/model/joint.py": "from holdfast.model.arm import (\n    Arm,\n    Link,\n)\n",
    "src/holdfast/view/page.py": "import typing\n\nif typing.TYPE_CHECKING:\n    import holdfast.model.arm\n",
    "src/holdfast/compiled/__init__.py": "class CompiledChain:\n    n = 1\n\n    def a(self): ...\n\n    _b = a\n",
    "benchmarks/bench/clock.py": "x = 1\n",
    "tests/test_it.py": '"""A\ntest."""\n\n# none\ny = """2\n\n"""\n',
}
HOUSE = {
    "code lines of src, bench included": 3 + 1 + 4 + 3 + 4 + 1,
    "code lines of tests": 3,
    "lines of imports in src": 2 + 1 + 4 + 2,
    "imports, per cent of src's code lines": 60.0,
    "public names": 2,
    "public methods of CompiledChain": 2,
    "modules in the largest circle of imports": 3,
    "imports of the core outward": 1,
}


@pytest.fixture
def root(tmp_path):
    """The small repository."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def test_house(root):
    """Every measure is the one counted by hand."""
    assert code_lines.house(root) == HOUSE


def test_printed(root, monkeypatch, capsys):
    """A row for each folder, for each part and for each measure; with --json one document of the same."""
    monkeypatch.setattr(sys, "argv", ["code_lines.py", "--root", str(root), "src", "tests", "none"])
    code_lines.main()
    printed = [line.split("  ") for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in printed] == [
        "src/holdfast", "src/holdfast/compiled", "src/holdfast/model", "src/holdfast/view", "src in all", "tests",
        "tests in all", *HOUSE,
    ]  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["code_lines.py", "--json", "--root", str(root), "tests"])
    code_lines.main()
    assert json.loads(capsys.readouterr().out) == {"folders": {"tests": {"tests": [3, 7, 1]}}, "house": HOUSE}
