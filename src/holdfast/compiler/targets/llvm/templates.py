"""The parts of modules that are files of LLVM's language; `$name` in them stands for what Python fills in."""

from __future__ import annotations

import functools
from pathlib import Path
from string import Template


def filled(name: str, **values: object) -> str:
    """Return a template, `name.ll` beside this file, with its `$names` filled in; lists of lines are joined."""
    texts = {key: "\n".join(value) if isinstance(value, list) else value for key, value in values.items()}
    return _template(name).substitute(texts)


@functools.cache
def _template(name: str) -> Template:
    return Template(Path(__file__).with_name(f"{name}.ll").read_text())
