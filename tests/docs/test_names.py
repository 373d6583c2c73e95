"""What the documentation names is there: robots of other packages, extras, and the other way round."""

import re
import tomllib

import pytest

from tests.docs.pages import PAGES, ROOT

FOR_DEVELOPERS = {"bench", "dev", "docs"}


def test_robots_of_robot_descriptions():
    """Every description that a page, a docstring or an example loads exists, and is a URDF."""
    known = pytest.importorskip("robot_descriptions", reason="needs the extra robots").DESCRIPTIONS
    sources = [*PAGES, *(ROOT / "examples").rglob("*.py"), *(ROOT / "src").rglob("*.py")]
    loaded = re.compile(r"""load_robot_description\(\s*["'](\w+)["']""")
    named = {name: path for path in sources for name in loaded.findall(path.read_text(encoding="utf-8"))}
    assert named
    assert {name for name in named if name not in known or not known[name].has_urdf} == set()


def test_the_readme_names_every_extra():
    """Those that a user may need, each as code; and none that does not exist."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(project["optional-dependencies"])
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    listed = text[text.index("The extras:") : text.index("Longer:")]
    assert {name for name in extras - FOR_DEVELOPERS if f"`{name}`" not in listed} == set()
    for installed in re.findall(r"\.\[([\w,]+)\]|holdfast\[([\w,]+)\]", text):
        assert set("".join(installed).split(",")) <= extras
