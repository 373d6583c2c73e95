"""Names of grasp kinds and joint types are compared nowhere: what depends on them stands in their tables."""

import ast
from pathlib import Path

import pytest

import holdfast
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.model.joint_types import JOINT_TYPES

ROOT = Path(holdfast.__file__).parent
TABLES = ("grasp_kinds", "joint_types")
NAMES = {*GRASP_KINDS, *JOINT_TYPES}
# MuJoCo's joints, shapes and motions, which share a name with a grasp
SHAPES = {"robots/primitive.py", "model/visuals.py", "robots/urdf/visuals.py", "view/link_meshes.py"}
OTHERS = {"interop/mjcf_tree.py", "dynamics/near_singular.py"} | SHAPES


def named(node: ast.AST) -> bool:
    """Whether an expression holds the name of a kind."""
    return any(isinstance(part, ast.Constant) and part.value in NAMES for part in ast.walk(node))


def distinctions(tree: ast.AST) -> list[int]:
    """Return the lines that compare a name, or look something up by it."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare | ast.MatchValue) and named(node):
            found.append(node.lineno)
        if isinstance(node, ast.Dict):
            found += [key.lineno for key in node.keys if isinstance(key, ast.Constant) and key.value in NAMES]
    return found


def test_no_comparison():
    """No file but the tables tells kinds apart."""
    files = {path.relative_to(ROOT).as_posix(): path for path in sorted(ROOT.rglob("*.py"))}
    others = {name: path for name, path in files.items() if path.stem not in TABLES and name not in OTHERS}
    found = {name: distinctions(ast.parse(path.read_text(encoding="utf-8"))) for name, path in others.items()}
    assert {name: lines for name, lines in found.items() if lines} == {}


@pytest.mark.parametrize("text", ["x == 'rigid'", "kind in ('ball', None)", "{'hinge': 1}[kind]"])
def test_comparisons_are_seen(text):
    """The search finds what it looks for."""
    assert distinctions(ast.parse(text)) == [1]
