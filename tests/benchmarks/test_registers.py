"""Counts of machine code are those of its assembly, and its examples compute what they should."""

import numpy as np
import pytest
from benchmarks import cone_iteration, registers, roofline

from holdfast.compiler.targets import cpu

needs_avx2 = pytest.mark.skipif(
    not cpu.features().issuperset(cpu.X86_LEVELS["x86-64-v3"]), reason="this processor does not run code for x86-64-v3"
)

ASSEMBLY = """\
some.0:                                 # @some.0
# %bb.0:
	subq	$40, %rsp
	leaq	8(%rdi), %rax
	vmovapd	32(%rdi), %ymm0
	vbroadcastsd	.LCPI0_0(%rip), %ymm1
	vmulpd	(%rax), %ymm0, %ymm2            # ymm2 = with a comment (of its own)
	vaddpd	.LCPI0_1(%rip){1to8}, %zmm0, %zmm3
	vmovupd	%ymm2, (%rsp)                   # 32-byte Spill
	vaddsd	(%rsp), %xmm0, %xmm0            # 32-byte Folded Reload
	vmovapd	%ymm0, 64(%rsi)
	addq	$40, %rsp
	retq
.Lfunc_end0:
	.size	some.0, .Lfunc_end0-some.0
other:
	retq
"""


def test_instructions():
    """Loads and stores are told apart; addresses that are only computed are neither."""
    found = registers.instructions(ASSEMBLY)
    assert found["some.0"] == {
        "instructions": 11,
        "loads": 5,
        "stores": 2,
        "bytes": 32 + 8 + 32 + 8 + 8 + 32 + 32,
        "spilled": 64,
    }
    assert found["other"]["instructions"] == 1


@needs_avx2
def test_counts_of_an_example():
    """An iteration's counts: all operations once a system, at least one instruction each, and both lanes' spills."""
    with cpu.made_for(cpu.level("x86-64-v3")):
        schedule = cone_iteration.schedule()
        single, lanes = (registers.counts(schedule, 4, systems) for systems in (1, 4))
    assert single.operations == schedule.operation_count
    assert lanes.operations == 4 * schedule.operation_count
    assert lanes.operations / 8 < lanes.instructions < lanes.operations  # an fma on four lanes does eight
    assert 0 < lanes.spilled < 32 * (lanes.loads + lanes.stores)
    assert lanes.bytes <= 32 * (lanes.loads + lanes.stores)
    runs = {name: n for name, _, n in registers.runs_of(schedule, 4, 4)}
    assert max(runs.values()) == cone_iteration.BLOCKS  # both blocks run the same code, one after the other
    assert len(lanes.live) == sum(
        n * (len(program.instructions) - program.input_size) for _, program, n in registers.runs_of(schedule, 4, 4)
    )


@needs_avx2
def test_rows(monkeypatch):
    """A computation has rows for one system and in lanes, and a table shows both."""
    monkeypatch.setattr(registers, "LEVELS", ("x86-64-v3",))
    monkeypatch.setattr(registers, "EFFORT", registers.Effort(turn=1e-4, rounds=2))
    rows = registers.measured("cone iteration")
    assert [(row.wide, row.systems) for row in rows] == [(False, 1), (True, 4)]
    assert all(row.nanoseconds > 0 for row in rows)
    text = registers.table(rows)
    assert text.count("cone iteration") == 2


@needs_avx2
def test_roof(monkeypatch):
    """A processor computes more in lanes, and reads more."""
    monkeypatch.setenv("HOLDFAST_COMPILE", "full")
    narrow, wide = roofline.roof("x86-64-v3", 1), roofline.roof("x86-64-v3", 4)
    assert wide.rate > 1.5 * narrow.rate
    assert wide.bandwidth > 1.5 * narrow.bandwidth


def test_cone_iteration_finds_the_optimum():
    """From a strictly feasible programme, iterations end where the conditions of optimality hold."""
    given = cone_iteration.example(3)
    for _ in range(14):
        given |= {name: np.array(x, dtype=float) for name, x in cone_iteration.iteration(given).items()}
        if (given["s"] * given["z"]).sum() < 1e-9:
            break
    x, s, z, nu = (given[name] for name in ("x", "s", "z", "nu"))
    G, E = given["G"], given["E"]
    stationary = np.einsum("ikl,il->ik", given["P"], x) + given["c"]
    stationary += np.einsum("ijkl,ijk->il", G, z) + np.einsum("ikl,k->il", E, nu)
    assert np.abs(stationary).max() < 1e-7
    assert np.abs(s + np.einsum("ijkl,il->ijk", G, x) - given["h"]).max() < 1e-7
    assert np.abs(np.einsum("ikl,il->k", E, x) - given["e"]).max() < 1e-7
    assert 0.0 <= (s * z).sum() < 1e-8
    for cone in (s, z):
        assert (cone[..., 0] >= np.linalg.norm(cone[..., 1:], axis=-1)).all()
