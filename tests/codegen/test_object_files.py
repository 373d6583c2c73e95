"""What object files must not do: ask others for anything, write where they may not, need more stack than they say."""

import ctypes
import math
import random
import struct
import subprocess

import pytest

from holdfast.codegen.export import files_of
from holdfast.codegen.functions import exported_function
from holdfast.compiled.chain import compile
from holdfast.compiler.arithmetic import fma
from holdfast.compiler.targets import OBJECT_TARGETS, cpu
from holdfast.compiler.targets.llvm.functions import filled
from holdfast.compiler.targets.llvm.object_file import stack_needed
from tests.codegen.exported import built, outputs, require
from tests.codegen.problems import chain_and_state, truths
from tests.compiler.programs import same_bits

FUNCTIONS = ("forward_dynamics", "closure")


def written(folder, target, functions=FUNCTIONS):
    """Write an object file of some functions of one chain; return the C functions."""
    chain, state = chain_and_state("one holds")
    compiled = compile(chain)
    found = [exported_function(name, compiled, state) for name in functions]
    made = files_of("part", found, OBJECT_TARGETS[target], source=False)
    for file, content in made.files.items():
        (folder / file).write_bytes(content)
    return made.functions


@pytest.mark.slow
@pytest.mark.parametrize(
    "target", [x if x == "x86-64-v2" else pytest.param(x, marks=pytest.mark.long) for x in OBJECT_TARGETS]
)
def test_nothing_is_undefined(target, tmp_path):
    """`nm -u` is empty, on x86-64-v2 too, whose fma is a function of the file's own; no data can be written."""
    nm = "aarch64-linux-gnu-nm" if target == "aarch64" else "nm"
    require(nm)
    functions = written(tmp_path, target)
    path = tmp_path / "part.o"
    assert subprocess.run([nm, "-u", path], check=True, capture_output=True, text=True).stdout == ""
    lines = subprocess.run([nm, path], check=True, capture_output=True, text=True).stdout.splitlines()
    kinds = {line.split()[-2] for line in lines}
    assert kinds <= {"T", "t", "r", "n"}, "code and constants, nothing that can be written"
    public = {line.split()[-1] for line in lines if line.split()[-2] == "T"}
    assert public == {name for f in functions for name in (f.name, f"{f.name}_prepare")}


@pytest.mark.slow
def test_valgrind(tmp_path):
    """Every read is of memory that was written, every access within its array."""
    require("valgrind", "gcc")
    if not cpu.features().issuperset(cpu.X86_LEVELS["x86-64-v3"]):
        pytest.skip("this processor has no AVX2")
    functions = written(tmp_path, "x86-64-v3")
    program = built(tmp_path, "part", functions, "gcc", "x86-64-v3", "-march=x86-64-v3")
    given = {f.of.name: [{}, {}] for f in functions}
    runner = ["valgrind", "-q", "--error-exitcode=9", "--track-origins=no"]
    assert outputs(program, [f.of for f in functions], given, runner)


STACK = """
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>
#include "part.h"

enum { SIZE = 1 << 20 };
static unsigned char *stack;
static ucontext_t here, there;
static void nothing(void) {}
FUNCTIONS

static void used(const char *name, void (*function)(void))
{
    memset(stack, 0xA5, SIZE);
    getcontext(&there);
    there.uc_stack.ss_sp = stack;
    there.uc_stack.ss_size = SIZE;
    there.uc_link = &here;
    makecontext(&there, function, 0);
    swapcontext(&here, &there);
    int k = 0;
    while (k < SIZE && stack[k] == 0xA5) k++;
    printf("%s %d\\n", name, SIZE - k);
}

int main(void)
{
    stack = aligned_alloc(64, SIZE);
    used("nothing", nothing);
CALLS
    return 0;
}
"""


