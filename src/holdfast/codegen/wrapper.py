"""The C++17 wrapper: a class for each function, which owns its memory; arrays are spans of known length."""

from __future__ import annotations

import math
from collections.abc import Sequence

from holdfast.codegen.arrays import meaning
from holdfast.codegen.functions import STEP
from holdfast.codegen.header import CFunction

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
    if function.of.name == STEP:
        lines += ["", "    /* Begin at the state that memory holds. */"]
        lines.append(
            f"    {result} start() noexcept {{ return static_cast<{result}>({name}_start(&memory_, &arrays_)); }}"
        )
    return [*lines, "", "private:", f"    {name}_memory memory_;", f"    {name}_arrays arrays_;", "};"]
