"""Docstrings are plain text with equations in them: make reStructuredText of them that says the same."""

import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from textwrap import dedent, indent
from typing import Any

from sphinx.domains.python import PyObject
from sphinx.util.inspect import TypeAliasForwardRef

SECTION = re.compile(r"(Args|Attributes|Raises|Reference|References|Returns|Yields|Example|Note):$")
SEVERAL = re.compile(r"^    (\w+(?:, \w+)+): (.*\n(?:        .*\n)*)", re.MULTILINE)  # attributes described together
CODE = re.compile(r"`([^`]+)`")
# characters that markup would take: backslash, bars, stars that begin no list, underscores that end a word
MARKUP = re.compile(r"\\|\||(?<!^)\*|\*(?! )|(?<=\w)_(?!\w)", re.MULTILINE)


def setup(app: Any) -> dict[str, Any]:
    """Put the translation before napoleon's, which makes fields of the sections."""
    app.connect("autodoc-process-docstring", translate, priority=400)
    app.connect("autodoc-process-signature", plain_signature)
    app.connect("autodoc-skip-member", is_tuple_field)
    TypeAliasForwardRef.__repr__ = lambda alias: alias.name  # `Array`, wherever it stands
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.label = "Attributes"  # as the docstrings call them
    return {"parallel_read_safe": True}


def translate(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Translate a docstring in place."""
    if what == "class":
        lines[:] = one_attribute_each(lines)
    lines[:] = "\n".join(translated(*part) for part in parts(lines)).split("\n")
    if what == "property":
        lines[:0] = ["..", ""]  # for napoleon, what stands before a colon in the first line would be the type


def one_attribute_each(lines: list[str]) -> list[str]:
    """Return the lines with an entry for every attribute where one describes several."""

    def entries(found: re.Match[str]) -> str:
        return "".join(f"    {name}: {found[2]}" for name in found[1].split(", "))

    return SEVERAL.sub(entries, "\n".join(lines) + "\n").split("\n")


def parts(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Yield stretches of lines and what each is: "table", "code" (indented and in no section), or "text"."""
    text: list[str] = []
    kind, in_section = "text", False
    for line in lines:
        indented = line.startswith("    ")
        if line and not indented:
            in_section = SECTION.match(line) is not None
        now = kind
        if line:
            now = "table" if line.startswith("|") else "code" if indented and not in_section else "text"
        if now != kind and text:
            yield "\n".join(text), kind
            text = []
        kind = now
        text.append(line)
    yield "\n".join(text), kind


def translated(text: str, kind: str) -> str:
    """Return one stretch as reStructuredText."""
    if kind == "table":
        return table(text)
    if kind == "code":
        return f"::\n\n{indent(dedent(text), '    ')}\n"
    pieces = CODE.split(text)  # text, code, text, ...
    return "".join(f"``{x}``" if i % 2 else MARKUP.sub(r"\\\g<0>", x) for i, x in enumerate(pieces))


def table(text: str) -> str:
    """Return a table; a row whose first cell is empty goes on with the row above it."""
    rows: list[list[str]] = []
    header = False
    for line in text.split("\n"):
        cells = [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")]
        if line.startswith("|--"):
            header = True
        elif cells[0]:
            rows.append(cells)
        elif line:
            rows[-1] = [f"{above} {cell}".strip() for above, cell in zip(rows[-1], cells, strict=True)]
    written = ["   * - " + "\n     - ".join(translated(cell, "text") for cell in row) for row in rows]
    return "\n".join([".. list-table::", "   :header-rows: 1" if header else "", "", *written, ""])


def plain_signature(app: Any, what: str, name: str, obj: Any, options: Any, given: str | None, returned: Any) -> Any:
    """Return a data class's signature without types, which its text tells with shapes and units; of a result none."""
    if what != "class" or not is_dataclass(obj) or "__init__" not in vars(obj):
        return None
    parameters = [field_default(field) for field in fields(obj)]
    returned_only = len(parameters) > 4 and not any("=" in parameter for parameter in parameters)
    return ("" if returned_only else f"({', '.join(parameters)})"), None


def field_default(field: Field[Any]) -> str:
    """Return a field as a parameter: `name`, `name=default`, or `name=...` where the default is made anew."""
    if field.default is not MISSING:
        return f"{field.name}={field.default!r}"
    return field.name if field.default_factory is MISSING else f"{field.name}=..."


def is_tuple_field(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leave out the fields of named tuples: the class's own text tells what they are."""
    return True if (getattr(obj, "__doc__", None) or "").startswith("Alias for field number") else None