@pytest.mark.slow
def test_stack(tmp_path):
    """A call needs no more of the stack than the header says, and not much less."""
    require("gcc")
    if not cpu.features().issuperset(cpu.X86_LEVELS["x86-64-v3"]):
        pytest.skip("this processor has no AVX2")
    functions = written(tmp_path, "x86-64-v3")
    around, calls = [], []
    for f in functions:
        n = f.name
        around += [f"static {n}_memory {n}_m;", f"static {n}_arrays {n}_a;"]
        around.append(f"static void run_{n}(void) {{ {n}_prepare(&{n}_a); {n}(&{n}_a); }}")
        calls += [f"    {n}_begin(&{n}_m, &{n}_a);", f'    used("{n}", run_{n});']
    text = STACK.replace("FUNCTIONS", "\n".join(around)).replace("CALLS", "\n".join(calls))
    (tmp_path / "stack.c").write_text(text)
    subprocess.run(["gcc", "-O1", "-o", "stack", "stack.c", "part.o"], cwd=tmp_path, check=True, timeout=60)
    out = subprocess.run([tmp_path / "stack"], check=True, capture_output=True, text=True, timeout=60).stdout
    measured = {name: int(size) for name, size in (line.split() for line in out.splitlines())}
    for f in functions:
        needed = measured[f.name] - measured["nothing"]  # and the few bytes of the caller
        assert f.stack * 0.5 <= needed <= f.stack + 32, (f.name, needed, f.stack)


def test_stack_of_assembly():
    """Frames of both architectures, and the deepest way through the calls."""
    x86 = """
	.globl	f
f:
	pushq	%rbp
	subq	$100, %rsp
	callq	g
	callq	h
	retq
g:
	subq	$24, %rsp
	retq
h:
	andq	$-32, %rsp
	movsd	%xmm0, -16(%rsp)
	retq
"""
    assert stack_needed(x86) == {"f": 8 + 8 + 100 + 8 + 32 + 16}
    arm = """
	.globl	f
f:
	stp	x29, x30, [sp, #-32]!
	sub	sp, sp, #1, lsl #12
	bl	g
	ret
g:
	sub	sp, sp, #64
	ret
"""
    assert stack_needed(arm) == {"f": 8 + 32 + 4096 + 8 + 64}


def test_own_fma():
    """The one of processors without the instruction rounds once: against exact integers, to the bit."""
    around = "define double @f(double %a, double %b, double %c) {\n"
    around += "  %r = call double @exact.fma.f64(double %a, double %b, double %c)\n  ret double %r\n}"
    code = cpu.Code(f"{filled('fma')}\n{around}", "f")
    own = ctypes.CFUNCTYPE(ctypes.c_double, *[ctypes.c_double] * 3)(code.address)
    dice = random.Random(1)
    special = [0.0, -0.0, 5e-324, -5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, math.inf, math.nan, -1.0]

    def number() -> float:
        kind = dice.randrange(5)
        if kind == 0:
            return struct.unpack("<d", struct.pack("<Q", dice.getrandbits(64)))[0]
        if kind == 1:
            return dice.choice(special)
        exponent = (dice.randint(-60, 60), dice.randint(-560, -500), dice.randint(400, 520))[kind - 2]
        return dice.uniform(-1, 1) * 2.0**exponent

    for _ in range(20_000):
        a, b, c = number(), number(), number()
        if dice.random() < 0.3:  # nearly all of it cancels
            c = -(a * b) * (1 + dice.choice([0, 1, -1, 2]) * 2.0**-52)
        assert same_bits([own(a, b, c)], [fma(a, b, c)]), (a.hex(), b.hex(), c.hex())


@pytest.mark.long
def test_without_fma(tmp_path):
    """An object file for x86-64-v2 computes what a v3 one does, to rounding: products and sums are apart in it."""
    require("gcc")
    known = [truth for truth in truths("one holds", 20, derivatives=False) if truth.function.name != "step"]
    made = files_of("part", [truth.function for truth in known], OBJECT_TARGETS["x86-64-v2"], source=False)
    for file, content in made.files.items():
        (tmp_path / file).write_bytes(content)
    program = built(tmp_path, "part", made.functions, "gcc", "x86-64-v2", "-march=x86-64-v2")
    given = {truth.function.name: truth.given for truth in known}
    found = outputs(program, [truth.function for truth in known], given)
    for truth in known:
        for got, expected in zip(found[truth.function.name], truth.expected, strict=True):
            for name, x in expected.items():
                scale = abs(x).max(initial=1.0)
                assert abs(got[name].ravel() - x.ravel()).max() <= 1e-8 * scale, (truth.function.name, name)
