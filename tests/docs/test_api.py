"""What the documentation names is there, and the other way round: public names, robots, commands, extras."""

import pkgutil
import re
import tomllib

import pytest

from holdfast.cli.commands import COMMANDS
from tests.docs.pages import DOCS, PAGES, ROOT
from tests.surface import PUBLIC

FOR_DEVELOPERS = {"bench", "dev", "docs"}
DIRECTIVE = re.compile(r"^\.\. (?:auto\w+|py:data):: (holdfast[\w.]*)(?:\(.*\))?$", re.MULTILINE)
DOCUMENTED = [
    name for page in sorted((DOCS / "api").glob("*.md")) for name in DIRECTIVE.findall(page.read_text(encoding="utf-8"))
]


def test_every_public_name():
    """Each function, class and table of the top and of the themes stands on an API page, under that name."""
    homes = {path for path in PUBLIC if path.startswith("robots.") and path.removeprefix("robots.").isupper()}
    assert {f"holdfast.{path}" for path in PUBLIC.keys() - homes} - set(DOCUMENTED) == set()


def test_every_command():
    """The commands of the command line have a row each, and no others."""
    page = (DOCS / "api" / "command_line.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `holdfast ([\w-]+)", page, re.MULTILINE)) == set(COMMANDS)


def test_no_other_name():
    """Every documented name exists, is documented once, and has a text of its own."""
    assert len(DOCUMENTED) == len(set(DOCUMENTED))
    for name in DOCUMENTED:
        found = pkgutil.resolve_name(name)
        assert isinstance(found, dict) or getattr(found, "__doc__", None), name


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
    listed = text[text.index("The extras are") : text.index("Slower targets")]
    assert {name for name in extras - FOR_DEVELOPERS if f"`{name}`" not in listed} == set()
    for installed in re.findall(r"\.\[([\w,]+)\]|holdfast\[([\w,]+)\]", text):
        assert set("".join(installed).split(",")) <= extras
