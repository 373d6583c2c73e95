"""The commands of the command line; each has its options and its help where it is implemented."""

from __future__ import annotations

import contextlib
import functools
import io
import re
from collections.abc import Callable
from importlib import import_module

import tyro

from holdfast.cli import BAD_INPUT, complain
from holdfast.errors import SceneError
from holdfast.model import checks

# the module of each command; only that of the called one is imported, since some take a while
COMMANDS = {
    "solve": "solve",
    "diagnose": "diagnose",
    "simulate": "simulate",
    "sweep": "sweep",
    "summary": "results",
    "plot": "results",
    "view": "view",
    "export": "results",
    "export-c": "export_c",
    "bench": "bench",
    "methods": "methods",
    "doctor": "doctor",
}


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
            raise SceneError(f"expected a name that is not empty and contains no NUL, got {argument!r}")
    first = arguments[0] if arguments else "--help"
    if not first.startswith("-") and first not in COMMANDS:
        raise SceneError(f"no command {first!r}.{checks.did_you_mean(first, COMMANDS)}")
    _refuse_repeated(arguments)
    call = _parsed(arguments or ["--help"], [first] if first in COMMANDS else [*COMMANDS])
    return call if isinstance(call, int) else call()


_REPEATABLE = ("--set", "--function", "--of", "--by")


def _refuse_repeated(arguments: list[str]) -> None:
    """Refuse an option that is given twice, including contradictory ones such as `--plots` and `--no-plots`.

    Raises:
        SceneError: an option is repeated; the message names it and its values.
    """
    given: dict[str, list[str]] = {}
    for k, argument in enumerate(arguments):
        if argument == "--":
            break
        if not argument.startswith("--") or argument.partition("=")[0] in _REPEATABLE:
            continue
        name, equals, value = argument.partition("=")
        after = arguments[k + 1] if not equals and k + 1 < len(arguments) else ""
        shown = f"{name} {value or ('' if after.startswith('--') else after)}".strip()
        given.setdefault(name[2:].removeprefix("no-").replace("_", "-"), []).append(shown)
    for name, times in given.items():
        if len(times) > 1:
            raise SceneError(f"--{name}: expected once, got {' and '.join(times)}; try one of them, or two commands")


def _parsed(arguments: list[str], commands: list[str]) -> Callable[[], int] | int:
    """Return the call of one of the commands for the arguments, or an exit code if there is nothing to call."""
    boxed = io.StringIO()
    try:
        with contextlib.redirect_stderr(boxed):
            return tyro.extras.subcommand_cli_from_dict(
                {name: _later(name) for name in commands},
                prog="holdfast",
                description="Exact dynamics for several robot arms that jointly grasp one object.",
                args=arguments,
            )
    except SystemExit as finished:
        if not finished.code:
            return 0
        complain(_unboxed(boxed.getvalue()))
        return BAD_INPUT


def _unboxed(message: str) -> str:
    """Return tyro's message without its title (the first line), its frame and its horizontal lines."""
    _, _, text = message.strip().partition("\n")
    return re.sub(r"[─│╭╮╰╯]+|-{4,}", " ", text or message)


def _later(name: str) -> Callable[..., Callable[[], int]]:
    """Return a function of a command's signature that only prepares the call."""
    command = getattr(import_module(f"holdfast.cli.{COMMANDS[name]}"), name.replace("-", "_"))

    @functools.wraps(command)
    def prepared(*arguments: object, **options: object) -> Callable[[], int]:
        return functools.partial(command, *arguments, **options)

    return prepared
