"""The rooms of the house: who may import whom, how large files get, what is documented, what loads."""

import ast
import functools
import inspect
import statistics
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import holdfast
from tests.surface import PUBLIC, names_of

ROOT = Path(holdfast.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
ROOMS = {path.relative_to(ROOT).parts[0].removesuffix(".py") for path in FILES}

# Dependency only leftward: each room and the rooms it may look into. `errors` is open to all.
MATHEMATICS = {"spatial"}
MODEL = MATHEMATICS | {"model"}
DYNAMICS = MODEL | {"state", "dynamics", "compiler", "compiled", "progress"}
USE = DYNAMICS | {"forces", "simulation", "control"}
FILES_AND_SCENES = USE | {"robots", "assembly", "interop", "scenario", "io"}
MAY_IMPORT = {
    "errors": set(),
    "progress": set(),
    "spatial": set(),
    "model": MATHEMATICS,
    "state": MODEL,
    "dynamics": MODEL | {"state"},
    "compiler": set(),  # knows nothing of robots
    "compiled": DYNAMICS - {"compiled"} | {"forces"},
    "forces": MODEL | {"state", "dynamics"},
    "control": DYNAMICS | {"forces"},
    "simulation": DYNAMICS | {"forces", "control"},
    "robots": MODEL,
    "assembly": DYNAMICS | {"robots"},
    "interop": USE | {"robots", "io"},
    "scenario": FILES_AND_SCENES - {"scenario"},
    "io": USE | {"robots"},
    "identification": DYNAMICS | {"simulation", "io"},
    "gym": USE | {"robots", "assembly"},
    "sweeps": USE | {"io", "scenario"},
    "codegen": USE | {"io"},
    "view": FILES_AND_SCENES,
    "plot": {"view"},
    "bench": FILES_AND_SCENES | {"holdfast"},  # calls the library as its users do
    "cli": FILES_AND_SCENES | {"bench", "codegen", "sweeps", "view", "holdfast"},
}
# constructors that read files, and methods that write or draw, ask the room that does so, when called
ON_CALL = {
    "compiled/chain.py": {"codegen"},
    "model/closed_chain.py": {"view"},
    "model/held_object.py": {"robots"},
    "simulation/run_outputs.py": {"io", "view", "interop"},
    "simulation/summary.py": {"view"},
    "simulation/rollout/record.py": {"io"},
    "simulation/rollout/recording.py": {"io"},
    "simulation/simulate.py": {"io"},
    "io/result_reader.py": {"scenario"},
    "sweeps/result.py": {"view"},
}
HEAVY = {"scipy", "llvmlite", "tyro", "rich", "matplotlib", "pinocchio", "mujoco", "viser", "mpmath"}
HEAVY |= {"pandas", "pyarrow", "xarray", "IPython", "jax", "gymnasium"}


@functools.cache
def parsed(path: Path) -> ast.Module:
    """Return a source file's syntax tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


def room(path: Path) -> str:
    """Return the room a source file is in."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported_rooms(path: Path) -> set[str]:
    """Return the rooms that a file imports, inside functions too; `holdfast` is the package itself."""
    names = []
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert all(alias.name != "*" for alias in node.names), f"{path}: star import"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    ours = [name.split(".") for name in names if name.split(".")[0] == "holdfast" and name != "holdfast.__version__"]
    return {parts[1] if len(parts) > 1 and parts[1] in ROOMS else "holdfast" for parts in ours}


def test_imports_go_left():
    """No room imports one to its right; only the top and the command line know the whole package."""
    wrong = {}
    for path in FILES:
        here, name = room(path), path.relative_to(ROOT).as_posix()
        if here not in ("__init__", "__main__"):
            assert here in MAY_IMPORT, f"a new room: say in MAY_IMPORT where {here} belongs"
            wrong[name] = imported_rooms(path) - MAY_IMPORT[here] - ON_CALL.get(name, set()) - {here, "errors"}
    assert {name: rooms for name, rooms in wrong.items() if rooms} == {}


def test_rooms_are_not_circular():
    """Ordering the rooms by what they may import leaves none that wait for each other."""
    waiting = {name: set(rooms) - {"holdfast"} for name, rooms in MAY_IMPORT.items()}
    while waiting:
        ready = {name for name, rooms in waiting.items() if not rooms & waiting.keys()}
        assert ready, waiting
        waiting = {name: rooms for name, rooms in waiting.items() if name not in ready}


def test_file_sizes():
    """One algorithm a file, one screen an algorithm: none over 400 lines, median at most 120."""
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in FILES}
    assert max(lines.values()) <= 400, max(lines, key=lines.__getitem__)
    assert statistics.median(lines.values()) <= 120


