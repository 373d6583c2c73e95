"""Every code block of the documentation and the README runs.

A page is one test: its blocks run in order, in one namespace and one folder of their own. `python` runs, its
`>>>` compared with what stands below; in `console` the lines `$ holdfast ...` run, and what stands below a
command is compared with what it prints; `toml` and `xml` whose first line is a comment with a file's name are
written to that file, for the blocks after them; `toml` is a scene and must load. A block that is not run says why:
`<!--- skip: next "..." -->`.
"""

import contextlib
import doctest
import io
import re
import shlex
from pathlib import Path
from unittest import SkipTest

import pytest
from markdown_it import MarkdownIt
from sybil import Sybil
from sybil.example import Example
from sybil.parsers.myst import CodeBlockParser, PythonCodeBlockParser, SkipParser

from holdfast.cli import main
from holdfast.scenario.build import load_scene
from tests.docs.pages import DOCS, PAGES, fences, name
from tests.longer import mostly_slow

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
RUN = {"python", "console", "toml", "xml"}
SHOWN = {"text", "bibtex", "matlab", "cpp"}  # output, listings; C++ is built in `tests/codegen`
FILE_NAME = re.compile(r"(?:#|<!--)\s*([\w/.-]+\.\w+)\b")
UNREASONED = re.compile(r"skip: (?:next|start)(?! (?:if\(.*)?\"[^\"]{8,}\")")
WIDEST = 88  # characters of a line of code on the site, so that no block scrolls sideways
TEXT = {"{math}", "{glossary}", "{eval-rst}"}
COMMAND = re.compile(r"^\$ (.*)\n", re.MULTILINE)


def run_commands(example: Example) -> None:
    """Run the commands of a `console` block and compare what they print with what stands below each."""
    _, *parts = COMMAND.split(example.parsed)
    for command, expected in zip(parts[::2], parts[1::2], strict=True):
        program, *arguments = shlex.split(command, comments=True)
        assert program == "holdfast", f"{command}: a command that does not run; mark the block with a skip"
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            assert main(arguments) == 0, f"{command}: refused"
        if expected.strip():
            assert doctest.OutputChecker().check_output(expected, said.getvalue(), FLAGS), said.getvalue()


def write_file(example: Example) -> None:
    """Write a block that begins with a file's name to that file."""
    named = FILE_NAME.match(example.parsed)
    if named:
        path = Path(named[1])
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(example.parsed, encoding="utf-8")


def load_scene_file(example: Example) -> None:
    """Write a scene to its file and load it: it becomes a chain, closed, that can be simulated."""
    named = FILE_NAME.match(example.parsed)
    assert named, "a scene without a name is not loaded; try a first line such as '# lift.toml: ...'"
    write_file(example)
    load_scene(named[1])


BLOCKS = Sybil(
    parsers=[
        PythonCodeBlockParser(doctest_optionflags=FLAGS),
        CodeBlockParser("console", run_commands),
        CodeBlockParser("toml", load_scene_file),
        CodeBlockParser("xml", write_file),
        SkipParser(),
    ],
    patterns=["*.md"],
)


RUNNING = [page for page in PAGES if any(language in RUN for language, _ in fences(page))]
SECONDS = ("scenes.md", "results.md")  # pages whose blocks take some
SOON = [page for page in RUNNING if page.parent.name != "how_to" and page.name not in SECONDS]


@pytest.mark.parametrize("page", mostly_slow(RUNNING, SOON), ids=name)
def test_blocks_run(page, tmp_path, monkeypatch):
    """What a reader copies works, and prints what the page says."""
    monkeypatch.chdir(tmp_path)
    for example in BLOCKS.parse(page).examples():
        with contextlib.suppress(SkipTest):  # of one block, not of the page
            example.evaluate()


def test_first_example():
    """README and the home page begin with the same program: an import and at most eight lines, without a quaternion."""
    first, home = (
        next(text for language, text in fences(page) if language == "python") for page in (PAGES[0], DOCS / "index.md")
    )
    assert first == home
    assert len([line for line in first.splitlines() if line.strip() and not line.startswith("import")]) <= 8
    assert not re.search(r"wxyz|\[(?:[^\],]*,){6,}", first)


def test_the_first_screen():
    """Before their first section, README and the home page have a picture, a program and the command that installs."""
    for page in (PAGES[0], DOCS / "index.md"):
        text = page.read_text(encoding="utf-8").split("\n## ")[0]
        shown = [text.index(part) for part in ("viewer.png", "```python", "pip install")]
        assert shown == sorted(shown)
        assert len(text[: shown[-1]].splitlines()) <= 32, "one screen"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_blocks_are_known(page):
    """Every block has a language that is run, or one that cannot be; every skipped one says why."""
    text = page.read_text(encoding="utf-8")
    for language, _ in fences(page):
        assert language in RUN | SHOWN or language.startswith("{"), f"{language!r} would never run"
    assert not UNREASONED.findall(text)
    indented = [token.content for token in MarkdownIt("commonmark").parse(text) if token.type == "code_block"]
    assert all(block.startswith("make ") for block in indented), "an indented block never runs; try a fence"


@pytest.mark.parametrize("page", [page for page in PAGES if DOCS in page.parents], ids=name)
def test_code_fits(page):
    """Every line of every fenced block is at most as wide as its column; equations and the glossary are no code."""
    wide = [line for language, text in fences(page) if language not in TEXT for line in text.splitlines()]
    assert [line for line in wide if len(line) > WIDEST] == []
