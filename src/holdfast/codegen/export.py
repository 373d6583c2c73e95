"""`export_c`: a folder with C source or an object file, headers, and files for build systems."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from os import PathLike
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

from holdfast.codegen.functions import (
    ExportedFunction,
    exported_function,
    exported_law,
    exported_names,
    exported_of_forest,
)
from holdfast.codegen.header import CFunction, header, wrapper
from holdfast.compiled.chain import CompiledChain, compile
from holdfast.compiled.forest import CompiledForest, CompiledMechanism
from holdfast.compiled.kernels import operations
from holdfast.compiler.targets import (
    DEFINITIONS,
    OBJECT_TARGETS,
    ObjectTarget,
    cpu,
    object_file,
    single_module,
    single_source,
)
from holdfast.control.controller import ControlLaw, Controller
from holdfast.errors import ModelError, ResultError
from holdfast.io.files import file_path, names_in, replaced_folder
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import row_name
from holdfast.model.serial_chain import answered_as_forest, require_machine_code, require_unused, serial_chain
from holdfast.progress import busy, detail
from holdfast.simulation.environment import BaseMotion
from holdfast.spatial.frozen import FrozenDict
from holdfast.state import State

# For GCC and Clang: no fma that is not in the source. GCC 12 fuses a product and a sum in neighbouring numbers
# in spite of -ffp-contract when it vectorises straight-line code.
EXACT_FLAGS = "-ffp-contract=off -fno-tree-slp-vectorize -fno-math-errno"
_NAME = re.compile(r"[a-z][a-z0-9_]{0,40}")


class ExportedSize(NamedTuple):
    """The memory that a call of an exported function needs.

    Attributes:
        workspace: bytes of working memory, which the caller provides.
        stack: bytes of stack; None for C source, for which the compiler decides.
    """

    workspace: int
    stack: int | None


class ExportedCode(NamedTuple):
    """The result of `export_c`.

    Attributes:
        folder: the folder.
        files: names of the files.
        functions: the C functions, with the memory that a call of each needs.
        target: the processor.
    """

    folder: Path
    files: tuple[str, ...]
    functions: Mapping[str, ExportedSize]
    target: str


def export_c(
    chain: ClosedChain | CompiledChain | CompiledMechanism | CompiledForest,
    folder: str | PathLike[str],
    *,
    name: str = "chain",
    functions: Sequence[str] | None = None,
    laws: Mapping[str, Controller | ControlLaw] | None = None,
    target: str = "x86-64-v3",
    source: bool = False,
    state: State | None = None,
    of: Sequence[str] | None = None,
    by: Sequence[str] | None = None,
    scheme: str = "rk4",
    base_motion: Mapping[str, BaseMotion] | None = None,
    overwrite: bool = False,
    progress: bool | None = None,
) -> ExportedCode:
    """Write a chain's computations as code that runs without Python, and return a list of the files and functions.

    The folder gets `name.o` (or `name.c`), a C header with sizes, layouts, units and one function per computation, a
    C++17 wrapper, and files for CMake and pkg-config. Object files have no undefined symbols, allocate no memory
    and keep no state. On every processor with fma their results are identical, bit by bit, to those of this library's
    machine code, and so are the results of the source with the compiler options in the CMake file.

    Args:
        chain: the chain, or the result of `holdfast.compile` to have link inertias or wrenches as arguments. Of a chain
            with branches, loops, couplings or several objects, and of a compiled forest, there are forward_dynamics,
            forward_dynamics_vjp, forward_dynamics_jvp and inverse_dynamics, of which all numbers are constants.
        folder: the folder to write.
        name: prefix of all names in C: lower-case letters, digits, underscores.
        functions: any of forward_dynamics, inverse_dynamics, mass_matrix, jacobian, closure, kinetic_energy,
            potential_energy, momentum, centre_of_mass, object_mobility, tip_poses, link_poses, project,
            forward_dynamics_vjp, forward_dynamics_jvp, forward_dynamics_jacobian, step. By default forward and inverse
            dynamics.
        laws: control laws, by the names of their functions.
        target: the processor under Linux: x86-64-v2, x86-64-v3, x86-64-v4 or aarch64.
        source: write C11 source instead of an object file; `target` then determines the compiler options and whether
            products and sums are fused.
        state: initial state in memory; required for a step, and for the generic rank of chains with dependent
            constraint rows.
        of: names of the results of derivatives.
        by: names of the arguments of derivatives.
        scheme: scheme of a step: rk4, midpoint, or imex for joints with stiff springs or dampers.
        base_motion: for a step, functions of t that return pose, twist and acceleration of moving bases, by arm name or
            "trunk", as for `compile_rollout`; they become part of the code, in which steps count t from `begin`.
        overwrite: replace an earlier export in this folder.
        progress: as for `holdfast.compile`.

    Raises:
        ModelError: a name is invalid, a function or target is unknown, a step has no state, or `progress` is invalid.
        ResultError: the folder is in use or cannot be written.
        MethodNotApplicable: the chain has no machine code of a function or a law.
        CompileError: a law cannot be compiled.
    """
    compiled = chain if isinstance(chain, CompiledChain | CompiledMechanism | CompiledForest) else None
    if compiled is None and not answered_as_forest(chain):
        serial_chain(chain, "export: chain")
        require_machine_code(chain, "export")
    checks.instance(name, str, "export: name")
    checks.instance(target, str, "export: target")
    checks.instance(scheme, str, "export: scheme")
    checks.instance(state, (State, type(None)), "export: state")
    if not _NAME.fullmatch(name):
        raise ModelError(f"export: name: expected lower-case letters, digits and _, got {checks.short(name)}")
    if target not in OBJECT_TARGETS:
        known = ", ".join(OBJECT_TARGETS)
        raise ModelError(f"export: target: expected one of {known}, got {checks.short(target)}")
    place = file_path(folder, "export: folder")
    if names_in(place, "a folder of exported code") and not overwrite:
        raise ResultError(f"{place}: is in use; try another folder, or overwrite")
    made: Any = compiled or compile(chain)  # type: ignore[arg-type]
    serial = isinstance(made, CompiledChain)
    by_default = ("forward_dynamics", "inverse_dynamics")
    requested = _requested(by_default if functions is None else functions, laws or {})
    if serial:
        found = [exported_function(one, made, state, of, by, scheme, base_motion) for one in requested]
        found += [exported_law(key, law, made) for key, law in (laws or {}).items()]
    else:
        require_unused(laws=bool(laws), base_motion=bool(base_motion))
        found = [exported_of_forest(one, made, state, of, by) for one in requested]
    doing = f"writing code of {len(found)} function{'s' * (len(found) > 1)}"
    with replaced_folder(place, lambda name: name in written.files) as beside:  # refuses before any code is made
        with busy(progress, doing, "this may take seconds"):
            written = files_of(name, found, OBJECT_TARGETS[target], source, _about(made))
        for file, content in written.files.items():
            (beside / file).write_bytes(content)
    sizes = {f.name: ExportedSize(8 * f.workspace, f.stack) for f in written.functions}
    return ExportedCode(place, tuple(written.files), FrozenDict(sizes), target)


@dataclass(frozen=True, eq=False)
class ExportedFiles:
    """An export before it is written.

    Attributes:
        files: contents of the files, by name.
        functions: the functions in them.
    """

    files: dict[str, bytes]
    functions: list[CFunction]


def _requested(functions: Sequence[str], laws: Mapping[str, object]) -> list[str]:
    """Return the names of the functions without repetition.

    Raises:
        ModelError: there are none, or the name of a law is used already or is not an identifier.
    """
    checks.instance(functions, (list, tuple), "export: functions")
    checks.instance(laws, Mapping, "export: laws")
    for one in functions:
        if one not in exported_names():
            raise ModelError(
                f"export: functions: no {checks.short(one)}.{checks.did_you_mean(str(one), exported_names())}"
            )
    for law in laws:
        if not isinstance(law, str) or not _NAME.fullmatch(law) or law in exported_names():
            raise ModelError(f"export: laws: expected a name of its own in lower-case letters, got {checks.short(law)}")
    if not functions and not laws:
        raise ModelError("export: expected functions or laws, got none")
    return list(dict.fromkeys(functions))


def files_of(
    name: str,
    found: Sequence[ExportedFunction],
    target: ObjectTarget,
    source: bool,
    about: Mapping[str, str] | None = None,
) -> ExportedFiles:
    """Return the files of an export.

    Args:
        name: prefix of all names.
        found: the functions.
        target: the processor.
        source: whether to write source.
        about: properties of the chain for the header, by name.
    """
    with cpu.made_for(target.made_for):
        code, functions = (_source if source else _objects)(name, found, target)
    version = metadata.version("holdfast")
    of_functions = ", ".join(f.name for f in functions)
    says = {
        "Written by holdfast": version,
        **(about or {}),
        "Processor": f"{target.name}, Linux",
        "Units": "SI: m, rad, s, kg, N, N m. Twists, wrenches: angular part first, world axes",
    }
    kind = "source" if source else "objects"
    values = {"name": name, "version": version, "flags": f"{target.flags} {EXACT_FLAGS}", "description": of_functions}
    files = {
        f"{name}.c" if source else f"{name}.o": code,
        f"{name}.h": header(name, functions, says).encode(),
        f"{name}.hpp": wrapper(name, functions).encode(),
        "CMakeLists.txt": _filled("CMakeLists.txt", values),
        f"{name}Config.cmake": _filled(f"{kind}.cmake", values),
        f"{name}.pc": _filled(f"{kind}.pc", values),
    }
    return ExportedFiles(files, functions)


def _about(made: CompiledChain | CompiledMechanism | CompiledForest) -> dict[str, str]:
    """Return the properties of a chain that the header states."""
    if isinstance(made, CompiledForest):
        return {"Forest": f"{len(made.forest.bodies)} bodies, {len(made.forest.closures)} closures"}
    chain = made.chain
    joints = [f"{name} {part.start}..{part.stop - 1}" for name, part in zip(chain.arms, chain.arm_joints, strict=True)]
    holding = ", ".join(map(row_name, chain.grasps)) or "none"
    return {
        "Chain": f"{chain.joint_count} joints, {len(chain.arms)} arms; holding: {holding}",
        "Joints": "; ".join(joints),
    }


def _objects(name: str, found: Sequence[ExportedFunction], target: ObjectTarget) -> tuple[bytes, list[CFunction]]:
    """Return the object file and its functions."""
    modules, workspaces = [], []
    for one in found:
        public, schedule = f"{name}_{one.name}", one.schedule()
        detail(f"{one.name}, {operations(schedule.operation_count)}")
        text, workspace = single_module(schedule, cpu.lanes(), (public, f"{public}_prepare"))
        modules.append(text)
        workspaces.append(workspace)
    made = object_file(modules, target)
    names = [f"{name}_{one.name}" for one in found]
    stacks = [max(made.stack[x], made.stack[f"{x}_prepare"]) for x in names]
    return made.content, [CFunction(name, *each) for each in zip(found, workspaces, stacks, strict=True)]


def _source(name: str, found: Sequence[ExportedFunction], target: ObjectTarget) -> tuple[bytes, list[CFunction]]:
    """Return the C source and its functions."""
    lines = [
        f"/* Compile with: -std=c11 -O2 {target.flags} {EXACT_FLAGS} */",
        f'#include "{name}.h"',
        "",
        DEFINITIONS,
    ]
    functions = []
    for one in found:
        draft = CFunction(name, one, 0, None)
        names = (draft.name, f"{draft.name}_prepare")
        schedule = one.schedule()
        detail(f"{one.name}, {operations(schedule.operation_count)}")
        text, workspace = single_source(schedule, names, f"{draft.name}_arrays", draft.fields)
        lines += ["", f"/* ---- {draft.name}: {one.summary} ---- */", text]
        functions.append(CFunction(name, one, workspace, None))
    return "\n".join(lines).encode(), functions


def _filled(template: str, values: Mapping[str, str]) -> bytes:
    text = (Path(__file__).parent / "templates" / f"{template}.in").read_text()
    return Template(text).substitute(values).encode()
