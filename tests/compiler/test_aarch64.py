"""Machine code of a 64-bit ARM processor, emulated: the interpreter's bits, as on every processor with fma."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import llvmlite.binding as binding
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from holdfast.compiled.forward_schedule import forward_schedule
from holdfast.compiled.parameters import parameters_of
from holdfast.compiled.structure import Options, Structure
from holdfast.compiler.interpret import interpret_schedule
from holdfast.compiler.lowering import lowered
from holdfast.compiler.schedule import Schedule
from holdfast.compiler.targets import batch_module, single_module
from tests.compiled.problems import chain_of, numbers, one
from tests.compiler.programs import NUMBERS, inputs_of, programs, same_bits, schedule_of, schedules
from tests.compiler.test_elementary import CIRCLE, hard_arguments

few = settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(autouse=True, scope="module")
def emulator():
    """Everything here needs it."""
    require_emulator()


def check(schedule: Schedule, systems: list[dict[str, np.ndarray]]) -> None:
    """Interpreter = alone = in a batch, for every system."""
    alone, batch = outputs(schedule, systems)
    for k, system in enumerate(systems):
        for name, expected in interpret_schedule(schedule, system).items():
            assert same_bits(alone[k][name], expected), (k, name)
            assert same_bits(batch[k][name], expected), (k, name)


@few
@given(programs(), st.lists(st.lists(NUMBERS, min_size=7, max_size=7), min_size=1, max_size=5))
def test_programs(program, values):
    """Random programs and numbers: every operation, overflow, zeros of both signs."""
    systems = [{"in0": np.array(x[:3]), "in1": np.reshape(x[3:], (2, 2))} for x in values]
    check(schedule_of(lowered(program)), systems)


@pytest.mark.slow
@few
@given(schedules(), st.integers(0, 2**32), st.booleans(), st.integers(1, 4))
def test_schedules(schedule, seed, wild, count):
    """Random schedules: items in lanes, values that are handed on, statuses and guards."""
    check(schedule, [inputs_of(schedule, seed + k, wild) for k in range(count)])


def test_sine_and_cosine():
    """Of the arguments that are hardest to reduce, and of random ones."""
    random = np.random.default_rng(0)
    x = np.concatenate([hard_arguments()[::40], random.uniform(-1e5, 1e5, 300), [0.0, 1e5, 2e5, np.inf, np.nan]])
    check(schedule_of(lowered(CIRCLE.program)), [{"in0": np.array([v])} for v in x])


@pytest.mark.slow
def test_chain():
    """Forward dynamics of a chain, its arms in lanes and one after the other."""
    chain = chain_of(((4, "rigid"), (3, "hinge"), (2, None)))
    given, own = numbers(chain, 2), parameters_of(chain, None)
    schedule = forward_schedule(Structure(chain, Options()))
    systems = [own | one(given, k) for k in range(2)]
    check(schedule, [{name: x for name, x in s.items() if name in schedule.externals} for s in systems])


EMULATOR, COMPILER = "qemu-aarch64", "aarch64-linux-gnu-gcc"
LANES = 2  # doubles in a register of NEON

# Runs every system alone, then all of them as a batch. It reads the numbers of externals and systems and the doubles of
# working memory (alone, batch), then the size of each external and its numbers, system after system; it writes those of
# all externals after the single calls, and again after the batch.
DRIVER = """
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int64_t single(void **table);
void prepare(void **table);
void batch(int64_t *table, int64_t begin, int64_t end, int64_t count, int64_t repeats, double *arena);

