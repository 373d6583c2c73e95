"""Counts lines of code, without blank lines, comments and docstrings, and all lines, folder by folder.

python benchmarks/code_lines.py src tests
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import defaultdict
from pathlib import Path

import numpy as np

LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def code_lines(text: str) -> int:
    """Return how many lines of a Python file hold code."""
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in LAYOUT:
            found |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            found -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(found)


def main(roots: list[str]) -> None:
    """Print a table of folders: lines of code, all lines, files."""
    for root in roots:
        folders: dict[Path, np.ndarray] = defaultdict(lambda: np.zeros(3, dtype=int))
        for path in sorted(Path(root).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            folders[path.parent] += [code_lines(text), text.count("\n"), 1]
        for folder, counts in [*folders.items(), (f"{root} in all", sum(folders.values()))]:
            print(f"{folder!s:44}{counts[0]:8,} code{counts[1]:8,} lines{counts[2]:6} files")


if __name__ == "__main__":
    main(sys.argv[1:] or ["src", "tests"])
