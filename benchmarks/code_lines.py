"""Counts lines of code folder by folder, and measures the shape of the library: imports, circles, public names.

python benchmarks/code_lines.py [--json] [--root FOLDER] [src benchmarks/bench tests ...]

A line of code is one that is not blank, no comment and no docstring. The benchmark counts as a part of the library,
wherever it lies. `--root` is another copy of the repository, such as an earlier commit's.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import subprocess
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
CORE = {"spatial", "model", "state", "questions", "dynamics", "forces", "compiler", "compiled", "control", "simulation"}
CORE |= {"assembly", "errors", "names", "outer", "progress"}
BENCH = "benchmarks/bench"  # was src/holdfast/bench
METHODS = "from holdfast.compiled import CompiledChain; print(sum(name[0] != '_' for name in dir(CompiledChain)))"


def code_lines(text: str) -> int:
    """Return how many lines of a Python file hold code."""
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in LAYOUT:
            found |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            found -= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(found)


def folders(root: Path, part: str) -> dict[str, list[int]]:
    """Return lines of code, all lines and files of each folder of a part of the repository."""
    counts: dict[str, Any] = defaultdict(lambda: np.zeros(3, dtype=int))
    for path in sorted((root / part).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        counts[path.parent.relative_to(root).as_posix()] += [code_lines(text), text.count("\n"), 1]
    return {folder: [int(n) for n in found] for folder, found in counts.items()}


def imports(tree: ast.Module) -> Iterator[tuple[int, set[str], bool]]:
    """Yield of each import: its lines, the dotted names that it may load, and whether it is for type checkers only."""
    for_types = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")
        for part in node.body
        for inner in ast.walk(part)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name for alias in node.names}
            if isinstance(node, ast.ImportFrom):
                names = {str(node.module), *(f"{node.module}.{name}" for name in names)}
            yield (node.end_lineno or node.lineno) - node.lineno + 1, names, node in for_types


def house(root: Path) -> dict[str, float]:
    """Return the measures of the library's shape.

    Imports inside functions count like others; those for type checkers count as lines only. A circle is a set of
    modules that import each other, directly or not. The core's rooms are those of `CORE`; outward is an import of any
    other room.
    """
    package = root / "src" / "holdfast"
    modules = {}
    for path in sorted(package.rglob("*.py")):
        dotted = ".".join(path.relative_to(root / "src").with_suffix("").parts).removesuffix(".__init__")
        modules[dotted] = ast.parse(path.read_text(encoding="utf-8"))
    number = {name: k for k, name in enumerate(modules)}
    lines, edges = 0, set()
    for name, tree in modules.items():
        for length, targets, for_types in imports(tree):
            lines += length
            edges |= set() if for_types else {(name, target) for target in targets & modules.keys() - {name}}
    rows, columns = ([number[edge[end]] for edge in edges] for end in (0, 1))
    graph = csr_array((np.ones(len(edges)), (rows, columns)), shape=(len(modules),) * 2)
    _, circle = connected_components(graph, connection="strong")
    largest = int(np.bincount(circle).max())
    room = {name: (*name.split("."), "", "")[1] for name in modules}
    outward = {(a, b) for a, b in edges if room[a] in CORE and room[b] not in {*CORE, ""}}
    stubs = [ast.parse(path.read_text(encoding="utf-8")) for path in package.rglob("__init__.pyi")]
    named = [a for stub in stubs for node in stub.body if isinstance(node, ast.ImportFrom) for a in node.names]
    of_src = sum(found[0] for found in folders(root, "src").values())
    environment = os.environ | {"PYTHONPATH": str(root / "src")}
    methods = subprocess.run(
        [sys.executable, "-c", METHODS], env=environment, capture_output=True, text=True, check=True
    )
    return {
        "code lines of src, bench included": of_src + sum(found[0] for found in folders(root, BENCH).values()),
        "code lines of tests": sum(found[0] for found in folders(root, "tests").values()),
        "lines of imports in src": lines,
        "imports, per cent of src's code lines": round(100 * lines / of_src, 1),
        "public names": len(named),
        "public methods of CompiledChain": int(methods.stdout),
        "modules in the largest circle of imports": largest if largest > 1 else 0,
        "imports of the core outward": len(outward),
    }


def main() -> None:
    """Print the tables, or one JSON document."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("parts", nargs="*", default=["src", BENCH, "tests"], help="folders to count")
    parser.add_argument("--root", type=Path, default=Path(__file__).parents[1], help="the repository's root")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of tables")
    chosen = parser.parse_args()
    root = chosen.root.resolve()
    counts = {part: folders(root, part) for part in chosen.parts}
    if chosen.json:
        print(json.dumps({"folders": counts, "house": house(root)}, indent=1))
        return
    for part, found in counts.items():
        in_all = [sum(column) for column in zip(*found.values(), strict=True)]
        for folder, (code, lines, files) in [*found.items(), *([(f"{part} in all", in_all)] if found else [])]:
            print(f"{folder:44}{code:8,} code{lines:8,} lines{files:6} files")
    for what, value in house(root).items():
        print(f"{what:44}{value:8,}")


if __name__ == "__main__":
    main()
