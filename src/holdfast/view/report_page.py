"""Self-contained HTML pages of figures, tables and sentences, which need no network and no program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

from holdfast.io.files import file_path, write_atomically
from holdfast.view.embedded import escaped
from holdfast.view.inline import image

PAGE_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;color:#222;background:#fff;"
    "max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "h1{font-size:1.5rem;margin:0 0 .3rem}h2{font-size:1.1rem;margin:2rem 0 .5rem;border-bottom:1px solid #ddd}"
    "img{max-width:100%;display:block;margin:.5rem 0}table{border-collapse:collapse;margin:.5rem 0}"
    "td,th{padding:.15rem .8rem .15rem 0;text-align:right;font-variant-numeric:tabular-nums}"
    "th{border-bottom:1px solid #999;font-weight:600}td:first-child,th:first-child{text-align:left}"
    "tr:nth-child(even) td{background:#f6f7f8}ul{padding-left:1.2rem}.good{color:#00664b}.bad{color:#a63d00}"
)


@dataclass(frozen=True)
class Section:
    """A part of a page.

    Attributes:
        title: its heading.
        text: sentences; several become a list.
        head: titles of the columns of its table.
        rows: the table's cells.
        figures: matplotlib figures by name.
    """

    title: str
    text: Sequence[str] = ()
    head: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    figures: dict[str, Any] = field(default_factory=dict)


def report_page(title: str, verdict: str, good: bool, sections: Sequence[Section]) -> str:
    """Return the text of a page; sections without content are left out.

    Args:
        title: title of the page.
        verdict: one sentence below it.
        good: whether it is good news.
        sections: the parts of the page.
    """
    parts = [_section(one) for one in sections if one.text or one.rows or one.figures]
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escaped(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{PAGE_STYLE}</style></head><body>'
        f'<h1>{escaped(title)}</h1><p class="{"good" if good else "bad"}"><b>{escaped(verdict)}</b></p>'
        f"{''.join(parts)}</body></html>\n"
    )


def write_page(text: str, path: str | PathLike[str]) -> None:
    """Write a page, completely or not at all.

    Raises:
        ResultError: the file cannot be written.
    """
    write_atomically(file_path(path, "path"), text.encode("utf-8", "replace"))


def _section(one: Section) -> str:
    """Return a section in HTML."""
    text = f"<h2>{escaped(one.title)}</h2>"
    if len(one.text) == 1:
        text += f"<p>{escaped(one.text[0])}</p>"
    elif one.text:
        text += f"<ul>{''.join(f'<li>{escaped(line)}</li>' for line in one.text)}</ul>"
    text += "".join(image(figure, name) for name, figure in one.figures.items())
    if one.rows:
        head = "".join(f"<th>{escaped(cell)}</th>" for cell in one.head)
        body = "".join(f"<tr>{''.join(f'<td>{escaped(cell)}</td>' for cell in row)}</tr>" for row in one.rows)
        text += f"<table><tr>{head}</tr>{body}</table>"
    return text
