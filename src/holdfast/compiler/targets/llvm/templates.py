"""Templates of modules: files in LLVM's language in which Python replaces every `$name`."""

from __future__ import annotations

from pathlib import Path
from string import Template


def filled(name: str, **values: object) -> str:
    """Return the template `name.ll` of this folder with every `$name` replaced; a list is a value of several lines."""
    texts = {key: "\n".join(value) if isinstance(value, list) else value for key, value in values.items()}
    return Template(Path(__file__).with_name(f"{name}.ll").read_text()).substitute(texts)