int main(void) {
  int64_t head[4], size[64];
  double *given[64], *found[64], *arena;
  void *one[65];
  int64_t many[128];
  if (fread(head, 8, 4, stdin) != 4 || head[0] > 64) return 1;
  int64_t count = head[0], systems = head[1];
  for (int k = 0; k < count; k++) {
    if (fread(&size[k], 8, 1, stdin) != 1) return 2;
    given[k] = aligned_alloc(64, 64 + (8 * size[k] * systems + 63) / 64 * 64);
    found[k] = aligned_alloc(64, 64 + (8 * size[k] * systems + 63) / 64 * 64);
    if (fread(given[k], 8, size[k] * systems, stdin) != size[k] * systems) return 3;
    memcpy(found[k], given[k], 8 * size[k] * systems);
  }
  arena = aligned_alloc(64, 64 + (8 * (head[2] > head[3] ? head[2] : head[3]) + 63) / 64 * 64);
  for (int64_t i = 0; i < systems; i++) {
    for (int k = 0; k < count; k++) one[k] = found[k] + i * size[k];
    one[count] = arena;
    prepare(one);
    single(one);
  }
  for (int k = 0; k < count; k++) fwrite(found[k], 8, size[k] * systems, stdout);
  for (int k = 0; k < count; k++) {
    many[2 * k] = (int64_t)given[k];
    many[2 * k + 1] = size[k];
  }
  batch(many, 0, (systems + LANES - 1) / LANES, systems, 1, arena);
  for (int k = 0; k < count; k++) fwrite(given[k], 8, size[k] * systems, stdout);
  return 0;
}
"""


def require_emulator() -> None:
    """Skip the test, by name, where the emulator or the compiler that links for it is missing."""
    if not (shutil.which(EMULATOR) and shutil.which(COMPILER)):
        pytest.skip(
            "needs QEMU and an ARM linker: apt-get install qemu-user gcc-aarch64-linux-gnu libc6-dev-arm64-cross"
        )


def outputs(schedule: Schedule, systems: list[dict[str, np.ndarray]]) -> tuple[list[dict], list[dict]]:
    """Return the outputs of every system, computed alone and computed in a batch."""
    (alone, arena), (lanes, arena_of_lanes) = single_module(schedule, LANES), batch_module(schedule, LANES)
    folder = _workplace()
    for name, text in (("single", alone), ("batch", lanes)):
        (folder / f"{name}.o").write_bytes(_object(text))
    program = folder / "program"
    _link(program, folder / "driver.o", folder / "single.o", folder / "batch.o")
    sizes = {name: e.size for name, e in schedule.externals.items()}
    written = np.array([len(sizes), len(systems), arena, arena_of_lanes], dtype=np.int64).tobytes()
    for name, size in sizes.items():
        numbers = np.stack([np.ravel(s[name]) if name in s else np.full(size, np.nan) for s in systems])
        written += np.int64(size).tobytes() + numbers.astype(float).tobytes()
    done = subprocess.run([EMULATOR, program], input=written, capture_output=True, timeout=120)
    assert done.returncode == 0, (done.returncode, done.stderr)
    read = np.frombuffer(done.stdout).reshape(2, -1)
    return tuple([_outputs(schedule, part, k, len(systems)) for k in range(len(systems))] for part in read)  # type: ignore[return-value]


def _outputs(schedule: Schedule, numbers: np.ndarray, system: int, count: int) -> dict[str, np.ndarray]:
    """Return one system's outputs among the numbers of all externals."""
    found, start = {}, 0
    for name, external in schedule.externals.items():
        if external.role == "output":
            first = start + system * external.size
            found[name] = numbers[first : first + external.size].reshape(external.shape)
        start += count * external.size
    return found


@cache
def _workplace() -> Path:
    """Return a folder with the driver compiled."""
    folder = Path(mkdtemp(prefix="holdfast-emulated-"))
    (folder / "driver.c").write_text(DRIVER)
    command = [COMPILER, "-O1", f"-DLANES={LANES}", "-c", "driver.c", "-o", "driver.o"]
    subprocess.run(command, cwd=folder, check=True, timeout=120)
    return folder


def _link(program: Path, *objects: Path) -> None:
    subprocess.run([COMPILER, "-static", "-o", program, *objects, "-lm"], check=True, timeout=120)


def _object(text: str) -> bytes:
    """Return a module as an object file for 64-bit ARM."""
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    target = binding.Target.from_triple("aarch64-unknown-linux-gnu")
    machine = target.create_target_machine(cpu="generic", opt=2, reloc="static", codemodel="small")
    module = binding.parse_assembly(text)
    module.triple, module.data_layout = "aarch64-unknown-linux-gnu", str(machine.target_data)
    module.verify()
    return machine.emit_object(module)