def test_names_of_rooms():
    """No catch-all: what a file is for stands in its name."""
    vague = {"utils", "util", "core", "helpers", "misc", "common", "manager"}
    assert not {path.stem for path in FILES} & vague
    assert not {path.parent.name for path in FILES} & vague


def public_definitions(tree: ast.Module):
    """Yield qualified name and node of every public function, class and method of a file."""

    def visit(node, prefix):
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                continue
            if child.name.startswith("_"):
                continue
            yield prefix + child.name, child
            if isinstance(child, ast.ClassDef):
                yield from visit(child, prefix + child.name + ".")

    yield from visit(tree, "")


def test_docstrings():
    """Every file, public function, class and method begins with a sentence."""
    lacking = []
    for path in FILES:
        tree = parsed(path)
        for name, node in {"file": tree, **dict(public_definitions(tree))}.items():
            first = (ast.get_docstring(node) or "").split("\n")[0].strip()
            if not first or (name != "file" and not first.endswith(".")):
                lacking.append(f"{path.relative_to(ROOT)}: {name}: {first!r}")
    assert not lacking, lacking


def test_types_are_for_others_too():
    """Type checkers look into a package that is marked so; the mark lies in the folder that the wheel is made of."""
    assert (ROOT / "py.typed").read_bytes() == b""


def test_public_names():
    """Some 50 names at the top, the rest by theme; every name exists, stands in one place only, and is no module."""
    by_name = Counter(path.rpartition(".")[2] for path in PUBLIC)
    assert [name for name, count in by_name.items() if count > 1] == []
    assert [path for path, thing in PUBLIC.items() if inspect.ismodule(thing)] == []
    assert len(names_of("")) <= 54


def test_unknown_name():
    """A name that is not there is an AttributeError that names the module."""
    for module in (holdfast, holdfast.dynamics):
        with pytest.raises(AttributeError, match=rf"{module.__name__}.*no_such_name"):
            _ = module.no_such_name


def fresh(code: str) -> str:
    """Return what a fresh interpreter prints."""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.strip()


def test_import_loads_little():
    """`import holdfast` loads none of its modules; the model brings NumPy and nothing heavy."""
    assert not fresh("import sys, holdfast; print(*(m for m in sys.modules if m.startswith('holdfast.')))")
    loaded = fresh("import sys, holdfast; holdfast.Pose; print(*{m.split('.')[0] for m in sys.modules})").split()
    assert "numpy" in loaded
    assert not set(loaded) & HEAVY


def test_the_model_loads_little():
    """What a model is made of loads no algorithm, file or machine code: they wait until they are used."""
    code = "import sys, holdfast as hf; hf.Arm, hf.ClosedChain, hf.State, hf.ModelError; print(*sys.modules)"
    loaded = {module.split(".")[1] for module in fresh(code).split() if module.startswith("holdfast.")}
    assert loaded == {"errors", "model", "spatial", "state"}


def test_the_list_of_commands_loads_no_command():
    """`holdfast --help` reads the commands' descriptions without importing what they run."""
    code = "import sys; from holdfast.cli import main; main(['--help']); print(*sys.modules)"
    *page, modules = fresh(code).splitlines()
    assert any("Simulate a scene" in line for line in page)
    loaded = {module.split(".")[1] for module in modules.split() if module.startswith("holdfast.")}
    assert loaded == {"cli", "errors", "model", "progress", "spatial"}
