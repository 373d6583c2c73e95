"""What the documentation names is there, and the other way round; public functions say what they take and return."""

import functools
import inspect
import pkgutil
import re
import tomllib

import pytest

import holdfast
from holdfast.cli.commands import COMMANDS
from tests.docs.pages import DOCS, FENCE, PAGES, ROOT
from tests.docs.pages import name as name_of
from tests.surface import PUBLIC

FOR_DEVELOPERS = {"bench", "dev", "docs"}
CALLED = re.compile(r"`hf\.([a-zA-Z_][\w.]*)")
COSTED = ("holdfast.dynamics", "holdfast.forces")
FUNCTIONS = {name: value for name, value in PUBLIC.items() if inspect.isfunction(value)}
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
        try:
            found = pkgutil.resolve_name(name)
        except AttributeError:  # of a function that has the name of its module
            found = functools.reduce(getattr, name.split(".")[1:], holdfast)
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


def absent_names(text: str) -> set[str]:
    """Return names after `hf.` in code spans of a page's running text that do not exist."""
    absent = set()
    for dotted in set(CALLED.findall(FENCE.sub("", text))):
        found = holdfast
        for part in dotted.rstrip(".").split("."):
            found = getattr(found, part, None)
        if found is None:
            absent.add(f"hf.{dotted}")
    return absent


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_named_functions_exist(page):
    """Every `hf.something` in a sentence or a table can be called by that name."""
    assert absent_names(page.read_text(encoding="utf-8")) == set()


def test_a_wrong_name_is_found():
    """A name that does not exist is reported, one that does is not; listings are left to the tests that run them."""
    assert absent_names("use `hf.forward_dynamic(chain)` or `hf.dynamics.closure`\n```text\n`hf.nothing`\n```\n") == {
        "hf.forward_dynamic"
    }


def undescribed(f) -> list[str]:
    """Return what a docstring does not say."""
    doc = inspect.getdoc(f) or ""
    described = doc.partition("Args:")[2]
    found = [
        name
        for name in inspect.signature(f).parameters
        if not re.search(rf"^\s+(\w+, )*\*{{0,2}}{name}\b.*:", described, re.MULTILINE)
    ]
    if not doc.startswith(("Return", "Write", "Make")) and "Returns:" not in doc:
        found.append("what it returns")
    if "Raises:" not in doc:
        found.append("what it refuses")
    if f.__module__.startswith(COSTED) and "O(" not in doc:
        found.append("what it costs")
    return found


@pytest.mark.parametrize("name", FUNCTIONS)
def test_docstring(name):
    """Nothing is missing."""
    assert undescribed(FUNCTIONS[name]) == []


def test_the_lint_finds_what_is_missing():
    """A docstring of one line lacks everything."""

    def bare(x):
        """Do something."""

    assert undescribed(bare) == ["x", "what it returns", "what it refuses"]
