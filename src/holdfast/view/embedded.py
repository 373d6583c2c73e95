"""Data and text for HTML pages, encoded so that no name in them ends an element or hides what follows."""

from __future__ import annotations

import html
import json
from typing import Any


def data_element(name: str, value: Any) -> str:
    """Return a script element with data as JSON, which `JSON.parse` of its text content returns.

    Without "<" there is neither an end tag nor a comment, within which `<script>` would hide the end tag.

    Args:
        name: id of the element.
        value: dicts, lists, texts, finite numbers, truth values and None.

    Raises:
        ValueError: a number is not finite.
    """
    data = json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{data}</script>'


def escaped(text: str) -> str:
    """Return a text as HTML, for the content of elements and for attributes; lone surrogates become question marks."""
    return html.escape(text.encode("utf-8", "replace").decode("utf-8"), quote=True)
