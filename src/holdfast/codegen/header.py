"""The C header of exported functions, with shapes and units of arrays, sizes of the caller's memory, and statuses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.codegen.arrays import LAST, extent, fields_of, meaning
from holdfast.codegen.functions import STEP, ExportedFunction
from holdfast.compiler.schedule import External
from holdfast.io.files import one_line
from holdfast.spatial.scalar import Array

_ALIGNMENT = 64  # alignment of working memory: a cache line, which the widest registers need [bytes]


@dataclass(frozen=True, eq=False)
class CFunction:
    """An exported function with its C names.

    Attributes:
        prefix: prefix of all names.
        of: the exported function.
        workspace: number of doubles of working memory.
        stack: bytes of stack that a call needs; None if the compiler decides.
    """

    prefix: str
    of: ExportedFunction
    workspace: int
    stack: int | None

    @property
    def name(self) -> str:
        """Name of the function."""
        return f"{self.prefix}_{self.of.name}"

    @cached_property
    def fields(self) -> dict[str, str]:
        """C names of the function's arrays."""
        return fields_of(self.of.externals)

    def declarations(self) -> list[str]:
        """Return the declarations of this function."""
        return [
            "",
            f"/* ---- {self.name}: {self.of.summary} ---- */",
            "",
            *self._statuses(),
            *self._sizes(),
            *self._arrays(),
            *self._memory(),
            "",
            "/* Compute the outputs. The first call comes after `begin` or `prepare`. */",
            f"int64_t {self.name}(const {self.name}_arrays *arrays);",
            "",
            "/* Take the parameters, which the workspace remembers; to be called after they have changed. */",
            f"void {self.name}_prepare(const {self.name}_arrays *arrays);",
            "",
            *self._begin(),
            *(self._start() if self.of.name == STEP else []),
        ]

    def _statuses(self) -> list[str]:
        if not self.of.statuses:
            return ["/* It returns 0; invalid inputs make not-a-number. */"]
        rows = [
            f"    {self.name.upper()}_{name.upper()} = {number}, /* {says} */"
            for name, (number, says) in self.of.statuses.items()
        ]
        return ["/* What it returns. */", f"enum {self.name}_status {{", *rows, "};", ""]

    def _sizes(self) -> list[str]:
        macro = self.name.upper()
        lines = [f"#define {macro}_WORKSPACE {max(self.workspace, 1)} /* doubles */"]
        return lines if self.stack is None else [*lines, f"#define {macro}_STACK {self.stack} /* bytes of a call */"]

    def _arrays(self) -> list[str]:
        """Return the struct of the arrays' addresses, in the order in which the machine code reads them."""
        lines = [
            "",
            "/* Where the arrays are; each holds doubles, the last index running fastest. */",
            "typedef struct {",
        ]
        for name, external in self.of.externals.items():
            const = "const " if external.role in ("input", "parameter") else ""
            lines.append(f"    {const}double *{self.fields[name]}; /* {self._says(name, external)} */")
        lines.append(f"    double *workspace; /* [{self.name.upper()}_WORKSPACE], aligned to {_ALIGNMENT} bytes */")
        return [*lines, f"}} {self.name}_arrays;"]

    def _says(self, name: str, external: External) -> str:
        role = {"carried": "in and out", "input": "in", "output": "out"}.get(external.role, external.role)
        shape = "".join(f"[{n}]" for n in external.shape) or "[1]"
        words = meaning(name)
        return f"{role} {shape}{': ' + words if words else ''}"

    def _memory(self) -> list[str]:
        lines = ["", "/* Memory for all of it. Nothing points into it but an `arrays` of yours: do not move it. */"]
        lines += ["typedef struct {", f"    HOLDFAST_ALIGNED double workspace[{max(self.workspace, 1)}];"]
        for name, external in self._present():
            lines.append(f"    double {self.fields[name]}{extent(external)};")
        return [*lines, f"}} {self.name}_memory;"]

    def _begin(self) -> list[str]:
        """Return the function that assigns memory to the arrays and sets their initial values."""
        lines = [
            "/* Tie `arrays` to `memory`, fill it with what was exported, zeros elsewhere, and prepare. */",
            f"static inline void {self.name}_begin({self.name}_memory *memory, {self.name}_arrays *arrays)",
            "{",
        ]
        filled = [(name, self.of.values[name]) for name, _ in self._present() if np.any(self.of.values.get(name, 0.0))]
        for name, x in filled:
            lines += _constants(self.fields[name], np.asarray(x, dtype=float))
        lines += [
            "    double *const all = (double *)memory;",
            f"    for (size_t k = 0; k < sizeof({self.name}_memory) / sizeof(double); k++) all[k] = 0.0;",
        ]
        present = dict(self._present())
        for name in self.of.externals:
            first = "[0]" * max(1, len(present[name].shape)) if name in present else "[0]"
            field = self.fields[name] if name in present else "workspace"
            lines.append(f"    arrays->{self.fields[name]} = &memory->{field}{first};")
        lines.append("    arrays->workspace = memory->workspace;")
        for name, x in filled:
            field = self.fields[name]
            at = f"(&memory->{field}{'[0]' * max(1, x.ndim)})"
            lines.append(f"    for (int k = 0; k < {x.size}; k++) {at}[k] = {field}_at_first[k];")
        return [*lines, f"    {self.name}_prepare(arrays);", "}"]

    def _start(self) -> list[str]:
        """Return the function that starts a run at another state."""
        field = {name.removeprefix(LAST): self.fields[name] for name in self.of.externals if name.startswith(LAST)}
        sizes = {self.fields[name]: e.size for name, e in self.of.externals.items()}
        begin = {"work": "0.0", "count": "0.0", "worst_margin": "INFINITY"}
        fresh = [(field[name], value) for name, value in begin.items() if name in field]
        return [
            "",
            "/* Begin at the state that memory holds, which must nearly close the grasps: it is moved onto them. */",
            f"static inline int64_t {self.name}_start({self.name}_memory *memory, const {self.name}_arrays *arrays)",
            "{",
            f"    const double step = memory->{self.fields['step']}[0];",
            f"    memory->{field['code']}[0] = 0.0;",
            f"    memory->{self.fields['step']}[0] = 0.0;",
            f"    const int64_t status = {self.name}(arrays);",
            f"    memory->{self.fields['step']}[0] = step;",
            *[f"    for (int k = 0; k < {sizes[x]}; k++) memory->{x}[k] = {value};" for x, value in fresh],
            "    return status;",
            "}",
        ]

    def _present(self) -> Iterator[tuple[str, External]]:
        """Yield the arrays that are not empty."""
        return ((name, e) for name, e in self.of.externals.items() if e.size)


