"""`holdfast export-c`: write the dynamics and the controller of a scene as C or object files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from holdfast.cli.console import print_document, stdout
from holdfast.cli.results import opened_scene, scene_name
from holdfast.cli.standard import refuse_standard
from holdfast.cli.streams import say
from holdfast.codegen.export import ExportedCode, export_c
from holdfast.codegen.functions import exported_function, exported_law
from holdfast.compiled.chain import CompiledChain, compile
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.scenario.build import Scenario

CONTROL = "control"  # the function of the scene's controller
BY_DEFAULT = ("forward_dynamics", "inverse_dynamics", "step", CONTROL)


def export_code(
    scene: Path,
    out: Path | None,
    name: str | None,
    functions: Sequence[str],
    target: str,
    source: bool,
    scheme: str,
    of: Sequence[str],
    by: Sequence[str],
    overwrite: bool,
    changes: Sequence[str],
    as_json: bool,
    trust_xacro: bool,
) -> int:
    """Write computations of a scene's chain, and its controller, as code that runs without Python; return 0.

    What takes its time is said on stderr.

    Args:
        scene: the scene file; `-` for stdin.
        out: the folder; `code/<scene's name>` if None.
        name: prefix of all names in C; made from the scene's name if None.
        functions: functions to export; if empty, those of `BY_DEFAULT` that this chain and its controller support.
        target: the processor.
        source: whether to write C11 instead of an object file.
        scheme: integration scheme of a step.
        of: results to differentiate.
        by: arguments by which to differentiate.
        overwrite: replace an earlier export there.
        changes: changes `key=value` of the scene.
        as_json: print one JSON document on stdout instead of a table.
        trust_xacro: expand xacro files that the scene names.

    Raises:
        HoldfastError: the input is invalid, or this chain or controller does not support a function.
    """
    refuse_standard(out, "--out")
    folder = Path("code") / scene_name(scene) if out is None else out
    scenario = opened_scene(scene, trust_xacro, changes)
    compiled = compile(scenario.chain)
    requested = list(functions) or _those_there_are(scenario, compiled, scheme)
    laws = {CONTROL: scenario.controller} if CONTROL in requested else {}
    made = export_c(
        compiled,
        folder,
        name=_prefix(scene_name(scene)) if name is None else name,
        functions=[one for one in requested if one != CONTROL],
        laws=laws,
        target=target,
        source=source,
        state=scenario.state,
        of=tuple(of),
        by=tuple(by),
        scheme=scheme,
        base_motion=scenario.options.get("base_motion"),
        overwrite=overwrite,
        progress=True,
    )
    _report(made, as_json)
    return 0


def _those_there_are(scenario: Scenario, compiled: CompiledChain, scheme: str) -> list[str]:
    """Return the functions of `BY_DEFAULT` that can be exported; print on stderr why others cannot."""
    found = []
    for one in BY_DEFAULT:
        try:
            if one == CONTROL:
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
