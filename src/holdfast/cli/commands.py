"""The commands of the command line; each has its options and its help where it is implemented."""

from __future__ import annotations

import ast
import contextlib
import functools
import io
import os
import re
import textwrap
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import tyro

from holdfast.cli.streams import EXIT_BAD_INPUT, complain
from holdfast.errors import SceneError
from holdfast.model import checks

# the module of each command; only that of the called one is imported, since some take a while
COMMANDS = {
    "solve": "solve",
    "diagnose": "diagnose",
    "calibrate": "calibrate",
    "identify": "identify",
    "simulate": "simulate",
    "sweep": "sweep",
    "summary": "results",
    "plot": "results",
    "view": "view",
    "export": "results",
    "export-c": "export_c",
    "methods": "solve",
    "doctor": "doctor",
}
LONGEST_REFUSAL = 1000  # characters of the parser's, which repeats arguments in full
REPEATABLE = (
    "--set",
    "--function",
    "--of",
    "--by",
    "--seek",
    "--unknowns",
    "--prior",
)  # options that may be given more than once
MOVED_COMMANDS = {"bench": "try `python -m benchmarks.bench` in a clone of the repository"}


def run(arguments: list[str]) -> int:
    """Parse the arguments, run the command, and return its exit code.

    Raises:
        HoldfastError: the command or its input is invalid.
    """
    if arguments == ["--version"]:
        import holdfast

        print(holdfast.__version__)
        return 0
    for argument in arguments:
        if not argument or "\0" in argument or (argument.startswith("--") and argument.endswith("=")):
            raise SceneError(f"expected a name that is not empty and contains no NUL, got {argument[:60]!r}")
        try:
            os.fsencode(argument)
        except UnicodeEncodeError as cause:
            raise SceneError(f"expected a name that files can have, got {argument[:60]!r}") from cause
    first = arguments[0] if arguments else "--help"
    if not first.startswith("-") and first not in COMMANDS:
        advice = f"; {MOVED_COMMANDS[first]}" if first in MOVED_COMMANDS else f".{checks.did_you_mean(first, COMMANDS)}"
        raise SceneError(f"no command {first!r}{advice}")
    _refuse_repeated(arguments)
    offered = _only_described if first in ("-h", "--help") else _later
    commands = {name: offered(name) for name in ([first] if first in COMMANDS else COMMANDS)}
    call = _parsed(arguments or ["--help"], commands)
    return call if isinstance(call, int) else call()


def _refuse_repeated(arguments: list[str]) -> None:
    """Refuse an option that is given twice, including contradictory ones such as `--plots` and `--no-plots`.

    Raises:
        SceneError: an option is repeated; the message names it and its values.
    """
    given: dict[str, list[str]] = {}
    for k, argument in enumerate(arguments):
        if argument == "--":
            break
        if not argument.startswith("--") or argument.partition("=")[0] in REPEATABLE:
            continue
        name, equals, value = argument.partition("=")
        after = arguments[k + 1] if not equals and k + 1 < len(arguments) else ""
        shown = f"{name} {value or ('' if after.startswith('--') else after)}".strip()
        given.setdefault(name[2:].removeprefix("no-").replace("_", "-"), []).append(shown)
    for name, times in given.items():
        if len(times) > 1:
            raise SceneError(f"--{name}: expected once, got {' and '.join(times)}; try one of them, or two commands")


def _parsed(arguments: list[str], commands: dict[str, Callable[..., Any]]) -> Callable[[], int] | int:
    """Return the call of one of the commands for the arguments, or an exit code if there is nothing to call."""
    boxed = io.StringIO()
    try:
        with contextlib.redirect_stderr(boxed):
            return tyro.extras.subcommand_cli_from_dict(
                commands,
                prog="holdfast",
                description="Exact dynamics for several robot arms that jointly grasp one object.",
                args=arguments,
            )
    except SystemExit as finished:
        if not finished.code:
            return 0
        complain(_unboxed(boxed.getvalue()))
        return EXIT_BAD_INPUT


def _unboxed(message: str) -> str:
    """Return tyro's message without its title (the first line), its frame and its horizontal lines."""
    _, _, text = message.strip().partition("\n")
    return textwrap.shorten(re.sub(r"[─│╭╮╰╯]+|-{4,}", " ", text or message), LONGEST_REFUSAL, placeholder=" ...")


def _later(name: str) -> Callable[..., Callable[[], int]]:
    """Return a function of a command's signature that only prepares the call."""
    command = getattr(import_module(f"holdfast.cli.{COMMANDS[name]}"), _function(name))

    @functools.wraps(command)
    def prepared(*arguments: object, **options: object) -> Callable[[], int]:
        return functools.partial(command, *arguments, **options)

    return prepared


def _only_described(name: str) -> Callable[..., Any]:
    """Return a function with a command's docstring, for the list of all commands, without importing its module."""
    try:
        found = _docstrings(COMMANDS[name])
    except OSError:  # installed without sources
        return _later(name)

    def described() -> None: ...

    described.__doc__ = found[_function(name)]
    return described


@functools.cache
def _docstrings(module: str) -> dict[str, str | None]:
    """Return the docstrings of a module's functions, by name."""
    text = Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8")
    return {node.name: ast.get_docstring(node) for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}


def _function(name: str) -> str:
    return name.replace("-", "_")
