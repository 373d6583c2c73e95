"""Docstrings are plain text with equations in them: make reStructuredText of them that says the same."""

import re
from collections.abc import Iterator
from typing import Any

SECTION = re.compile(r"(Args|Attributes|Raises|Reference|References|Returns|Yields|Example|Note):$")
CODE = re.compile(r"`([^`]+)`")
# characters that markup would take: backslash, bars, stars that begin no list, underscores that end a word
MARKUP = re.compile(r"\\|\||(?<!^)\*|\*(?! )|(?<=\w)_(?!\w)", re.MULTILINE)


def setup(app: Any) -> dict[str, Any]:
    """Put the translation before napoleon's, which makes fields of the sections."""
    app.connect("autodoc-process-docstring", translate, priority=400)
    app.connect("autodoc-skip-member", is_tuple_field)
    return {"parallel_read_safe": True}


def translate(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Translate a docstring in place."""
    lines[:] = "\n".join(translated(part) for part in parts(lines)).split("\n")


def parts(lines: list[str]) -> Iterator[tuple[str, bool]]:
    """Yield stretches of lines and whether each is displayed as it stands: indented, and in no section."""
    text: list[str] = []
    shown, in_section = False, False
    for line in lines:
        indented = line.startswith("    ")
        if line and not indented:
            in_section = SECTION.match(line) is not None
        now = indented and not in_section if line else shown
        if now != shown and text:
            yield "\n".join(text), shown
            text = []
        shown = now
        text.append(line)
    yield "\n".join(text), shown


def translated(part: tuple[str, bool]) -> str:
    """Return one stretch as reStructuredText."""
    text, shown = part
    if shown:
        return f"::\n\n{text}\n"
    pieces = CODE.split(text)  # text, code, text, ...
    return "".join(f"``{x}``" if i % 2 else MARKUP.sub(r"\\\g<0>", x) for i, x in enumerate(pieces))


def is_tuple_field(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leave out the fields of named tuples: the class's own text tells what they are."""
    return True if (getattr(obj, "__doc__", None) or "").startswith("Alias for field number") else None
