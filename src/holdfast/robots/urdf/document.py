"""XML elements with line numbers, read by expat in bounded time and memory and without entities."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from xml.parsers import expat

from holdfast.errors import HoldfastError, SceneError

# The largest file among 400 real robots has 0.2 MB, 4,000 elements and 12 levels.
LARGEST_URDF = 32 * 2**20  # [bytes]
MOST_ELEMENTS = 100_000
DEEPEST_XML = 100
LONGEST_TEXT = 1000  # [characters] that are kept of the text in an element


@dataclass(frozen=True, eq=False)
class Element:
    """An XML element.

    Attributes:
        tag: its name, including a prefix.
        attributes: texts of the attributes by name.
        source: name of the file.
        line: line in which it begins.
        parent: the enclosing element; None for the root.
        children: the elements in it, in order.
        stray: the first text between them, up to 1,000 characters; empty if there is none.
    """

    tag: str
    attributes: dict[str, str]
    source: str
    line: int
    parent: Element | None = field(repr=False)
    children: list[Element] = field(default_factory=list, repr=False)
    stray: list[str] = field(default_factory=list)

    @property
    def label(self) -> str:
        """Position in the document, such as `link 'hand', inertial, mass`."""
        name = self.attributes.get("name")
        own = self.tag if name is None else f"{self.tag} {quoted(name)}"
        inside = self.parent is not None and self.parent.parent is not None
        return f"{self.parent.label}, {own}" if inside and self.parent else own

    def first(self, tag: str) -> Element | None:
        """Return the first child with this name; None if there is none."""
        return next((child for child in self.children if child.tag == tag), None)

    def required(self, tag: str) -> Element:
        """Return the first child with this name, which must exist."""
        if (child := self.first(tag)) is None:
            raise self.refuse(f"expected <{tag}>, got none")
        return child

    def message(self, problem: str) -> str:
        """Return the message `file:line: element: problem` on one line."""
        return f"{self.source}:{self.line}: " + " ".join(f"{shortened(self.label, 200)}: {problem}".split())

    def refuse(self, problem: str) -> SceneError:
        """Return an error that gives file, line and element."""
        return SceneError(self.message(problem))

    @contextmanager
    def refusals(self) -> Iterator[None]:
        """Convert errors of the model, such as `link 'hand': inertia: ...`, to errors that give the line."""
        try:
            yield
        except SceneError:
            raise
        except HoldfastError as cause:
            refusal = str(cause).replace(" (Link, HeldObject)", "")
            _, separator, problem = refusal.partition("': ")
            raise self.refuse(problem if separator else refusal) from cause


def shortened(text: str, length: int = 60) -> str:
    """Return a text shortened to at most `length` characters, with dots at the end."""
    return text if len(text) <= length else text[: length - 3] + "..."


def quoted(text: str) -> str:
    """Return a text from a file for messages: printable, short and in quotes."""
    return repr(shortened(text))


def hint(name: str, known: Iterable[str]) -> str:
    """Return ' Did you mean ...?' with the closest known name, or a shortened list of known names."""
    known = list(known)
    near = difflib.get_close_matches(name[:256], known, n=1, cutoff=0.6) if len(known) <= 2000 else []
    return f" Did you mean '{near[0]}'?" if near else f" Known: {listed(known)}."


def listed(names: Iterable[str], most: int = 12) -> str:
    """Return names with quotes and commas, at most `most` of them."""
    names = list(names)
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(quoted(name) for name in names[:most]) + rest if names else "none"


def parse_document(text: bytes | str, source: str) -> Element:
    """Return the root element of an XML document. O(length).

    Args:
        text: the document; bytes in the encoding that it declares, or UTF-8.
        source: name of the file, for messages.

    Raises:
        SceneError: the document is not well-formed, has an unknown encoding or a DOCTYPE (which can define unbounded
            entities), or has more than 32 MiB, 100,000 elements or 100 levels.
    """
    if len(text) > LARGEST_URDF:
        raise SceneError(f"{source}:1: robot: expected at most {LARGEST_URDF >> 20} MiB, got {len(text) >> 20} MiB")
    if not text.strip():
        raise SceneError(f"{source}:1: robot: expected XML, got nothing")
    builder = _Builder(source)
    try:
        builder.parser.Parse(text, True)
    except expat.ExpatError as fault:
        where = builder.open[-1].label if builder.open else "document"
        reason = expat.errors.messages.get(fault.code, str(fault))
        raise SceneError(
            f"{source}:{fault.lineno}: {shortened(where, 200)}: not well-formed XML: {reason}"
            f" (column {fault.offset + 1}){_ADVICE.get(reason, '')}"
        ) from fault
    except (ValueError, LookupError) as fault:  # unknown encodings, or multi-byte encodings
        raise SceneError(f"{source}:1: document: cannot be decoded: {fault}; try saving it as UTF-8") from fault
    return builder.root[0]


_ADVICE = {
    "XML or text declaration not at start of entity": "; try deleting the text before <?xml ...?>",
    "undefined entity": "; try writing the character itself",
}


class _Builder:
    """The callbacks of one parser, and the elements made so far."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.root: list[Element] = []
        self.open: list[Element] = []
        self.count = 0
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text
        self.parser.StartDoctypeDeclHandler = self._doctype

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        parent = self.open[-1] if self.open else None
        element = Element(tag, attributes, self.source, self.parser.CurrentLineNumber, parent)
        (parent.children if parent else self.root).append(element)
        self.open.append(element)
        self.count += 1
        if self.count > MOST_ELEMENTS:
            raise element.refuse(f"expected at most {MOST_ELEMENTS:,} elements, got more")
        if len(self.open) > DEEPEST_XML:
            raise element.refuse(f"expected at most {DEEPEST_XML} levels of elements, got more")

    def _end(self, tag: str) -> None:
        self.open.pop()

    def _text(self, text: str) -> None:
        if self.open and not self.open[-1].stray and (stray := text.strip()):
            self.open[-1].stray.append(shortened(stray, LONGEST_TEXT))

    def _doctype(self, name: str, *_: object) -> None:
        line = self.parser.CurrentLineNumber
        raise SceneError(
            f"{self.source}:{line}: DOCTYPE {quoted(name)}: expected none, since it can define entities that grow"
            " without bound; try deleting it"
        )
