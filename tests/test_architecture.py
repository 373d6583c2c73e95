"""The rooms of the house: who may import whom, how large files get, what is documented, what loads."""

import ast
import functools
import importlib
import inspect
import statistics
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

import holdfast
from holdfast import outer
from tests.surface import PUBLIC, names_of

ROOT = Path(holdfast.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
BENCHMARKS = sorted((Path(__file__).parents[1] / "benchmarks").rglob("*.py"))
ROOMS = {path.relative_to(ROOT).parts[0].removesuffix(".py") for path in FILES}

# Dependency only leftward: each room and the rooms it may look into. `errors`, `names` and `outer` are open to all.
MATHEMATICS = {"spatial"}
MODEL = MATHEMATICS | {"model"}
DYNAMICS = MODEL | {"state", "questions", "dynamics", "compiler", "compiled", "progress"}
USE = DYNAMICS | {"forces", "simulation", "control"}
FILES_AND_SCENES = USE | {"robots", "assembly", "interop", "scenario", "io"}
MAY_IMPORT = {
    "errors": set(),
    "outer": set(),  # names modules of outer rooms, and imports them when a method of the core asks
    "names": set(),
    "progress": set(),
    "spatial": set(),
    "model": MATHEMATICS,
    "questions": MODEL | {"state"},
    "state": MODEL,
    "dynamics": MODEL | {"state", "questions"},
    "compiler": set(),  # knows nothing of robots
    "compiled": DYNAMICS - {"compiled"} | {"forces"},
    "forces": MODEL | {"state", "questions", "dynamics"},
    "control": DYNAMICS | {"forces"},
    "simulation": DYNAMICS | {"forces", "control"},
    "robots": MODEL,
    "world": MODEL,
    "assembly": DYNAMICS,
    "planning": DYNAMICS | {"control"},
    "interop": USE | {"robots", "io"},
    "scenario": FILES_AND_SCENES - {"scenario"},
    "io": USE | {"robots"},
    "identification": DYNAMICS | {"simulation", "io"},
    "calibration": DYNAMICS | {"identification", "io"},
    "gym": USE | {"robots", "assembly"},
    "sweeps": USE | {"io", "scenario"},
    "codegen": USE | {"io"},
    "view": FILES_AND_SCENES | {"identification", "calibration"},
    "plot": {"view"},
    "cli": FILES_AND_SCENES | {"codegen", "sweeps", "view", "identification", "calibration", "holdfast"},
}
# imports inside functions, of what the room cannot know when it is loaded
ON_CALL = {"io/result_reader.py": {"scenario"}, "sweeps/result.py": {"view"}}
FOR_TYPES = {f"compiled/{name}.py": {"codegen"} for name in ("chain", "forest", "function")}
CORE = {"errors", "names", "progress", "state", "spatial", "model", "questions", "dynamics", "forces"}
CORE |= {"compiler", "compiled", "control", "simulation", "assembly", "planning"}
LARGEST_CIRCLE = 3  # modules that import each other, some of them inside functions
HEAVY = {"scipy", "llvmlite", "tyro", "rich", "matplotlib", "pinocchio", "mujoco", "viser", "mpmath"}
HEAVY |= {"pandas", "pyarrow", "xarray", "IPython", "jax", "gymnasium"}
SAME_EVERYWHERE = {
    "ROWS",
    "VISUALS",
    "FLANGE",
    "Shape",
    "Box",
    "Cylinder",
    "Sphere",
    "Cone",
    "Hole",
}  # tables of the built-in robots; shapes of pictures and of the world; cones of forces; of arrays in the compiler


@functools.cache
def parsed(path: Path) -> ast.Module:
    """Return a source file's syntax tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


def room(path: Path) -> str:
    """Return the room a source file is in."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def statements(of: ast.AST, types: bool) -> Iterator[ast.AST]:
    """Yield the statements within one, in which imports are; without `types` not those that only type checkers see."""
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        if types or name != "body" or not isinstance(of, ast.If) or ast.unparse(of.test) != "TYPE_CHECKING":
            for node in getattr(of, name, ()):
                yield node
                yield from statements(node, types)


@functools.cache
def imported(path: Path, types: bool = True) -> set[tuple[str, str]]:
    """Return (module, name) of what a file imports, inside functions too; the name is empty for a whole module.

    Args:
        path: the source file.
        types: whether imports that only type checkers see count.
    """
    names = set()
    for node in statements(parsed(path), types):
        if isinstance(node, ast.Import):
            names |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert all(alias.name != "*" for alias in node.names), f"{path}: star import"
            names |= {(node.module, alias.name) for alias in node.names}
    return names


def imported_rooms(path: Path, types: bool = True) -> set[str]:
    """Return the rooms that a file imports; `holdfast` is the package itself."""
    names = [f"{module}.{name}".split(".") for module, name in imported(path, types)]
    ours = [parts for parts in names if parts[0] == "holdfast" and parts[1] != "__version__"]
    return {parts[1] if parts[1] in ROOMS else "holdfast" for parts in ours}


def test_imports_go_left():
    """No room imports one to its right; only the top and the command line know the whole package."""
    wrong = {}
    for path in FILES:
        here, name = room(path), path.relative_to(ROOT).as_posix()
        if here not in ("__init__", "__main__"):
            assert here in MAY_IMPORT, f"a new room: say in MAY_IMPORT where {here} belongs"
            allowed = MAY_IMPORT[here] | ON_CALL.get(name, set()) | FOR_TYPES.get(name, set())
            wrong[name] = imported_rooms(path) - allowed - {here, "errors", "names", "outer"}
    assert {name: rooms for name, rooms in wrong.items() if rooms} == {}


def test_names_are_imported_from_where_they_are_defined():
    """Not from a module that has imported them for itself; packages and `holdfast.world` offer names on purpose."""
    files = [path for path in FILES if path.name != "__init__.py" and path.parent != ROOT]
    modules = {".".join(path.relative_to(ROOT.parent).with_suffix("").parts): path for path in files}
    passed_on = [
        (path.name, module, name)
        for path in (*FILES, *BENCHMARKS)
        for module, name in imported(path)
        if name
        and module in modules
        and name in {one for _, one in imported(modules[module])}
        and name not in defined(module)
    ]
    assert not passed_on


@functools.cache
def defined(module: str) -> set[str]:
    """Return the names that a module gives itself, without those that it imports."""
    path = ROOT.parent / Path(*module.split(".")).with_suffix(".py")
    stored = [node for node in ast.walk(parsed(path)) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
    named = ast.FunctionDef | ast.ClassDef
    return {node.id for node in stored} | {node.name for node in ast.walk(parsed(path)) if isinstance(node, named)}


def test_the_core_imports_no_outer_room():
    """What computes imports no file format, screen or command, not even inside functions, nor by a string."""
    for path in FILES:
        if room(path) in CORE:
            assert imported_rooms(path, types=False) <= CORE | {"outer"}, path
            texts = [node.value for node in ast.walk(parsed(path)) if isinstance(node, ast.Constant)]
            modules = [text.split(".") for text in texts if isinstance(text, str) and text.startswith("holdfast.")]
            assert not [parts for parts in modules if " " not in parts[1] and parts[1] not in CORE], path
            assert ("importlib", "import_module") not in imported(path), path


def test_the_core_loads_no_outer_room():
    """When every module of the core is imported, no other room is loaded."""
    files = [path.relative_to(ROOT.parent).with_suffix("") for path in FILES if room(path) in CORE]
    names = [".".join(path.parts).removesuffix(".__init__") for path in files]
    loaded = fresh(f"import sys, importlib; [*map(importlib.import_module, {names})]; print(*sys.modules)").split()
    assert {name.split(".")[1] for name in loaded if name.startswith("holdfast.")} <= CORE | {"outer"}


def test_what_the_core_asks_of_outer_rooms():
    """What the core asks of `outer` is there, all that is there is asked, and each stands in the module it names."""
    asked = {
        (room(path), node.attr)
        for path in FILES
        if ("holdfast", "outer") in imported(path)
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "outer"
    }
    assert {here for here, _ in asked} <= CORE
    assert {name for _, name in asked} == outer.MODULE_OF.keys()
    for name, module in outer.MODULE_OF.items():
        assert module.split(".")[1] in MAY_IMPORT.keys() - CORE, name
        assert getattr(outer, name).__module__ == module, name
    with pytest.raises(AttributeError, match=r"holdfast\.outer.*no_such_name"):
        _ = outer.no_such_name


def test_circles_of_modules_are_small():
    """At most three modules import each other, directly or through others, imports inside functions included.

    A package that collects the names of its files is imported with each of them; this does not count.
    """
    files = {".".join(path.relative_to(ROOT.parent).with_suffix("").parts): path for path in FILES}
    modules = {name.removesuffix(".__init__"): path for name, path in files.items()}
    number = {name: k for k, name in enumerate(modules)}
    imports = np.zeros((len(modules), len(modules)), dtype=bool)
    for name, path in modules.items():
        for module, member in imported(path, types=False):
            targets = {module, f"{module}.{member}"} & modules.keys()
            imports[number[name], [number[target] for target in targets]] = True
    count, circle_of = connected_components(imports, connection="strong")
    circles = [[name for name, k in number.items() if circle_of[k] == i] for i in range(count)]
    assert [circle for circle in circles if len(circle) > LARGEST_CIRCLE] == []


def test_nothing_outside_the_package():
    """The library imports neither its benchmarks nor its tests and examples."""
    outside = {path.name for path in Path(__file__).parents[1].iterdir() if path.is_dir()}
    assert {"benchmarks", "examples", "tests"} <= outside
    for path in FILES:
        assert not {module.split(".")[0] for module, _ in imported(path)} & outside, path


def test_rooms_are_not_circular():
    """Ordering the rooms by what they may import leaves none that wait for each other."""
    waiting = {name: set(rooms) - {"holdfast"} for name, rooms in MAY_IMPORT.items()}
    while waiting:
        ready = {name for name, rooms in waiting.items() if not rooms & waiting.keys()}
        assert ready, waiting
        waiting = {name: rooms for name, rooms in waiting.items() if name not in ready}


def test_file_sizes():
    """One algorithm a file, one screen an algorithm: none over 400 lines, median at most 160."""
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in [*FILES, *BENCHMARKS]}
    assert max(lines.values()) <= 400, max(lines, key=lines.__getitem__)
    assert statistics.median(lines.values()) <= 160


def test_names_of_rooms():
    """No catch-all: what a file is for stands in its name."""
    vague = {"utils", "util", "core", "helpers", "misc", "common", "manager"}
    assert not {path.stem for path in FILES} & vague
    assert not {path.parent.name for path in FILES} & vague


def capitalised_names(tree: ast.Module) -> Iterator[str]:
    """Yield the public classes, constants, type aliases and type variables that a module defines itself."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            names = [node.name]
        else:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            names = [part.id for target in targets if target for part in ast.walk(target) if isinstance(part, ast.Name)]
        yield from (name for name in names if name[0].isupper())


def test_one_name_has_one_meaning():
    """No class, constant, type alias or type variable has the name of another one, unless it means the same."""
    modules = defaultdict(list)
    for path in FILES:
        for name in {*capitalised_names(parsed(path))}:
            modules[name].append(path.relative_to(ROOT).as_posix())
    repeated = {name: found for name, found in modules.items() if len(found) > 1}
    assert {name: found for name, found in sorted(repeated.items()) if name not in SAME_EVERYWHERE} == {}
    assert repeated.keys() >= SAME_EVERYWHERE


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
    for path in [*FILES, *BENCHMARKS]:
        tree = parsed(path)
        for name, node in {"file": tree, **dict(public_definitions(tree))}.items():
            first = (ast.get_docstring(node) or "").split("\n")[0].strip()
            if not first or (name != "file" and not first.endswith(".")):
                lacking.append(f"{path}: {name}: {first!r}")
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


def test_a_name_asked_for_at_the_wrong_place():
    """The error for a name that stands elsewhere says where."""
    for path in PUBLIC:
        place, _, name = f"holdfast.{path}".rpartition(".")
        for wrong in {"holdfast", "holdfast.forces"} - {place}:
            with pytest.raises(AttributeError, match=rf"^{wrong} has no '{name}'; try {place}\.{name}$"):
                getattr(importlib.import_module(wrong), name)


def fresh(code: str) -> str:
    """Return what a fresh interpreter prints."""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.strip()


def test_import_loads_little():
    """`import holdfast` loads what finds its names; the model brings NumPy and nothing heavy."""
    own = fresh("import sys, holdfast; print(*(m for m in sys.modules if m.startswith('holdfast.')))").split()
    assert set(own) == {"holdfast.errors", "holdfast.names"}
    loaded = fresh("import sys, holdfast; holdfast.Pose; print(*{m.split('.')[0] for m in sys.modules})").split()
    assert "numpy" in loaded
    assert not set(loaded) & HEAVY


def test_the_model_loads_little():
    """What a model is made of loads no algorithm, file or machine code: they wait until they are used."""
    code = "import sys, holdfast as hf; hf.Arm, hf.ClosedChain, hf.State, hf.errors.ModelError; print(*sys.modules)"
    loaded = {module.split(".")[1] for module in fresh(code).split() if module.startswith("holdfast.")}
    assert loaded == {"errors", "model", "names", "outer", "spatial", "state"}


def test_commands_load_what_they_need():
    """Simulating and reading results take no library that only some chains or pictures need."""
    code = "import sys, holdfast.cli.simulate, holdfast.cli.results; print(*{m.split('.')[0] for m in sys.modules})"
    assert not {"scipy", "matplotlib", "pyarrow", "viser"} & set(fresh(code).split())


def test_the_list_of_commands_loads_no_command():
    """`holdfast --help` reads the commands' descriptions without importing what they run."""
    code = "import sys; from holdfast.cli import main; main(['--help']); print(*sys.modules)"
    *page, modules = fresh(code).splitlines()
    assert any("Simulate a scene" in line for line in page)
    loaded = {module.split(".")[1] for module in modules.split() if module.startswith("holdfast.")}
    assert loaded == {"cli", "errors", "model", "names", "progress", "spatial"}
