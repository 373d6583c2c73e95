"""Zeros have the same sign in the interpreter and in all machine code, whoever compiles it."""

import itertools
import random
import subprocess
from functools import cache

import numpy as np
import pytest

from holdfast.compiler.graph import Graph
from holdfast.compiler.interpret import interpret
from holdfast.compiler.lowering import lowered
from holdfast.compiler.node import Node
from holdfast.compiler.program import Program
from holdfast.compiler.targets import DEFINITIONS, cpu, single_source
from holdfast.compiler.trace import program_of, trace
from holdfast.spatial.scalar import less, where
from tests.codegen.exported import FLAGS, require
from tests.compiler import test_aarch64 as emulated
from tests.compiler.programs import compile_program, same_bits, schedule_of

# Of a b + c the negative alone, both, the negative in another sum, and negatives of products and choices.
FUNCTIONS = [
    lambda a, b, c, d: (-(a * b + c),),
    lambda a, b, c, d: (a * b + c, -(a * b + c)),
    lambda a, b, c, d: (d * c - (a * b + c),),
    lambda a, b, c, d: (d * c - (a * b + c), a * b + c),
    lambda a, b, c, d: (-(c - a * b), -(0.5 * a - c)),
    lambda a, b, c, d: (-(a * b + c * d + 1.0), a * b + c * d),
    lambda a, b, c, d: (-((a * b + c) * d * (a * b + c)), (a * b + c) * c - d),
    lambda a, b, c, d: (-where(less(a, d), c - d, a * b + c), c - d),
]
VALUES = (0.0, -0.0, 1.0, -1.0)
SYSTEMS = np.array(list(itertools.product(VALUES, repeat=4)))
C_COMPILERS = {  # what compiles, what links, and what runs the program
    "gcc": (["gcc", "-march=x86-64-v3"], ["gcc"], []),
    "clang": (["clang", "-march=x86-64-v3"], ["clang"], []),
    "gcc for ARM": (["aarch64-linux-gnu-gcc"], ["aarch64-linux-gnu-gcc", "-static"], ["qemu-aarch64"]),
    "clang for ARM": (["clang", "--target=aarch64-linux-gnu"], ["aarch64-linux-gnu-gcc", "-static"], ["qemu-aarch64"]),
}
DECLARED = """
typedef long int64_t;
typedef struct { double *in0, *out0, *workspace; } arrays;
double fma(double, double, double), fabs(double), sqrt(double);
"""
DRIVER = """
#include <stdio.h>
int main(void) {
  double x[4], y[8], work[4096];
  arrays a = {x, y, work};
  while (fread(x, 8, 4, stdin) == 4) CALLS
  return 0;
}
"""


def drawn(seed: int) -> Program:
    """Return a random program of sums, products and signs, of which zeros and ones often make zeros."""
    draw, graph = random.Random(seed), Graph()
    numbers: list[object] = [graph.input() for _ in range(4)]
    while len(numbers) < 16:
        kind = draw.choice(["add", "subtract", "multiply", "fma", "fma", "negate", "negate", "select"])
        x, y, z, w = (draw.choice(numbers[-5:]) for _ in range(4))
        if kind == "select":
            numbers.append(graph.apply("select", graph.apply("less", x, y), z, w))
        else:
            numbers.append(graph.apply(kind, *(x, y, z)[: {"fma": 3, "negate": 1}.get(kind, 2)]))
        numbers = [x for x in numbers if isinstance(x, Node)]
    return program_of(graph, ((4,),), [((3,), draw.sample(numbers[4:], 3))])


@cache
def programs() -> list[Program]:
    """Return the functions as programs, and programs at random."""
    written = [trace(lambda x, f=f: (np.array(f(*x)),), [(4,)]) for f in FUNCTIONS]
    return [*written, *(drawn(seed) for seed in range(25))]


@cache
def expected(program: Program) -> np.ndarray:
    """Return what the interpreter finds for every system."""
    return np.array([interpret(program, x)[0] for x in SYSTEMS])


def test_machine_code():
    """Alone and in lanes."""
    if not cpu.has_fma():
        pytest.skip("this processor has no fma: its machine code rounds products apart")
    for k, program in enumerate(programs()[:12]):
        kernel = compile_program(program)
        assert same_bits(kernel(SYSTEMS)[0], expected(program)), k
        assert same_bits(np.array([kernel(x)[0] for x in SYSTEMS]), expected(program)), k


@pytest.mark.slow
def test_machine_code_of_arm():
    """Alone and in lanes."""
    emulated.require_emulator()
    for k, program in enumerate(programs()[:12]):
        alone, lanes = emulated.outputs(schedule_of(lowered(program)), [{"in0": x} for x in SYSTEMS])
        assert same_bits(np.array([found["out0"] for found in alone]), expected(program)), k
        assert same_bits(np.array([found["out0"] for found in lanes]), expected(program)), k


@pytest.mark.parametrize("compiler", C_COMPILERS)
def test_c(compiler, tmp_path):
    """Programs as C, by both compilers, for both processors."""
    compile_with, link_with, run_with = C_COMPILERS[compiler]
    require(compile_with[0], link_with[0], *run_with)
    if not run_with and not {"fma", "avx2"} <= cpu.features():
        pytest.skip("this processor does not run code for x86-64-v3")
    tried = programs()
    text, calls = DECLARED + DEFINITIONS, ""
    fields = {"in0": "in0", "out0": "out0"}
    for k, program in enumerate(tried):
        text += single_source(schedule_of(lowered(program)), (f"p{k}", f"prepare{k}"), "arrays", fields)[0]
        calls += f"p{k}(&a); fwrite(y, 8, {program.outputs[0].shape[0]}, stdout); "
    (tmp_path / "programs.c").write_text(text + DRIVER.replace("CALLS", f"{{ {calls} }}"))
    subprocess.run([*compile_with, *FLAGS, "-c", "programs.c"], cwd=tmp_path, check=True, timeout=120)
    subprocess.run([*link_with, "programs.o", "-o", "programs", "-lm"], cwd=tmp_path, check=True, timeout=120)
    done = subprocess.run([*run_with, tmp_path / "programs"], input=SYSTEMS.tobytes(), capture_output=True, check=True)
    found = np.frombuffer(done.stdout).reshape(len(SYSTEMS), -1)
    ends = np.cumsum([program.outputs[0].shape[0] for program in tried])
    for k, (program, end) in enumerate(zip(tried, ends, strict=True)):
        assert same_bits(found[:, end - program.outputs[0].shape[0] : end], expected(program)), k
