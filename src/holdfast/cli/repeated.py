"""Options that are given twice: only one of them could be obeyed."""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.errors import SceneError


def refuse_repeated(arguments: Sequence[str]) -> None:
    """Refuse an option that is given twice, `--plots` with `--no-plots` among them.

    Raises:
        SceneError: naming the option and what it is given.
    """
    given: dict[str, list[str]] = {}
    for k, argument in enumerate(arguments):
        if argument == "--":
            break
        if not argument.startswith("--"):
            continue
        name, equals, value = argument.partition("=")
        after = arguments[k + 1] if not equals and k + 1 < len(arguments) else ""
        shown = f"{name} {value or ('' if after.startswith('--') else after)}".strip()
        given.setdefault(name[2:].removeprefix("no-").replace("_", "-"), []).append(shown)
    for name, times in given.items():
        if len(times) > 1:
            raise SceneError(f"--{name}: expected once, got {' and '.join(times)}; try one of them, or two commands")
