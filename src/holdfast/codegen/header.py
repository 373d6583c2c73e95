"""The headers of exported functions, with shapes and units of arrays, sizes of the caller's memory, and statuses.

The C header declares the functions. The C++17 header wraps them: a class for each function, which owns its memory;
arrays are spans of known length.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.codegen.functions import STEP_FUNCTION, ExportedFunction
from holdfast.compiled.derivative_schedule import FOUND, WITH
from holdfast.compiler.schedule import External
from holdfast.io.files import one_line
from holdfast.questions.arrays import ARRAYS, Row
from holdfast.questions.question import QUESTIONS
from holdfast.simulation.rollout.varied_step import LAW_PREFIX
from holdfast.spatial.scalar import Array

_ALIGNMENT = 64  # alignment of working memory: a cache line, which the widest registers need [bytes]
CARRIED_PREFIX = "last."  # of the arrays that a step carries on
_KEYWORDS = frozenset(
    """
    alignas alignof and asm auto bool break case catch char class const continue default delete do double else enum
    explicit export extern false float for friend goto if inline int long mutable namespace new not operator or
    private protected public register restrict return short signed sizeof static struct switch template this throw
    true try typedef typename union unsigned using virtual void volatile while
    """.split()  # noqa: SIM905
)


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
            *(self._start() if self.of.name == STEP_FUNCTION else []),
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
        field = {
            name.removeprefix(CARRIED_PREFIX): self.fields[name]
            for name in self.of.externals
            if name.startswith(CARRIED_PREFIX)
        }
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


def fields_of(externals: Iterable[str]) -> dict[str, str]:
    """Return the C names of arrays, without prefix where possible."""
    found: dict[str, str] = {}
    taken = {"workspace", *_KEYWORDS}
    for name in externals:
        field = name.removeprefix(CARRIED_PREFIX).removeprefix(LAW_PREFIX).replace(".", "_")
        while field in taken:
            field += "_"
        taken.add(field)
        found[name] = field
    return found


def meaning(name: str) -> str:
    """Return the description of an array; "" for a parameter of a law."""
    rows = {**ARRAYS, **{row: of for question in QUESTIONS.values() for row, of in question.rows.items()}}
    for prefix, words in ((WITH, "what is multiplied, as"), (FOUND, "derivatives by or of")):
        if name.startswith(prefix):
            rest = name.removeprefix(prefix)
            return f"{words} {described(rows[rest])}" if rest in rows else f"{words} {rest}"
    row = rows.get(name.removeprefix(CARRIED_PREFIX).removeprefix(LAW_PREFIX))
    return "" if row is None else described(row)


def described(row: Row) -> str:
    """Return an array's meaning and unit, for a comment in the header."""
    return f"{row.meaning} [{row.unit}]" if row.unit else row.meaning


def extent(external: External) -> str:
    """Return an array's shape in C syntax; [1] for a number."""
    return "".join(f"[{n}]" for n in external.shape) if math.prod(external.shape) and external.shape else "[1]"


_SPAN = """
/* An array of known length; std::span comes with C++20 only. */
template <typename T, std::size_t N>
class span {
public:
    constexpr explicit span(T *first) noexcept : first_(first) {}
    constexpr T *data() const noexcept { return first_; }
    constexpr T *begin() const noexcept { return first_; }
    constexpr T *end() const noexcept { return first_ + N; }
    static constexpr std::size_t size() noexcept { return N; }
    constexpr T &operator[](std::size_t k) const noexcept { return first_[k]; }

private:
    T *first_;
};
"""


def wrapper(prefix: str, functions: Sequence[CFunction]) -> str:
    """Return the C++ header."""
    guard = f"HOLDFAST_{prefix.upper()}_HPP"
    lines = [f"/* The functions of {prefix}.h as classes. They never throw and never ask for memory. */"]
    lines += [f"#ifndef {guard}", f"#define {guard}", "", "#include <cstddef>", "#include <cstdint>", ""]
    lines += [f'#include "{prefix}.h"', "", f"namespace {prefix} {{", *_SPAN.splitlines()]
    for function in functions:
        lines += _class(function)
    return "\n".join([*lines, "", f"}} // namespace {prefix}", "", "#endif", ""])


def _class(function: CFunction) -> list[str]:
    own, name = "".join(part.capitalize() for part in function.of.name.split("_")), function.name
    lines = ["", f"/* {function.of.summary} */", f"class {own} {{", "public:"]
    lines += [f"    {own}() noexcept {{ {name}_begin(&memory_, &arrays_); }}"]
    lines += [f"    {own}(const {own} &) = delete;", f"    {own} &operator=(const {own} &) = delete;", ""]
    for array, external in function.of.externals.items():
        if not external.size:
            continue
        field, size = function.fields[array], math.prod(external.shape)
        first = f"&memory_.{field}{'[0]' * max(1, len(external.shape))}"
        const = "" if external.role in ("input", "parameter", "carried") else "const "
        after = " const noexcept" if const else " noexcept"
        words = meaning(array)
        lines += [f"    /* {words} */"] if words else []
        kind = f"span<{const}double, {size}>"
        lines.append(f"    {kind} {field}(){after} {{ return {kind}({first}); }}")
    result = f"{name}_status" if function.of.statuses else "void"
    call = f"return static_cast<{result}>({name}(&arrays_));" if function.of.statuses else f"{name}(&arrays_);"
    lines += ["", "    /* Compute the outputs. */", f"    {result} operator()() noexcept {{ {call} }}"]
    lines += ["", "    /* Take the parameters, after they have changed. */"]
    lines.append(f"    void prepare() noexcept {{ {name}_prepare(&arrays_); }}")
    if function.of.name == STEP_FUNCTION:
        lines += ["", "    /* Begin at the state that memory holds. */"]
        lines.append(
            f"    {result} start() noexcept {{ return static_cast<{result}>({name}_start(&memory_, &arrays_)); }}"
        )
    return [*lines, "", "private:", f"    {name}_memory memory_;", f"    {name}_arrays arrays_;", "};"]
