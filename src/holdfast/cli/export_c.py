"""`holdfast export-c`: write the dynamics and the controller of a scene as C or object files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from holdfast.cli.console import print_document, refuse_standard, stdout
from holdfast.cli.options import Changes, Folder, Names, OptionalName, PackageOptions, SceneFile, Switch
from holdfast.cli.results import opened_scene, scene_name
from holdfast.cli.streams import say
from holdfast.codegen.export import ExportedCode
from holdfast.codegen.export import export_c as write_code
from holdfast.codegen.functions import exported_function, exported_law
from holdfast.compiled.chain import CompiledChain, compile
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.scenario.build import Scenario

SCENE_CONTROL = "control"  # the function of the scene's controller
BY_DEFAULT = ("forward_dynamics", "inverse_dynamics", "step", SCENE_CONTROL)


def export_c(
    scene: SceneFile,
    out: Folder = None,
    name: OptionalName = None,
    function: Names = (),
    target: Literal["x86-64-v2", "x86-64-v3", "x86-64-v4", "aarch64"] = "x86-64-v3",
    source: Switch = False,
    scheme: Literal["rk4", "midpoint", "imex"] = "rk4",
    of: Names = (),
    by: Names = (),
    overwrite: bool = False,
    changes: Changes = (),
    json: Switch = False,
    trust_xacro: Switch = False,
    packages: PackageOptions = (),
) -> int:
    """Write a scene's dynamics, a time step and its controller as C or object files that run without Python.

    Args:
        scene: the scene, TOML; - for stdin.
        out: the folder to write; by default code/<scene>.
        name: prefix of all names in C; by default the scene's name.
        function: one of forward_dynamics, inverse_dynamics, project, step, control (the scene's controller),
            forward_dynamics_jacobian and others, which the documentation lists; may be repeated.
        target: the processor of the Linux system for which object files are compiled.
        source: write C11 instead of an object file.
        scheme: integration scheme of a step; imex for joints with stiff springs or dampers.
        of: a result to differentiate, by default qdd; may be repeated.
        by: an argument by which to differentiate, by default q, qd and tau; may be repeated.
        overwrite: replace an earlier export.
        changes: set a key of the scene, such as simulation.step=0.001; may be repeated.
        json: print one JSON document instead of a table.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
        packages: the folder of a package that a robot's file refers to; may be repeated.

    Raises:
        HoldfastError: the input is invalid, or this chain or controller does not support a function.
    """
    refuse_standard(out)
    folder = Path("code") / scene_name(scene) if out is None else out
    scenario = opened_scene(scene, trust_xacro, changes, packages)
    compiled = compile(scenario.chain)
    requested = list(function) or _those_there_are(scenario, compiled, scheme)
    laws = {SCENE_CONTROL: scenario.controller} if SCENE_CONTROL in requested else {}
    made = write_code(
        compiled,
        folder,
        name=_prefix(scene_name(scene)) if name is None else name,
        functions=[one for one in requested if one != SCENE_CONTROL],
        laws=laws,
        target=target,
        source=source,
        state=scenario.state,
        of=of or None,
        by=by or None,
        scheme=scheme,
        base_motion=scenario.options.get("base_motion"),
        overwrite=overwrite,
        progress=True,
    )
    _report(made, json)
    return 0


def _those_there_are(scenario: Scenario, compiled: Any, scheme: str) -> list[str]:
    """Return the functions of `BY_DEFAULT` that can be exported; print on stderr why others cannot."""
    if not isinstance(compiled, CompiledChain):
        there, others = BY_DEFAULT[:2], BY_DEFAULT[2:]
        say(f"note: without {', '.join(others)}: chains that are answered as forests have no machine code of them")
        return [*there]
    found = []
    for one in BY_DEFAULT:
        try:
            if one == SCENE_CONTROL:
                exported_law(one, scenario.controller, compiled)
            else:
                motions = scenario.options.get("base_motion")
                exported_function(one, compiled, scenario.state, scheme=scheme, base_motion=motions)
            found.append(one)
        except (MethodNotApplicable, StateError) as error:
            say(f"note: without {one}: {error}")
    return found


def _prefix(name: str) -> str:
    """Return a prefix for names in C, made from the name of a scene."""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in name.lower())[:40]
    return plain if plain[:1].isalpha() else f"scene_{plain}"[:40]


def _report(made: ExportedCode, as_json: bool) -> None:
    from rich.table import Table

    sizes: Mapping[str, dict[str, int | None]] = {
        name: {"workspace": size.workspace, "stack": size.stack} for name, size in made.functions.items()
    }
    if as_json:
        print_document({"folder": str(made.folder), "target": made.target, "files": made.files, "functions": sizes})
        return
    table = Table("function", "workspace [bytes]", "stack [bytes]")
    for name, size in sizes.items():
        table.add_row(name, str(size["workspace"]), "-" if size["stack"] is None else str(size["stack"]))
    console = stdout()
    console.print(table)
    console.print(f"{made.folder}: {', '.join(made.files)}")