def header(prefix: str, functions: Sequence[CFunction], about: Mapping[str, Any]) -> str:
    """Return the header.

    Args:
        prefix: prefix of all names.
        functions: the functions to declare.
        about: properties of the chain for the first comment, by name.
    """
    guard = f"HOLDFAST_{prefix.upper()}_H"
    stated = {name: one_line(str(x)).replace("*/", "* /").replace("/*", "/ *") for name, x in about.items()}
    lines = ["/*", *[f" * {name}: {x}" for name, x in stated.items()], " *"]
    lines += [
        " * Nothing here asks for memory, keeps state of its own, or calls a library. Functions may run in several",
        " * threads at once, each with arrays and a workspace of its own.",
        " */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#include <math.h>",
        "#include <stddef.h>",
        "#include <stdint.h>",
        "",
        "#ifndef HOLDFAST_ALIGNED",
        "#ifdef __cplusplus",
        f"#define HOLDFAST_ALIGNED alignas({_ALIGNMENT})",
        "#else",
        f"#define HOLDFAST_ALIGNED _Alignas({_ALIGNMENT})",
        "#endif",
        "#endif",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
    ]
    for function in functions:
        lines += function.declarations()
    return "\n".join([*lines, "", "#ifdef __cplusplus", "}", "#endif", "", "#endif", ""])


def _constants(field: str, x: Array) -> list[str]:
    """Return the lines with the exact initial values of an array."""
    numbers = [_number(float(value)) for value in x.flat]
    rows = [", ".join(numbers[k : k + 6]) for k in range(0, len(numbers), 6)]
    return [
        f"    static const double {field}_at_first[{x.size}] = {{",
        *[f"        {row}," for row in rows],
        "    };",
    ]


def _number(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    return repr(value) if math.isfinite(value) else "INFINITY" if value > 0 else "-INFINITY"
