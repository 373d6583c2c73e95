"""Exported code run apart from Python: a program reads the arrays of many systems, and writes what comes out."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from holdfast.codegen.export import EXACT_FLAGS
from holdfast.codegen.functions import ExportedFunction
from holdfast.codegen.header import CFunction

FLAGS = ["-std=c11", "-O2", *EXACT_FLAGS.split()]
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
APART = {"aarch64": ["qemu-aarch64"]}  # what runs programs of other processors
INSTALL = (
    "apt-get install gcc g++ clang cmake pkg-config valgrind qemu-user gcc-aarch64-linux-gnu libc6-dev-arm64-cross"
)


def require(*programs: str) -> None:
    """Skip the test, by name, where a program is missing."""
    missing = [program for program in programs if not shutil.which(program)]
    if missing:
        pytest.skip(f"needs {', '.join(missing)}: {INSTALL}")


def driver(name: str, functions: Sequence[CFunction]) -> str:
    """Return a C program that runs the functions, each for as many systems as its input says."""
    lines = ["#include <stdio.h>", f'#include "{name}.h"', ""]
    lines += ["#define READ(x) (fread((void *)(x), 1, sizeof(x), stdin) == sizeof(x))"]
    lines += ["#define WRITE(x) fwrite((x), 1, sizeof(x), stdout)", "", "int main(void)", "{", "    int64_t count;"]
    for function in functions:
        own = function.name
        lines += [
            "    {",
            f"        static {own}_memory m;",
            f"        {own}_arrays a;",
            f"        {own}_begin(&m, &a);",
        ]
        lines += ["        if (fread(&count, 8, 1, stdin) != 1) return 1;"]
        lines += ["        for (int64_t i = 0; i < count; i++) {"]
        for array, external in function.of.externals.items():
            if external.role != "output" and external.size:
                lines.append(f"            if (!READ(m.{function.fields[array]})) return 2;")
        lines += [f"            {own}_prepare(&a);", f"            int64_t status = {own}(&a);"]
        for array, external in function.of.externals.items():
            if external.role in ("output", "carried") and external.size:
                lines.append(f"            WRITE(m.{function.fields[array]});")
        lines += ["            fwrite(&status, 8, 1, stdout);", "        }", "    }"]
    return "\n".join([*lines, "    return 0;", "}", ""])


def built(folder: Path, name: str, functions: Sequence[CFunction], compiler: str, target: str, flags: str) -> Path:
    """Return the program: the driver with the source or the object file in the folder."""
    require(compiler)
    (folder / "driver.c").write_text(driver(name, functions))
    program = folder / f"driver-{compiler}"
    source = folder / f"{name}.c"
    code = str(source) if source.exists() else str(folder / f"{name}.o")
    static = ["-static"] if target in APART else []
    command = [compiler, *FLAGS, *STRICT, flags, *static, "-o", str(program), "driver.c", code, "-lm"]
    subprocess.run(command, cwd=folder, check=True, timeout=300)
    return program


def outputs(
    program: Path,
    functions: Sequence[ExportedFunction],
    given: Mapping[str, Sequence[Mapping[str, np.ndarray]]],
    runner: Sequence[str] = (),
) -> dict[str, list[dict[str, np.ndarray]]]:
    """Return the outputs of every function for every system, and what it returned as `returned`.

    Args:
        program: of `built`.
        functions: in its order.
        given: by function, of every system the arrays that are not as they are at first.
        runner: what runs the program.
    """
    written = b""
    for function in functions:
        written += np.int64(len(given[function.name])).tobytes()
        for system in given[function.name]:
            for name, external in function.externals.items():
                if external.role != "output" and external.size:
                    first = function.values.get(name, np.zeros(external.shape))
                    x = np.broadcast_to(np.asarray(system.get(name, first), dtype=float), external.shape)
                    written += x.tobytes()
    done = subprocess.run([*runner, str(program)], input=written, capture_output=True, timeout=600)
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])
    numbers, at = np.frombuffer(done.stdout), 0
    found: dict[str, list[dict[str, np.ndarray]]] = {}
    for function in functions:
        found[function.name] = []
        for _ in given[function.name]:
            system: dict[str, np.ndarray] = {}
            for name, external in function.externals.items():
                if external.role in ("output", "carried") and external.size:
                    system[name] = numbers[at : at + external.size].reshape(external.shape)
                    at += external.size
            system["returned"] = numbers[at : at + 1].view(np.int64)
            at += 1
            found[function.name].append(system)
    assert at == numbers.size
    return found
